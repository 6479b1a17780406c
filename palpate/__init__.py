"""Python interface to Palpate, which finds the stiffness of living tissue from images.

A study searches for the elastic constants with which the simulated deformation of a body agrees
with the imaged one. A diagnosis finds what the model lacks. Both run on a Dask cluster, by default
in local processes, and continue where they were interrupted.

Run a study and read its results::

    import palpate

    if __name__ == "__main__":                      # workers are separate processes
        study = palpate.Study.from_file("demo.yaml")
        results = study.run(workers=2)
        fat = results.estimates["E_fat"]
        fat.estimate, fat.interval, fat.unit        # such as 10.1, (9.8, 10.4), "kPa"
        fat.quotable, fat.reasons                   # whether it may be quoted, and if not, why
        results.samples(1000)["E_fat_kpa"]          # draws from the posterior
        results.to_frame()                          # every evaluation, a pandas table
        results.plot_posterior()                    # a Matplotlib figure
        study.volume("best")                        # labels of the deformed body

Compare studies that have run::

    palpate.compare("runs/a", "runs/b").write_page("comparison.html")

Simulate once, or evaluate your own candidates::

    model = palpate.Breast(palpate.phantom(), nodes=5000, force_n=60)
    model.simulate(E_fat_kpa=8).cauchy_stress_mpa   # shape (elements, 3, 3)
    study.evaluate({"E_fat_kpa": [8, 10]})["gsf"]

Diagnose a folder of scans, a study or a bench experiment::

    diagnosis = palpate.diagnose("patient-7")
    diagnosis.summary.verdict, diagnosis.summary.primary

Use a service started by `palpate serve`::

    with palpate.connect("http://127.0.0.1:8780") as service:
        job = service.submit("demo.yaml", priority=5)
        job.wait(progress=True)
        job.results["estimates"]["E_fat"]["estimate"]

Units are mm, N, s; elastic constants have their unit in their name (``E_fat_kpa``) or
next to the number.

Examples
--------
>>> import palpate
>>> spec = palpate.study_spec(
...     {
...         "name": "small",
...         "case": {"reference": {"phantom": {"spacing_mm": 2}}, "mesh": {"nodes": 1200}},
...         "target": {"constants": {"E_fat_kpa": 12}},
...         "search": {"parameters": {"E_fat_kpa": [5, 20]}, "population": 12},
...     }
... )
>>> spec.case.load.force_n
100.0
>>> palpate.parameters()["E_fat_kpa"].description
"Young's modulus of fat and ligaments"
"""

from importlib import import_module

# Not from `typing`, which is slow to load: before the command starts, Ctrl-C gives a traceback.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from palpate.client import Job, Service, connect
    from palpate.cornea import Cornea, CorneaSimulation
    from palpate.diagnosis import Diagnosis, diagnose
    from palpate.forward import Breast
    from palpate.results import StudyResults
    from palpate.search import Search, parameters
    from palpate.service.errors_and_interrupts import ClusterError, GenerationCrashError, TaskError
    from palpate.service.remote_client import JobEvent
    from palpate.service.results.posterior_samples import Samples
    from palpate.service.results.result_records import ParameterEstimate
    from palpate.service.server.api_models import ClusterView, JobView
    from palpate.service.simulation.body_simulation import Simulation
    from palpate.service.simulation.candidate_tables import Evaluations
    from palpate.service.simulation.sheet_simulation import SheetSimulation
    from palpate.service.study.study_events import Observer, StopSearch
    from palpate.service.study.study_keys import StudySpec
    from palpate.specimen import Specimen
    from palpate.storage.errors import (
        InputError,
        JournalError,
        NewerSchemaError,
        PalpateError,
        StoreError,
    )
    from palpate.storage.values import Tissue
    from palpate.study import Comparison, Study, compare, study_spec
    from palpate.volumes import Volume, phantom, read_volume, write_volume
    from palpate.workers.mechanics.model_parameters import Parameter

    __version__: str

# Names are loaded on first use: the command `palpate` imports this package first and must be able
# to report an installation with broken dependencies.
_HOMES = {
    "Diagnosis": "palpate.diagnosis",
    "diagnose": "palpate.diagnosis",
    "Breast": "palpate.forward",
    "Simulation": "palpate.service.simulation.body_simulation",
    "SheetSimulation": "palpate.service.simulation.sheet_simulation",
    "Cornea": "palpate.cornea",
    "CorneaSimulation": "palpate.cornea",
    "parameters": "palpate.search",
    "Comparison": "palpate.study",
    "compare": "palpate.study",
    "Evaluations": "palpate.service.simulation.candidate_tables",
    "Job": "palpate.client",
    "Service": "palpate.client",
    "connect": "palpate.client",
    "Study": "palpate.study",
    "study_spec": "palpate.study",
    "Specimen": "palpate.specimen",
    "phantom": "palpate.volumes",
    "read_volume": "palpate.volumes",
    "write_volume": "palpate.volumes",
    "Search": "palpate.search",
    "StopSearch": "palpate.service.study.study_events",
    "StudyResults": "palpate.results",
    "Volume": "palpate.volumes",
    "Observer": "palpate.service.study.study_events",
    "ParameterEstimate": "palpate.service.results.result_records",
    "Samples": "palpate.service.results.posterior_samples",
    "StudySpec": "palpate.service.study.study_keys",
    "ClusterView": "palpate.service.server.api_models",
    "JobView": "palpate.service.server.api_models",
    "JobEvent": "palpate.service.remote_client",
    "Parameter": "palpate.workers.mechanics.model_parameters",
    "Tissue": "palpate.storage.values",
    "InputError": "palpate.storage.errors",
    "JournalError": "palpate.storage.errors",
    "NewerSchemaError": "palpate.storage.errors",
    "PalpateError": "palpate.storage.errors",
    "StoreError": "palpate.storage.errors",
    "ClusterError": "palpate.service.errors_and_interrupts",
    "GenerationCrashError": "palpate.service.errors_and_interrupts",
    "TaskError": "palpate.service.errors_and_interrupts",
}

__all__ = [
    "Breast",
    "ClusterError",
    "ClusterView",
    "Comparison",
    "Cornea",
    "CorneaSimulation",
    "Diagnosis",
    "Evaluations",
    "GenerationCrashError",
    "InputError",
    "Job",
    "JobEvent",
    "JobView",
    "JournalError",
    "NewerSchemaError",
    "Observer",
    "PalpateError",
    "Parameter",
    "ParameterEstimate",
    "Samples",
    "Search",
    "Service",
    "SheetSimulation",
    "Simulation",
    "Specimen",
    "StopSearch",
    "StoreError",
    "Study",
    "StudyResults",
    "StudySpec",
    "TaskError",
    "Tissue",
    "Volume",
    "__version__",
    "compare",
    "connect",
    "diagnose",
    "parameters",
    "phantom",
    "read_volume",
    "study_spec",
    "write_volume",
]


def __getattr__(name: str) -> "Any":
    import_module("palpate.service")  # one thread a process, set before NumPy loads
    if name == "__version__":
        return import_module("palpate.service.installed_packages").palpate_version()
    if name not in _HOMES:
        raise AttributeError(f"module 'palpate' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
