"""The command `palpate phantom`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.service.commands.command_line import store_place
from palpate.service.commands.shared_options import JsonOption, StoreOption, print_json
from palpate.service.export import TISSUE_NAMES, VOLUME_SUFFIXES, check_suffix, export_volume
from palpate.storage.store import open_store
from palpate.workers.body.images.tissue_labels import summarise
from palpate.workers.common_keys import validated
from palpate.workers.organs.organ_plugins import organ_named, organ_spec
from palpate.workers.tasks.task_store import BodyStore


def phantom(
    preset: Annotated[str, typer.Option(help="Preset breast: 445ml or 250ml.")] = "445ml",
    spacing_mm: Annotated[
        float | None,
        typer.Option(help="Voxel size in mm. Default: the preset's.", show_default=False),
    ] = None,
    glandular_fraction: Annotated[
        float | None,
        typer.Option(
            help="Glandular share of the volume, 0 to 1. Default: the preset's.", show_default=False
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed; each seed gives a different breast.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(help="Also write the labels to this .nrrd, .seg.nrrd, .nii or .nii.gz file."),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Generate a virtual breast and save it in the store."""
    check_suffix(out, VOLUME_SUFFIXES)
    options = {
        "preset": preset,
        "spacing_mm": spacing_mm,
        "glandular_fraction": glandular_fraction,
        "seed": seed,
    }
    settings = {name: value for name, value in options.items() if value is not None}
    breast = organ_named("breast")
    case = validated(organ_spec("breast").case, {"reference": {"phantom": settings}}, "The phantom")
    bodies = BodyStore(open_store(store_place(store)), breast)
    name = bodies.bring_body(case.reference)
    volume = bodies.body(name)
    if out is not None:
        export_volume(out, volume, TISSUE_NAMES)
    summary = summarise(volume, named=True)
    record = {"volume": name, "store": str(bodies.store), **summary}
    if as_json:
        print_json(record)
        return
    shape = " x ".join(str(n) for n in volume.shape_xyz)
    typer.echo(f"{name}: {shape} voxels of {volume.spacing_mm[0]:g} mm, in {bodies.store}")
    for label in summary["labels"].values():
        typer.echo(f"  {label.get('tissue', '?'):<12}{label['ml']:10.1f} ml")
