"""Chapter on the simulated mammograms."""

from collections.abc import Sequence

from palpate.service.number_formatting import number
from palpate.service.report.page.page_elements import Picture, picture
from palpate.service.thesis import chapter_elements
from palpate.service.thesis.chapter_elements import Chapter, Table, cost_rows
from palpate.service.thesis.thesis_experiments import SHOWN_PHANTOM, exposures
from palpate.service.thesis.thesis_results import Cost, Exposed
from palpate.workers.tasks.thesis_tasks import ExposedPhantom
from palpate.workers.thesis.phantom_compression import PIXEL_MM, Scale


def chapter(found: Sequence[Exposed], cost: Cost | None, store: str, scale: Scale) -> Chapter:
    """Return the chapter that reproduces Fig. 4.18 of the thesis."""
    least = min((e.attenuation_rms / e.quantum_rms for e in found), default=0.0)
    most = max((e.attenuation_rms / e.quantum_rms for e in found), default=0.0)
    return Chapter(
        "mammogram",
        "Mammograms of both meshes",
        "Thesis 4.4",
        f"Around the glandular compartments, the two meshes differ by {number(least, 2)} to "
        f"{number(most, 2)} times the noise, as in the thesis.",
        "A projection of the pressed phantom from a point, polyenergetic, without scatter, with an "
        "ideal detector and two Poisson processes of noise; adaptive, homogeneous and their signed "
        "difference as one figure. Geometry, spectrum and dose are not printed.",
        "A cone from a point 650 mm above the detector through the labels of the voxels, exact "
        "path lengths, a tungsten tube at 28 kV behind rhodium, 60 mAs, an ideal detector with "
        f"pixels of {PIXEL_MM[scale]:g} mm, Poisson noise in every energy bin and electronic "
        "noise. Every phantom in both views, as PNG and DICOM next to this page.",
        tables=(_table(found),),
        pictures=_pictures(found, store, scale),
        differences=(
            "The difference is signed, as in the text; the caption of Fig. 4.18 calls it absolute.",
        ),
        costs=cost_rows(cost, "not printed"),
    )


def _table(found: Sequence[Exposed]) -> Table:
    rows = [
        [
            f"{e.phantom}, {e.view}",
            number(e.attenuation_rms, 3),
            number(e.quantum_rms, 3),
            number(e.attenuation_rms / e.quantum_rms, 3),
        ]
        for e in found
    ]
    headings = ("Phantom", "Difference of the meshes", "Of noise alone", "Ratio")
    note = "Root mean square of the difference of ln(open / energy), behind the body."
    return Table("Difference between the two meshes", headings, rows, note=note)


def _pictures(found: Sequence[Exposed], store: str, scale: Scale) -> list[Picture]:
    there = {(e.phantom, e.view) for e in found}
    made = []
    for request in exposures(store, scale):
        if request.phantom != SHOWN_PHANTOM or (request.phantom, request.view) not in there:
            continue
        _, arrays = request.part.load(ExposedPhantom)
        shown = [
            ("Adaptive mesh", arrays["adaptive"].T[::-1]),
            ("Homogeneous mesh", arrays["homogeneous"].T[::-1]),
            ("Signed difference", arrays["difference"].T[::-1]),
        ]
        made.append(
            picture(
                chapter_elements.pictures_in_a_row(shown),
                f"{request.view} mammograms of phantom {request.phantom} on both meshes, and "
                "their difference.",
                f"Phantom {request.phantom}, {request.view} (thesis Fig. 4.18); chest wall "
                "below. Grey: equal; white and black: a tenth of the attenuations' range.",
            )
        )
    return made
