"""What crosses the Python interface is copied or read-only: a finished result stays as it was."""

import copy
import inspect
import json
import pickle
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import BaseModel

import palpate
from palpate.service.remote_client import Client
from palpate.service.results.posterior_samples import Samples
from palpate.storage.read_only import FrozenDict, read_only
from palpate.testing.plugin_claims import small_breast
from palpate.workers.input_files import dump_yaml
from tests.palpate.test_specimen import BAR, SHEET
from tests.recovery.stand_ins import Inline, run
from tests.recovery.test_strategies import spec_of
from tests.service.report.diagnosis_at_hand import VERDICTS, found

DEPTH = 4
KEYS: dict[str, Any] = {
    "name": "small",
    "case": {"reference": {"phantom": {"spacing_mm": 2}}, "constants": {"nu": 0.48}},
    "target": {"constants": {"E_fat_kpa": 12}},
    "search": {"parameters": {"E_fat_kpa": [5, 20]}, "start": [{"E_fat_kpa": 8}]},
}
VIEW = {
    "id": "small", "kind": "study", "name": "small", "owner": "me", "priority": 0,
    "state": "finished", "submitted": "2025-01-01", "changed": "2025-01-01",
    "best": {"candidate": 0, "genes": {"E_fat_kpa": 8}, "score": {"gsf": -3}},
    "files": ["report.html"],
}  # fmt: skip
WORKER = dict.fromkeys(("threads", "running", "waiting", "memory_bytes", "memory_limit_bytes"), 1)


class Remote(Client):
    """A service that answers without a network."""

    def __init__(self) -> None: ...

    def job(self, identifier: str) -> palpate.JobView:
        return palpate.JobView.model_validate(VIEW | {"id": identifier})

    def results(self, identifier: str) -> dict[str, Any]:
        return {"estimates": {"E_fat": {"estimate": 8.0}}}


def breast_labels() -> palpate.Volume:
    made = small_breast()
    return palpate.Volume(made.values, made.spacing_mm, made.origin_mm)


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """An object of every public class, by a name that begins with that of the class."""
    folder = tmp_path_factory.mktemp("runs") / "fitted"
    run(folder, Inline(), spec_of("least-squares"))
    study = palpate.Study.open(folder)
    run(folder.with_name("again"), Inline(), spec_of("least-squares"))
    body, made = breast_labels(), found(VERDICTS["effect"])
    breast, cornea = palpate.Breast(body, nodes=400, force_n=20), palpate.Cornea(elements=200)
    bar, sheet = palpate.Specimen(BAR, nodes=520), palpate.Specimen(SHEET, nodes=200)
    worker = {"name": "w", "address": "tcp://w", "cpu_percent": 1.0} | WORKER
    search = palpate.Search({"x": (0, 4)}, population=4, generations=2)
    search.tell([1.0, 2.0, 3.0, 4.0])
    results = study.results
    endings = [results.best] if results.best else []
    return {
        "Breast": breast,
        "ClusterView": palpate.ClusterView.model_validate({"ready": True, "workers": [worker]}),
        "Comparison": palpate.compare(folder, folder.with_name("again")),
        "Cornea": cornea,
        "CorneaSimulation": cornea.simulate(),
        "Diagnosis": palpate.Diagnosis(made.summary, made.maps, made.scans),
        "Evaluations": palpate.Evaluations(endings),  # type: ignore[arg-type]
        "Job": palpate.Job(Remote(), palpate.JobView.model_validate(VIEW)),
        "JobEvent": palpate.JobEvent("record", None, {"genes": {"x": 1.0}, "list": [1]}, 0),
        "JobView": palpate.JobView.model_validate(VIEW),
        "Observer": palpate.Observer(),
        "Parameter": palpate.parameters()["E_fat_kpa"],
        "ParameterEstimate": results.estimates["E_fat"],
        "Samples": results.samples(10),
        "Search": search,
        "Service": palpate.Service(Remote()),
        "SheetSimulation": sheet.simulate("pulled", E_kpa=200),
        "Simulation": breast.simulate(E_fat_kpa=8),
        "Simulation of a bar": bar.simulate("pulled", E_kpa=200),
        "Specimen": bar,
        "Specimen of a sheet": sheet,
        "Study": study,
        "StudyResults": results,
        "StudySpec": palpate.study_spec(KEYS),
        "Tissue": palpate.Tissue.FAT,
        "Volume": body,
        "Volume that was generated": palpate.Volume.of(small_breast(4.0)),
    }


def parts(path: str, value: Any, deep: int = DEPTH) -> Iterator[tuple[str, Any]]:
    """Yield what an object hands out through its public attributes, without methods."""
    if isinstance(value, np.ndarray | str | int | float | None):
        yield path, value
        return
    ours = type(value).__module__.startswith("palpate") and not isinstance(value, Enum)
    if ours or isinstance(value, Mapping | list | tuple):
        yield path, value
    if isinstance(value, Mapping | list | tuple):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, item in items:
            yield from parts(f"{path}[{key}]", item, deep)
    if ours and deep:
        for name in type(value).model_fields if isinstance(value, BaseModel) else dir(value):
            if not name.startswith("_"):
                with suppress(palpate.PalpateError):
                    attribute = getattr(value, name)
                    if not callable(attribute):
                        yield from parts(f"{path}.{name}", attribute, deep - 1)


