"""`palpate import`: an image into the store, under a name."""

from pathlib import Path
from typing import Annotated

import typer

from service.commands.common import RUNS, JsonOption, StoreOption, print_json
from storage.errors import InputError


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
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read a labelled image, name its tissues and keep it in the store."""
    from storage.digest import array_digest, digest
    from storage.stores import open_store
    from storage.volumes import list_volumes, save_volume, volume_meta
    from workers import pipeline
    from workers.images.labels import summarise
    from workers.spec import ImageSpec, validated

    spec = validated(
        ImageSpec,
        {"labels": parse_labels(labels), "spacing_mm": spacing_mm, "axes": axes},
        "The image's description",
    )
    volume = pipeline.image(path, spec)
    house = open_store(store or RUNS / "store")
    made = digest(
        "import", name, array_digest(volume.values), list(volume.spacing_mm), list(volume.origin_mm)
    )
    for other in list_volumes(house):
        if other != made and volume_meta(house, other).get("name") == name:
            raise InputError(f"The store has another volume named {name}: choose another name.")
    save_volume(house, made, volume, meta={"kind": "image", "name": name, "file": path.name})
    found = {"name": name, "volume": made, "store": str(house), **summarise(volume, named=True)}
    if as_json:
        print_json(found)
    else:
        typer.echo(f"{name} is in {house} as {made}. In a study: volume: {name}")


def parse_labels(text: str | None) -> dict[int, str] | None:
    """``0=air,1=fat`` as a mapping.

    Raises
    ------
    InputError
        If it does not read so.
    """
    if text is None:
        return None
    found: dict[int, str] = {}
    for part in text.split(","):
        number, equals, tissue = part.partition("=")
        if not (equals and number.strip().isdecimal() and tissue.strip()):
            raise InputError(f"--labels {text}: expected such as 0=air,1=fat,2=glandular.")
        if int(number) in found:
            raise InputError(f"--labels {text}: {int(number)} stands twice.")
        found[int(number)] = tissue.strip()
    return found
