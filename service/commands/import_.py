"""`palpate import` reads an image into the store, under a name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.commands.common import (
    AnywayOption,
    JsonOption,
    StoreOption,
    print_findings,
    print_json,
)
from service.commands.settings import RUNS, store_place
from storage.errors import InputError

if TYPE_CHECKING:
    from storage.stores import Store
    from storage.values import Volume


def import_image(
    path: Annotated[Path, typer.Argument(help="NRRD, NIfTI, TIFF, .npy, or a folder of DICOM.")],
    name: Annotated[str, typer.Option(help="What studies call it.")],
    labels: Annotated[
        str | None,
        typer.Option(help="0=air,1=fat,2=glandular: the tissue of each number in the image."),
    ] = None,
    spacing_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="Voxel spacing, where the file does not say."),
    ] = None,
    axes: Annotated[
        str | None,
        typer.Option(help="Which axes of the image are x, y and z here, such as -z,y,x."),
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option(
            help="Where to draw the slices. Default: runs/images/NAME.png.", show_default=False
        ),
    ] = None,
    anyway: AnywayOption = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read a labelled image, name its tissues, keep it in the store and show it.

    Look at what it says: size, axes and volumes are what everything later rests on.
    """
    from service.commands.image_preview import doubt
    from service.export.suffixes import check_suffix
    from service.spec import Name
    from storage.digest import array_digest, digest
    from storage.stores import open_store
    from storage.volumes import save_volume
    from workers.body.images.labels import summarise
    from workers.organs.registry import organ_named
    from workers.organs.study_checks import caveats_of
    from workers.spec import Door, validated
    from workers.tasks.study_checks import imported_findings

    class Wanted(Door):
        name: Name

    validated(Wanted, {"name": name}, "The name (letters, digits, '.', '_' and '-')")
    breast = organ_named("breast")
    spec = validated(
        breast.target_spec,
        {
            "volume": str(path),
            "labels": parse_labels(labels),
            "spacing_mm": spacing_mm,
            "axes": axes,
        },
        "The image's description",
    )
    check_suffix(png, (".png",), "--png ")
    volume = breast.make_body(spec)
    findings = imported_findings(breast.name, volume, path.name, anyway=anyway)
    opened = open_store(store_place(store))
    digest_of_image = digest(
        "import", name, array_digest(volume.values), list(volume.spacing_mm), list(volume.origin_mm)
    )
    _refuse_taken_name(opened, name, digest_of_image)
    save_volume(
        opened, digest_of_image, volume, meta={"kind": "image", "name": name, "file": path.name}
    )
    drawn = _draw(png or RUNS / "images" / f"{name}.png", volume, name)
    record = {
        "name": name,
        "volume": digest_of_image,
        "store": str(opened),
        "axes": axes or "x,y,z",
        "doubt": doubt(volume) or None,
        "findings": [finding.text for finding in findings],
        "caveats": list(caveats_of(findings)),
        "png": str(drawn),
        **summarise(volume, named=True),
    }
    if as_json:
        print_json(record)
        return
    print_findings(findings)
    _print(volume, record)
    typer.echo(f"slices: {drawn}")
    typer.echo(f"{name} is in {opened} as {digest_of_image}. In a study: volume: {name}")


def _draw(path: Path, volume: "Volume", name: str) -> Path:
    from service.commands.image_preview import write_png
    from storage.atomic import explained

    with explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, volume, name)
    return path


def _print(volume: "Volume", record: dict[str, Any]) -> None:
    """Print facts and slices; the slices with letters where there are no colours."""
    from rich.console import Console

    from service.commands.image_preview import facts, terminal_lines
    from service.commands.tables import echo_table

    axes = None if record["axes"] == "x,y,z" else record["axes"]
    echo_table(None, facts(record, axes))
    console = Console(highlight=False, markup=False)
    coloured = console.is_terminal and not console.no_color
    for line in terminal_lines(volume, console.width, colours=coloured):
        console.print(line, no_wrap=True, overflow="crop")
    if record["doubt"]:
        typer.echo(f"Check: {record['doubt']}", err=True)


def _refuse_taken_name(store: "Store", name: str, digest: str) -> None:
    from storage.volumes import list_volumes, volume_meta

    for other in list_volumes(store):
        if other != digest and volume_meta(store, other).get("name") == name:
            raise InputError(f"The store has another volume named {name}: choose another name.")


def parse_labels(text: str | None) -> dict[int, str] | None:
    """Parse ``0=air,1=fat`` as a mapping.

    Raises
    ------
    InputError
        If it does not read so.
    """
    if text is None:
        return None
    tissues: dict[int, str] = {}
    for part in text.split(","):
        number, equals, tissue = part.partition("=")
        if not (equals and number.strip().isdecimal() and tissue.strip()):
            raise InputError(f"--labels {text}: expected such as 0=air,1=fat,2=glandular.")
        if int(number) in tissues:
            raise InputError(f"--labels {text}: {int(number)} stands twice.")
        tissues[int(number)] = tissue.strip()
    return tissues
