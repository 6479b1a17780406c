"""Faulty recordings of markers: lost markers, decimal commas, times, units, repeats."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.comparison.observation.marker_tracking import without_lost
from palpate.workers.comparison.observation.number_table import read_table
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.organs.specimen.specimen_checks import confirmed_scatter, outside_intervals
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.cases.bench.bench_cases import HEAD, MARKERS, YOUNG_MPA, described, motion, rows, text_of
from tests.cases.bench.bench_cases import write as written

TRUE_MM = motion(list(MARKERS.values()))
COLUMN = {name: 1 + 3 * n for n, name in enumerate(MARKERS)}


def observed(folder, a=None, b=None, **changes):
    source = read_experiment(written(folder, described(**changes), a, b))
    check_source(source)
    return source.observed


def lost(frames, number, marker="M3", values=None):
    table = rows() if values is None else values.copy()
    table[frames, COLUMN[marker] : COLUMN[marker] + 3] = number
    return table


@pytest.mark.slow
def test_recovers_the_stiffness_of_a_block_with_a_lost_marker(tmp_path):
    """With a marker missing in 6 of 13 frames of a repeat, E is still 200 kPa within 1 %."""
    source = read_experiment(written(tmp_path, b=text_of(lost(slice(5, 11), 0.0))))
    check_source(source)
    np.testing.assert_allclose(source.observed.moved_mm[0], TRUE_MM, atol=1e-5)
    _, fit = calibrate(source.inverse_problem(500), None)
    assert fit.values()["E"] == pytest.approx(YOUNG_MPA, rel=0.01)
    assert "M3 is missing in 6 of 13 frames" in source.observed.notes[0]
    assert source.observed.notes[0].count("b.csv") == 1


@pytest.mark.parametrize("number", [0.0, np.nan, -1.0, 9999.0, [9999.0, 0.0, 0.0], -999.25, np.inf])
@pytest.mark.parametrize("frames", [[11], slice(5, 11), [1, 10]], ids=["one", "six", "two"])
@pytest.mark.parametrize("both", [False, True])
def test_lost_marker_is_a_missing_value(tmp_path, number, frames, both):
    table = text_of(lost(frames, number))
    found = observed(tmp_path, table if both else None, table)
    np.testing.assert_allclose(found.moved_mm[0], TRUE_MM, atol=1e-5)
    count = len(np.arange(13)[frames])
    assert [f"M3 is missing in {count} of 13 frames" in note for note in found.notes] == [True] * (
        2 if both else 1
    )


def test_repeated_position_of_a_marker_is_missing_while_others_move(tmp_path):
    noisy = rows() + np.pad(np.random.default_rng(1).normal(0, 0.01, (13, 12)), ((0, 0), (1, 0)))
    stale = noisy.copy()
    stale[5:10, 7:10] = stale[4, 7:10]
    found = observed(tmp_path, text_of(noisy), text_of(stale))
    assert found.notes[0].startswith("The marker M3 is missing in 5 of 13 frames")
    np.testing.assert_allclose(found.moved_mm[0], TRUE_MM, atol=0.02)


def test_ordinary_motion_is_not_missing():
    rng = np.random.default_rng(2)
    step = np.where(np.arange(100) < 50, 0.0, 8.0)[:, None] * [0, 0, 1]
    places = {"a": step + np.array([5, 6, 7]), "base": np.tile([1.0, 2.0, 2.0], (100, 1))}
    noisy = {name: place + rng.normal(0, 0.02, place.shape) for name, place in places.items()}
    rounded = {name: np.round(place, 1) for name, place in noisy.items()}
    diagonal = {"a": np.linspace(0, 9, 100)[:, None] * [1, 1, 1] + 1.0, "b": noisy["a"]}
    for given in (places, noisy, rounded, diagonal):
        found = without_lost(given)
        assert all(np.isfinite(found[name]).all() for name in given)


def test_rejects_a_marker_that_is_never_seen(tmp_path):
    with pytest.raises(InputError, match=r"b\.csv: the marker M3 was not seen between 2 and 3 s"):
        observed(tmp_path, b=text_of(lost(slice(7, 13), 0.0)))
    with pytest.raises(InputError, match="was seen in only 1 of 5 frames"):
        observed(tmp_path, b=text_of(lost(slice(9, 13), -1.0)))


@pytest.mark.parametrize(
    "content",
    [
        text_of(rows(), mark=";", decimal=","),
        text_of(rows(), mark="\t"),
        text_of(rows(), mark="\t", decimal=","),
        text_of(rows(), mark=" "),
        "\ufeff" + text_of(rows()),
        text_of(rows()).encode("utf-16"),
        text_of(rows()).encode("utf-16-le"),
        text_of(rows()).replace("\n", "\r\n"),
        "# made by a tracker, version 3\n\n" + text_of(rows()).replace("\n", "\n\n"),
        "# " + text_of(rows()),
        text_of(rows()).replace("\n", "\ns," + ",".join(["mm"] * 12) + "\n", 1),
        text_of(rows()) + "," * 12 + "\n\n",
        text_of(rows(), [f'"{name}"' for name in HEAD]).replace("0.250000", '"0.250000"'),
        "\n".join(
            [";".join(HEAD), *(";".join(f"{v:.4f}".replace(".", ",") for v in r) for r in rows())]
        ),
        text_of(rows()).replace("-", "\u2212"),
    ],
)  # fmt: skip
def test_reads_the_conventions_of_exports(tmp_path, content):
    found = observed(tmp_path, content, content)
    np.testing.assert_allclose(found.moved_mm[0], TRUE_MM, atol=2e-4)
    assert found.notes == ()


def test_reads_separators_of_thousands(tmp_path):
    path = tmp_path / "a.csv"
    for text in ('a,b\n"1,234.5",2\n', "a;b\n1.234,5;2\n", "a;b\n1 234,5;2\n", "a;b\n1'234.5;2\n"):
        path.write_text(text)
        assert read_table(path, ["a", "b"])["a"].tolist() == [1234.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            text_of(rows(), decimal=","),
            r"line 2: 26 cells below a header of 13 columns\. This happens with dec",
        ),
        (text_of(rows()).replace("0.250000,", "", 1), "line 3: 12 cells below a header of 13"),
        ("a;b\n1,234;2\n", "line 2: '1,234' in column a may be a decimal comma or"),
        ("a;b\n1.5;2,5\n", r"mixes decimal points and commas: '1\.5' on line 2, '2,5' on line 2"),
        ("a,b,a\n1,2,3\n", "has the column a 2 times"),
        ("a,b\n1,2\n3,x\n", r"line 3: 'x' in column b is not a number\. Expected a number"),
        ("a,b\n1,2 mm\n", "line 2: '2 mm' in column b is not a number"),
        ("a,b\n", "no rows"),
        ("", "no rows"),
        (b"a,b\n1,\xb5\n", "is not text in UTF-8"),
        (b"PK\x03\x04\x00\x00\x00", "is not a text file"),
        ("t,b\n1,2\n", r"lacks the columns a; its columns are t, b"),
        ("a,b\nm,mm\n1,2\n", "line 2: the column a is in m, expected mm"),
    ],
)
def test_rejects_ambiguous_tables(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    columns = ["a", "b"] if len(text) < 200 else HEAD
    with pytest.raises(InputError, match=words):
        read_table(path, columns, units={"a": ("mm",)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[::-1], r"line 3: the time 2\.75 s follows 3 s on line 2\. Times must incr"),
        (lambda t: np.vstack([t, t[:1]]), r"line 15: the time 0 s follows 3 s on line 14"),
        (lambda t: np.vstack([t, t[-1:]]), r"line 15: the time 3 s follows 3 s"),
        (lambda t: t * np.where(np.arange(13) == 4, np.nan, 1)[:, None] ** [[1] + [0] * 12],
         "line 6: the row has no time"),
        (lambda t: t * [0.1, *[1] * 12], "repeats"),
    ],
)  # fmt: skip
def test_rejects_times_that_do_not_ascend(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        observed(tmp_path, a=text_of(change(rows())))


def test_rejects_metres_in_a_table_of_millimetres(tmp_path):
    small = rows() * [1, *[1e-3] * 12]
    with pytest.raises(InputError, match="No state moves the points by more than the noise"):
        observed(tmp_path, text_of(small), text_of(small))
    markers = described()["markers"] | {"mm_per_unit": 1000.0}
    with pytest.raises(InputError, match="farther than the size of the body"):
        observed(tmp_path, markers=markers)
    places = {n: {"at_mm": [c / 1000 for c in at]} for n, at in MARKERS.items()}
    markers = described()["markers"] | {"markers": places}
    with pytest.raises(InputError, match=r"span 0\.02 mm, but the body is 30 x 30 x 60 mm.*metres"):
        observed(tmp_path, markers=markers)
    far = {n: {"at_mm": [10 * c for c in at]} for n, at in MARKERS.items()}
    with pytest.raises(InputError, match="points are outside the body"):
        observed(tmp_path, markers=described()["markers"] | {"markers": far})


def test_repeats_far_above_the_stated_noise_need_a_confirmation(tmp_path):
    other = rows() + np.where(np.arange(13) > 6, 2.0, 0.0)[:, None] * [0, *[0, 0, 1] * 4]
    with pytest.raises(InputError, match=r"repeats of the state pulled scatter by .* times"):
        observed(tmp_path, b=text_of(other))
    markers = described()["markers"] | {"noise_confirmed": True}
    found = observed(tmp_path, b=text_of(other), markers=markers)
    assert confirmed_scatter(found)[0].startswith("The repeats of the state pulled scatter by")
    assert not confirmed_scatter(observed(tmp_path))


def test_warns_of_constants_outside_or_at_the_end_of_an_interval(tmp_path):
    spec = read_experiment(written(tmp_path)).spec
    (text,) = outside_intervals(spec, {"E": 9.393})
    assert text.startswith("E is outside its interval: 9.39e+03 kPa, stated 50 to 800")
    assert outside_intervals(spec, {"E": 0.05})[0].startswith("E is at the end of its interval")
    assert outside_intervals(spec, {"E": 0.2}) == ()
