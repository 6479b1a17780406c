"""The command `palpate import`."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from palpate.service.commands.command_line import RUNS, store_place
from palpate.service.commands.images.image_preview import doubt, facts, terminal_lines, write_png
from palpate.service.commands.shared_options import (
    AnywayOption,
    JsonOption,
    StoreOption,
    print_findings,
    print_json,
)
from palpate.service.commands.terminal_tables import echo_table
from palpate.service.export.stored_files import check_suffix
from palpate.storage.backends.atomic_files import explained
from palpate.storage.errors import InputError
from palpate.storage.json_digests import array_digest, digest
from palpate.storage.store import Store, open_store
from palpate.storage.stored_arrays import save_volume, volume_meta, volumes_named
from palpate.storage.values import Volume
from palpate.workers.body.images.named_labels import read_tissues
from palpate.workers.body.images.scan_orientation import anatomical_directions
from palpate.workers.body.images.tiff_images import slices_read
from palpate.workers.body.images.tissue_labels import summarise
from palpate.workers.common_keys import Door, Name, validated
from palpate.workers.input_files import parse_yaml
from palpate.workers.organs.organ_plugins import organ_spec
from palpate.workers.organs.plausibility_rule import caveats_of
from palpate.workers.tasks.plausibility import imported_findings


def import_image(
    path: Annotated[
        Path, typer.Argument(help="NRRD, NIfTI, TIFF or .npy file, or folder of DICOM files.")
    ],
    name: Annotated[str, typer.Option(help="Name of the image in study files.")],
    labels: Annotated[
        str | None,
        typer.Option(
            help="Tissue of each label, by number (0=air,1=fat,2=glandular) or by name in the file "
            "(Adipose=fat,FGT=glandular), or a file that names the labels: .txt from ITK-SNAP, "
            ".ctbl from 3D Slicer, or .json. Default: from the label names in the image."
        ),
    ] = None,
    spacing_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="Voxel spacing, if the file does not give it."),
    ] = None,
    axes: Annotated[
        str | None,
        typer.Option(
            help="Image axes that are x (across), y (compression) and z (chest wall to nipple), "
            "such as -z,y,x; or the anatomical directions in which x, y and z increase, from L, R, "
            "P, A, S and I, such as 'L S A'."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            "--png",
            help="PNG file for three slices with their axes. Default: runs/images/NAME.png.",
            show_default=False,
        ),
    ] = None,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Reassign the name to this image if it belongs to another one. The other image "
            "stays in the store for studies that use it.",
        ),
    ] = False,
    anyway: AnywayOption = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Import a labelled image and show how it was read.

    The image is saved in the store. Check the printed size, axes, labels and volumes: all later
    results depend on them.
    """

    class Wanted(Door):
        name: Name

    validated(Wanted, {"name": name}, "The name (letters, digits, '.', '_' and '-')")
    spec: Any = validated(
        organ_spec("breast").target,
        {
            "volume": str(path),
            "labels": parse_labels(labels),
            "spacing_mm": spacing_mm,
            "axes": axes,
        },
        "The image's description",
    )
    check_suffix(picture, (".png",), "--picture ")
    read = read_tissues(path, spec.labels, spacing_mm=spec.spacing_mm, axes=spec.axes)
    volume = read.volume
    findings = imported_findings("breast", volume, path.name, anyway=anyway)
    opened = open_store(store_place(store))
    digest_of_image = _keep(opened, name, volume, path.name, replace=replace)
    letters = anatomical_directions(axes) if read.image.anatomical else None
    drawn = _draw(picture or RUNS / "images" / f"{name}.png", volume, name, letters)
    record = {
        "name": name,
        "volume": digest_of_image,
        "store": str(opened),
        "axes": axes or "x,y,z",
        "increasing_towards": None if letters is None else list(letters),
        "place_known": volume.place_known,
        "frame_uid": volume.frame_uid or None,
        "slices": slices_read(path),
        "label_names": {str(k): v for k, v in sorted(read.image.names.items())},
        "label_tissues": {str(k): t.name.lower() for k, t in sorted(read.tissues.items())},
        "doubt": doubt(volume, letters) or None,
        "remarks": list(read.image.remarks),
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


def _draw(path: Path, volume: Volume, name: str, letters: tuple[str, str, str] | None) -> Path:
    with explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    # Loads matplotlib, which other commands do without.
    from matplotlib import rc_context

    from palpate.service.report.drawing.matplotlib_figures import PLAIN_TEXT

    with rc_context(PLAIN_TEXT):
        write_png(path, volume, name, letters)
    return path


def _print(volume: Volume, record: dict[str, Any]) -> None:
    """Print facts and slices; without colours, the slices consist of letters."""
    echo_table(None, facts(record, record["axes"]))
    console = Console(highlight=False, markup=False)
    coloured = console.is_terminal and not console.no_color
    letters = record["increasing_towards"]
    for line in terminal_lines(volume, console.width, colours=coloured, letters=letters):
        console.print(line, no_wrap=True, overflow="crop")
    for remark in record["remarks"]:
        typer.echo(f"Remark: {remark}", err=True)
    if record["doubt"]:
        typer.echo(f"Check: {record['doubt']}", err=True)


def _keep(store: Store, name: str, volume: Volume, file: str, *, replace: bool) -> str:
    """Store a volume under a name and return its digest.

    Raises
    ------
    InputError
        If the name belongs to another volume and `replace` is false.
    """
    place = [list(volume.spacing_mm), list(volume.origin_mm), *volume.frame_facts]
    content = digest("import", name, array_digest(volume.values), *place)
    named = {v: volume_meta(store, v) for v in volumes_named(store, name)}
    same = [v for v, meta in named.items() if content in (v, meta.get("content"))]
    if same:
        return same[0]
    about: dict[str, Any] = {"kind": "image", "name": name, "file": file}
    if not named:
        save_volume(store, content, volume, meta=about)
        return content
    if not replace:
        other = next(iter(named.values())).get("file", "an unknown file")
        raise InputError(
            f"The store has another volume named {name}, read from {other}: another image, or the "
            "same one with different labels, spacing or axes. Choose another --name, or give "
            "--replace."
        )
    about |= {"content": content, "replaces": [*named, content]}
    kept = digest("replacement", content, list(named))
    save_volume(store, kept, volume, meta=about)
    return kept


def parse_labels(text: str | None) -> dict[int | str, str] | str | None:
    """Parse ``0=air,1=fat``, ``Adipose=fat`` or a mapping in YAML; return a file's path as text.

    Raises
    ------
    InputError
        If it is malformed.

    Examples
    --------
    >>> parse_labels("0=air,Adipose=fat"), parse_labels("{0: air, 1: fat}")
    ({0: 'air', 'Adipose': 'fat'}, {0: 'air', 1: 'fat'})
    """
    if text is None or ("=" not in text and Path(text).is_file()):
        return text
    if text.lstrip().startswith("{"):
        return {key: str(name) for key, name in parse_yaml(text, "--labels").items()}
    tissues: dict[int | str, str] = {}
    for part in text.split(","):
        label, equals, tissue = (piece.strip() for piece in part.rpartition("="))
        if not (equals and label and tissue):
            raise InputError(
                f"--labels {text}: expected e.g. 0=air,1=fat,2=glandular, names from the file "
                "such as Adipose=fat, or a file that names the labels."
            )
        key = int(label) if label.isdecimal() else label
        if key in tissues:
            raise InputError(f"--labels {text}: {key} is given twice.")
        tissues[key] = tissue
    return tissues
