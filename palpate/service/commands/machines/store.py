"""The commands of `palpate store`: check, rm, gc, migrate, export and import."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.service.commands.command_line import RUNS, stated_store, store_place
from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import (
    JsonOption,
    StoreOption,
    StudyArgument,
    print_json,
)
from palpate.service.results.results_from_journal import RecordCheck, check_records
from palpate.service.study.store_use import (
    find_garbage,
    find_named,
    refuse_if_needed,
    remove,
    studies_in,
    study_use,
)
from palpate.service.study.study_archive import archived_name, export_study, import_study
from palpate.storage.backends.store_paths import Place
from palpate.storage.errors import InputError
from palpate.storage.store import Store, open_store
from palpate.storage.stored_arrays import remove_volume
from palpate.storage.upkeep import StoreCheck, check_store, maintaining, set_aside
from palpate.storage.upkeep import migrate as migrate_store

app = typer.Typer(
    no_args_is_help=True, help="Maintain a store: check it, free space, move studies."
)

GIB = 1024**3
SHOWN = 20


StudiesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--studies", help="Study folders, or folders of studies. Repeatable. Default: runs."
    ),
]


@app.command("check")
def check(
    studies: StudiesOption = None,
    store: StoreOption = None,
    repair: Annotated[
        bool,
        typer.Option(help="Set damaged entries aside; the next run of a study recreates them."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a store and the records of studies for damage.

    Every entry is read. The exit code is 2 if any is damaged.
    """
    opened = open_store(store_place(store), create=False)
    entries, records = check_store(opened), check_records(studies_in(studies or [RUNS]))
    aside = None
    if repair and entries.damages:
        with maintaining(opened, "palpate store check --repair"):
            aside = set_aside(opened, entries.damages)
    if as_json:
        print_json(_check_json(opened, entries, records, aside))
    else:
        _print_check(opened, entries, records, aside)
    if records.damages or (entries.damages and aside is None):
        raise typer.Exit(2)


def _check_json(
    store: Store, found: StoreCheck, records: RecordCheck, aside: Place | None
) -> dict[str, Any]:
    damages = [*found.damages, *records.damages]
    return {
        "store": str(store),
        "entries": found.counts,
        "studies": records.studies,
        "damaged": [{"path": str(d.path), "reason": d.reason} for d in damages],
        "half_written": [str(path) for path in found.leftovers],
        "unverified_journal_lines": records.unverified,
        "unchained_journal_lines": records.unchained,
        "entries_without_sealed_names": found.unnamed,
        "set_aside": None if aside is None else str(aside),
    }


def _print_check(
    store: Store, found: StoreCheck, records: RecordCheck, aside: Place | None
) -> None:
    counts = ", ".join(f"{number} {name}" for name, number in found.counts.items())
    typer.echo(f"{store}: {counts}; {len(found.leftovers)} half written; {records.studies} studies")
    for damage in [*found.damages, *records.damages]:
        typer.echo(f"damaged: {damage.reason}", err=True)
    if records.unverified:
        typer.echo(
            f"{records.unverified} lines of journals were written before checksums were "
            "introduced and cannot be verified"
        )
    if unchained := records.unchained - records.unverified:
        typer.echo(
            f"{unchained} lines of journals were written before chained seals: a line taken out of "
            "them is not noticed"
        )
    if found.unnamed:
        typer.echo(
            f"{found.unnamed} entries were written before their names were sealed: an exchange of "
            "two of them is not noticed"
        )
    if aside is not None:
        typer.echo(f"set aside in {aside}: {len(found.damages)}. Run the studies again.")
    elif found.damages:
        typer.echo("To set them aside: palpate store check --repair", err=True)
    elif not records.damages:
        typer.echo("all is well")


