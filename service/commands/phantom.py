"""`palpate phantom`: a virtual breast."""

from pathlib import Path
from typing import Annotated

import typer

from service.commands.common import RUNS, JsonOption, StoreOption, print_json


def phantom(
    preset: Annotated[str, typer.Option(help="445ml or 250ml.")] = "445ml",
    spacing_mm: Annotated[
        float | None, typer.Option(help="Voxel size. Default: the preset's.", show_default=False)
    ] = None,
    glandular_fraction: Annotated[
        float | None, typer.Option(help="Share of the volume, 0 to 1.", show_default=False)
    ] = None,
    seed: Annotated[int, typer.Option(help="Another seed, another breast.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Write the labels as .nrrd.")] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Generate a virtual breast and keep it in the store."""
    from service.export import VOLUME_SUFFIXES, check_suffix, export_volume
    from storage.stores import open_store
    from workers.images.labels import summarise
    from workers.library import Library
    from workers.spec import ReferenceSpec, validated

    check_suffix(out, VOLUME_SUFFIXES)
    wanted = {
        "preset": preset,
        "spacing_mm": spacing_mm,
        "glandular_fraction": glandular_fraction,
        "seed": seed,
    }
    asked = {name: value for name, value in wanted.items() if value is not None}
    spec = validated(ReferenceSpec, {"phantom": asked}, "The phantom")
    library = Library(open_store(store or RUNS / "store"))
    name = library.reference(spec)
    volume = library.volume(name)
    if out is not None:
        export_volume(out, volume)
    found = {"volume": name, "store": str(library.store), **summarise(volume, named=True)}
    if as_json:
        print_json(found)
        return
    shape = " x ".join(str(n) for n in volume.shape_xyz)
    typer.echo(f"{name}: {shape} voxels of {volume.spacing_mm[0]:g} mm, in {library.store}")
    for label in found["labels"].values():
        typer.echo(f"  {label.get('tissue', '?'):<12}{label['ml']:10.1f} ml")
