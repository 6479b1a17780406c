"""The command `palpate mammogram`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.command_line import store_place
from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import (
    JsonOption,
    StoreOption,
    StudyArgument,
    print_json,
)
from palpate.service.results.results_from_journal import study_results
from palpate.service.thesis.thesis_book import png_bytes
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.errors import InputError
from palpate.workers.comparison.mammogram_image import (
    dicom_bytes,
    difference_picture,
    grey_picture,
    mammogram_dataset,
)
from palpate.workers.tasks.mammogram_tasks import OBLIQUE_DEG, TakenView, take_view


def mammogram(
    study: StudyArgument = None,
    view: Annotated[
        list[str] | None,
        typer.Option(help="View: CC or MLO. Repeatable. Default: both.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write to. Default: mammograms in the study's folder.",
            show_default=False,
        ),
    ] = None,
    pixel_mm: Annotated[float, typer.Option(help="Detector pixel size in mm.")] = 0.2,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Add quantum and electronic noise.")
    ] = True,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate CC and MLO mammograms of a study's fitted body.

    The images are written as DICOM and PNG. The body has the fitted constants and is compressed by
    the study's own force or plates, rotated by 45 degrees for MLO. If the target's constants are
    known, the target is imaged too, together with the signed difference.
    """
    folder = find_study(study)
    results = study_results(folder)
    views: list[Any] = [v.upper() for v in view or OBLIQUE_DEG]
    unknown = [v for v in views if v not in OBLIQUE_DEG]
    if unknown:
        raise InputError(f"--view {unknown[0]}: expected CC or MLO.")
    if results.best is None:
        raise InputError(f"The study {folder} has no scored candidate yet: continue it first.")
    spec = results.spec
    target = spec.target.constants
    place = store_place(store or results.store)
    home = out or folder / "mammograms"
    written = []
    for each in views:
        taken = take_view(
            spec.case.model_dump(mode="json"),
            spec.constants_of(results.best.genes),
            None if target is None else spec.case.parameters.from_door(target),
            each,
            str(place),
            pixel_mm=pixel_mm,
            noise_seed=0 if noise else None,
        )
        written += _write(taken, home, results.name)
    if as_json:
        print_json({"study": results.name, "views": views, "files": [str(f) for f in written]})
        return
    for file in written:
        typer.echo(str(file))


def _write(taken: TakenView, folder: Path, name: str) -> list[Path]:
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    contents: dict[str, bytes] = {}
    for who, image in (("fitted", taken.fitted), ("target", taken.target)):
        if image is not None:
            contents[f"{who}.png"] = png_bytes(grey_picture(image))
            dataset = mammogram_dataset(image, taken.view, body_name=f"{name[:50]}^{who}")
            contents[f"{who}.dcm"] = dicom_bytes(dataset)
    if taken.target is not None:
        contents["difference.png"] = png_bytes(difference_picture(taken.fitted, taken.target))
    files = []
    for ending, content in contents.items():
        files.append(folder / f"{taken.view}-{ending}")
        write_file(files[-1], content)
    return files