@app.command("rm")
def rm(
    names: Annotated[list[str], typer.Argument(help="Names given to `palpate import --name`.")],
    studies: StudiesOption = None,
    store: StoreOption = None,
    force: Annotated[
        bool, typer.Option("--force", help="Remove images even if studies need them.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Remove imported images by name.

    Nothing is removed if a study needs one of them, unless --force is given.
    """
    opened = open_store(store_place(store), create=False)
    volumes = find_named(opened, names, studies_in(studies or [RUNS]))
    if not force:
        refuse_if_needed(volumes)
    with maintaining(opened, "palpate store rm"):
        for volume in volumes:
            remove_volume(opened, volume.digest)
    if as_json:
        removed = [
            {"name": v.name, "volume": v.digest, "studies": [str(f) for f in v.studies]}
            for v in volumes
        ]
        print_json({"store": str(opened), "removed": removed})
        return
    for v in volumes:
        used = f"; needed by {', '.join(map(str, v.studies))}" if v.studies else ""
        typer.echo(f"{v.name} ({v.digest}) was removed from {opened}{used}")


@app.command("migrate")
def migrate(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Upgrade a store of an older version to the current schema.

    Nothing else may use the store meanwhile.
    """
    place = store_place(store)
    before, after = migrate_store(place)
    if as_json:
        print_json({"store": str(place), "before": before, "after": after})
    elif before == after:
        typer.echo(f"{place}: schema {after}, the current one; nothing to do")
    else:
        typer.echo(f"{place}: schema {before} is now {after}")


@app.command("gc")
def gc(
    studies: Annotated[
        list[Path] | None,
        typer.Option(help="Studies to keep, or folders of studies. Repeatable. Default: runs."),
    ] = None,
    store: StoreOption = None,
    older_than_days: Annotated[
        float, typer.Option(min=0, help="Keep entries newer than this, which a run may be using.")
    ] = 30.0,
    images: Annotated[
        bool, typer.Option(help="Include imported images, which cannot be recreated.")
    ] = False,
    delete: Annotated[
        bool, typer.Option("--delete", help="Delete the entries, instead of only listing them.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List data that no study needs, or delete it with --delete.

    This covers parts of diagnoses, and volumes and evaluations of removed studies.
    """
    opened = open_store(store_place(store), create=False)
    kept = studies_in(studies or [RUNS])
    if studies and not kept:
        raise InputError(f"There is no study in {', '.join(map(str, studies))}.")
    uses = [study_use(folder) for folder in kept]
    garbage = find_garbage(opened, uses, older_than_days=older_than_days, images=images)
    if delete:
        with maintaining(opened, "palpate store gc --delete"):
            remove(opened, garbage)
    if as_json:
        print_json(
            {"store": str(opened), "studies_kept": [str(folder) for folder in kept]}
            | {"entries": [str(p) for p in garbage.paths], "bytes": garbage.size_bytes}
            | {"deleted": delete}
        )
        return
    for path in garbage.paths[:SHOWN]:
        typer.echo(str(path))
    if len(garbage.paths) > SHOWN:
        typer.echo(f"and {len(garbage.paths) - SHOWN} more")
    what = "removed" if delete else "can be removed"
    typer.echo(
        f"{len(garbage.paths)} entries, {garbage.size_bytes / GIB:.2f} GiB, {what}; "
        f"data of {len(kept)} studies are kept"
    )
    if garbage.paths and not delete:
        typer.echo("To remove them, run the same command with --delete")


@app.command("export")
def export(
    study: StudyArgument = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Archive to write. Default: NAME.palpate.tar.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a study and the data it needs to one file."""
    folder = find_study(study)
    archive = out or Path(f"{folder.resolve().name}.palpate.tar")
    made = export_study(folder, archive)
    record = {"archive": str(archive), "study": made.name, "files": made.files}
    if as_json:
        print_json(record | {"bytes": made.size_bytes})
    else:
        typer.echo(f"{archive}: the study {made.name}, {made.files} files")
        typer.echo(f"to import it elsewhere: palpate store import {archive.name}")


@app.command("import")
def import_(
    archive: Annotated[Path, typer.Argument(help="Archive written by `palpate store export`.")],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--study", help="Folder for the study. Default: runs/NAME.", show_default=False
        ),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Unpack a study, to read, diagnose or continue it here.

    Import only archives that you trust.
    """
    home = folder or RUNS / archived_name(archive)
    made = import_study(archive, home, stated_store(store) or home.parent / "store")
    if as_json:
        print_json({"study": made.name, "folder": str(home), "files": made.files})
    else:
        typer.echo(f"{home}: the study {made.name}. See it with: palpate status {home}")