def plain(value: Any) -> Any:
    """Return an array as its bytes, a mapping by its keys, others as text."""
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, Mapping):
        return list(value)
    if isinstance(value, list | tuple):
        return len(value)
    return repr(value) if isinstance(value, str | int | float | None) else type(value)


def stated(name: str, value: Any) -> dict[str, Any]:
    return {path: plain(part) for path, part in parts(name, value)}


def spoil(value: Any) -> None:
    """Try to change an array, a mapping or a list in each way."""
    attempts: list[tuple[str, tuple[Any, ...]]] = []
    if isinstance(value, np.ndarray):
        attempts = [("__setitem__", (..., value.ravel()[:1][::-1] if value.size else value))]
        attempts += [("fill", (value.flat[-1],)), ("sort", ())] if value.size else []
    elif isinstance(value, Mapping):
        first = next(iter(value), "new")
        attempts = [("__setitem__", (first, 0)), ("__setitem__", ("new", 1))]
        attempts += [
            ("update", ({"new": 1},)),
            ("__ior__", ({"new": 1},)),
            ("setdefault", ("n", 0)),
        ]
        attempts += [("pop", (first,)), ("popitem", ()), ("__delitem__", (first,)), ("clear", ())]
    elif isinstance(value, list):
        attempts = [("append", (1,)), ("__iadd__", ([1],)), ("insert", (0, 1)), ("extend", ([1],))]
        attempts += [("reverse", ()), ("sort", ()), ("pop", ()), ("clear", ())]
    for method, arguments in attempts:
        with suppress(TypeError, ValueError, AttributeError, KeyError):
            getattr(value, method)(*arguments)


def test_no_holder_changes_what_it_was_given(objects: dict[str, Any]) -> None:
    classes = {n for n in palpate.__all__ if inspect.isclass(getattr(palpate, n))}
    errors = {n for n in classes if issubclass(getattr(palpate, n), Exception)}
    assert classes - errors == {name.split()[0] for name in objects}
    for name in classes - errors:
        assert isinstance(objects[name], getattr(palpate, name))
    tried: set[str] = set()
    for name, value in objects.items():
        before = stated(name, value)
        for path, part in list(parts(name, value)):
            spoil(part)
            tried.add(path)
        after = stated(name, value)
        differing = [p for p in before.keys() | after.keys() if before.get(p) != after.get(p)]
        assert not differing
    assert tried > {
        "Breast.body.values", "Breast.case.constants", "CorneaSimulation.deformed.anterior_mm",
        "Comparison.settings", "Diagnosis.maps[points]", "Diagnosis.summary.constants",
        "Evaluations.records[0].genes", "Job.results", "Job.status.best.genes", "Samples.units",
        "JobEvent.record[list]", "SheetSimulation.triangles", "Simulation.cauchy_stress_mpa",
        "Simulation.deformed.values", "Simulation.outcome", "Study.spec.search.parameters",
        "StudyResults.best.fit[hessian][0]", "StudyResults.posterior.local.covariance",
        "StudySpec.search.start[0]", "Volume.values", "ClusterView.workers",
    }  # fmt: skip


def simulated(objects: dict[str, Any]) -> list[np.ndarray]:
    """Return the displacements that every model gives."""
    return [
        objects["Breast"].simulate(E_fat_kpa=8).displacement_mm,
        objects["Breast"].simulate(E_fat_kpa=8).deformed.values,
        objects["Cornea"].simulate().displacement_mm,
        objects["Specimen"].simulate("pulled", E_kpa=200).displacement_mm,
        objects["Specimen of a sheet"].simulate("pulled", E_kpa=200).displacement_mm,
    ]


def test_the_next_simulation_is_the_same_bit_for_bit(objects: dict[str, Any]) -> None:
    before = [array.copy() for array in simulated(objects)]
    for name, value in objects.items():
        for _, part in list(parts(name, value)):
            spoil(part)
    result = objects["Simulation"]
    for name in ("Simulation", "SheetSimulation", "CorneaSimulation"):  # files may be edited
        mesh = objects[name].to_meshio()
        for array in (mesh.points, mesh.cells[0].data, *mesh.point_data.values()):
            array[...] = 0
        for arrays in mesh.cell_data.values():
            arrays[0][...] = 0
    with pytest.raises(ValueError, match="read-only"):
        result.nodes_mm -= result.nodes_mm.mean(axis=0)
    for old, new in zip(before, simulated(objects), strict=True):
        assert old.tobytes() == new.tobytes()
    assert result.displacement_mm.tobytes() == before[0].tobytes()


