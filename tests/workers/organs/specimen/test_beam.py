"""A measured silicone beam: the diagnosis finds self-weight and marker stand-off.

Recordings of M. Dubied et al., IEEE Robot. Autom. Lett. (2022). Their own stiffness,
fitted to another load, is 264 kPa; the markers were 6 mm off the surface.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.tasks.diagnosis_sources import check_source
from palpate.workers.tasks.diagnosis_store import Outcome
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

ROOT = Path(__file__).parents[4]
DATA = ROOT.parent / "shared" / "data" / "dragonskin_beam_mocap"
NODES = 2200
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the recordings are not at {DATA}")


def source_of(folder, states=("0 g", "52 g")):
    """Read the example with the paths of its recordings."""
    data = yaml.safe_load((ROOT / "examples" / "beam.yaml").read_text())
    data["states"] = [s for s in data["states"] if s["name"] in states]
    for state in data["states"]:
        state["files"] = [str(DATA / Path(file).name) for file in state["files"]]
    path = folder / "beam.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return read_experiment(path)


def diagnosed(source, folder):
    """Return the diagnosis and its summary."""
    store = diagnosed_store(source, folder / "store", NODES, 0.0)
    return diagnosis_in(store), store.outcome.record(Outcome).summary


def test_recordings_match_published_displacements(tmp_path):
    source = source_of(tmp_path)
    check_source(source)
    drops = -source.observed.moved_mm[:, :, 1].mean(axis=1)
    np.testing.assert_allclose(drops, [6.5, 17.0], atol=0.1)
    np.testing.assert_allclose(source.observed.repeats_mm, [0.20, 0.46], atol=0.01)


@pytest.mark.slow
def test_finds_self_weight_then_marker_standoff(tmp_path):
    source = source_of(tmp_path)
    found, summary = diagnosed(source, tmp_path)
    assert found.verdict.kind == "effect"
    assert found.verdict.primary == ("self_weight", "marker_standoff")
    values = found.best.fit.values()
    assert 1e3 * values["E"] == pytest.approx(267, abs=13)
    assert values["marker_standoff"] == pytest.approx(6, abs=2.5)
    left = np.array([np.abs(v.residual).mean() for v in found.best.fit.predictions])
    assert (left < np.array(source.observed.repeats_mm) + 0.02).all()
    # Without self-weight the fitted beam is much softer.
    assert found.analysis.nominal.values()["E"] < 0.2
    (heavier,) = summary.predictions
    drops = -np.array([p.displacement_mm[1] for p in heavier.points])
    assert (drops > 20).all()


@pytest.mark.slow
def test_one_load_leaves_weight_confounded_with_stiffness(tmp_path):
    """Weight is listed as confounded, with the stiffness with and without it."""
    source = source_of(tmp_path, ["52 g"])
    found, summary = diagnosed(source, tmp_path)
    assert "self_weight" in found.verdict.hidden
    assert "self_weight" not in found.verdict.primary
    weight = next(h for h in summary.hidden if h.name == "self_weight")
    young = weight.constants_kpa["E"]
    assert young["without"] < 175
    assert young["with"] == pytest.approx(265, abs=20)
    assert weight.size == {"self_weight_g": 1.0}