def test_a_callers_arrays_are_copied() -> None:
    labels = small_breast()
    given, spacing = labels.values.copy(), [2.0, 2.0, 2.0]
    volume = palpate.Volume(given, spacing, labels.origin_mm)  # type: ignore[arg-type]
    models = [palpate.Breast(one, nodes=400, force_n=20) for one in (volume, labels)]
    before = [model.simulate(E_fat_kpa=8).deformed.values.copy() for model in models]
    given[...], labels.values[...], spacing[0] = 1, 1, 5.0
    assert list(volume.spacing_mm) == [2.0, 2.0, 2.0]
    for body in (volume, models[1].body):
        assert body.values.tobytes() == small_breast().values.tobytes()
    for model, old in zip(models, before, strict=True):
        np.testing.assert_array_equal(model.simulate(E_fat_kpa=8).deformed.values, old)
    draws, units = {"E_fat_kpa": np.ones(3)}, {"E_fat_kpa": "kPa"}
    samples = Samples(draws, units, "small", 1)
    draws["E_fat_kpa"][...] = 0
    units.clear()
    assert (samples["E_fat_kpa"] == 1).all() and samples.units == {"E_fat_kpa": "kPa"}


def test_a_read_only_view_of_a_callers_array_is_copied() -> None:
    owner = np.zeros((2, 2, 2), np.uint8)
    view = owner[:]
    view.flags.writeable = False
    volume = palpate.Volume(view, (1.0, 1.0, 1.0))
    owner[...] = 1
    assert owner.flags.writeable and not volume.values.any()


def test_what_a_caller_passes_in_stays_unchanged() -> None:
    """A frozen mapping refuses every change, at any depth."""
    assert palpate.study_spec(read_only(copy.deepcopy(KEYS))) == palpate.study_spec(KEYS)
    palpate.Specimen(read_only(copy.deepcopy(BAR)), nodes=300)
    phantom = read_only({"phantom": {"spacing_mm": 2}})
    palpate.Breast(phantom, nodes=850, force_n=20, load=read_only({"oblique_deg": 1.0}))
    palpate.Cornea(elements=200, jet=read_only({"pressure_kpa": 0}))
    palpate.Search(read_only({"x": [0, 4]}), start=read_only([{"x": 1.0}]))


def test_the_keys_of_a_caller_do_not_reach_a_study() -> None:
    keys = copy.deepcopy(KEYS)
    spec = palpate.study_spec(keys)
    digest = spec.digest
    keys["search"]["parameters"]["E_fat_kpa"][0] = 6
    keys["search"]["start"][0].clear()
    keys["case"]["constants"]["nu"] = 0.3
    assert spec.digest == digest == palpate.study_spec(KEYS).digest
    held = {"nu": 0.3}
    changed = spec.case.model_copy(update={"constants": held})
    held["nu"] = 0.2
    assert changed.constants == {"nu": 0.3}


def test_a_refusal_says_what_to_do() -> None:
    spec = palpate.study_spec(KEYS)
    with pytest.raises(TypeError, match=r"read-only.*Change a copy, dict\(\.\.\.\)"):
        spec.search.parameters.update(E_fat_kpa=(1, 2))
    wider = dict(spec.search.parameters) | {"E_fat_kpa": (1.0, 20.0)}
    assert wider["E_fat_kpa"] != spec.search.parameters["E_fat_kpa"]


def test_a_study_is_copied_and_written_as_a_plain_one() -> None:
    spec = palpate.study_spec(KEYS)
    pickled = spec.model_copy(update={"case": pickle.loads(pickle.dumps(spec.case))})
    copies = [spec.model_copy(), spec.model_copy(deep=True), copy.copy(spec), pickled]
    for made in (*copies, copy.deepcopy(spec)):
        assert made == spec and made.digest == spec.digest
        assert type(made.search.parameters) is type(made.case.constants) is FrozenDict
    plain = spec.model_dump()
    assert type(plain["search"]["parameters"]) is type(plain["search"]["start"][0]) is dict
    again = [plain, json.loads(spec.model_dump_json()), yaml.safe_load(dump_yaml(spec.as_dict()))]
    assert [palpate.study_spec(keys) for keys in again] == [spec] * 3
    assert json.loads(json.dumps(spec.search.parameters)) == {"E_fat_kpa": [5.0, 20.0]}
    for dumped in (yaml.safe_dump(spec.search.start[0]), yaml.dump(read_only({"E_fat_kpa": 8.0}))):
        assert dumped == "E_fat_kpa: 8.0\n"
    assert yaml.safe_dump(read_only({"labels": [1, 2]})) == "labels:\n- 1\n- 2\n"


def test_copies_and_pickles_stay_read_only(objects: dict[str, Any]) -> None:
    volume, best = objects["Volume"], objects["StudyResults"].best
    for made in (copy.deepcopy(volume), pickle.loads(pickle.dumps(volume))):
        assert made.values.tobytes() == volume.values.tobytes()
        assert not made.values.flags.writeable
    for made in (copy.deepcopy(best), pickle.loads(pickle.dumps(best))):
        assert made == best and type(made.genes) is FrozenDict
    result = replace(objects["Simulation"], reason="stated")
    assert result.reason == "stated" and not result.nodes_mm.flags.writeable
