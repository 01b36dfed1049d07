"""`servo-bench catalogue …`: the recordings of a folder: search, notes and tags, retention."""

import json as json_library
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from servo_bench.catalogue import Catalogue, Run
from servo_bench.catalogue.retention import age, delete, let_go
from servo_bench.cli.output import check_outputs, write_json
from servo_bench.errors import ConfigError, RecordingError
from servo_bench.files import read_toml

SHOWN = 50

app = typer.Typer(no_args_is_help=True, help="The recordings of a folder: find, annotate, prune.")
Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder",
        help="The folder of the recordings; by default that of the bench.toml here, or else this.",
    ),
]
Index = Annotated[
    Path | None, typer.Option("--index", help="The index's file, instead of one in the folder.")
]
Which = Annotated[str, typer.Argument(help="The run's id, or the path of its recording.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the runs to this file.")]
BENCH = Path("bench.toml")
RECORDINGS = "recordings"
"""Of a bench file that does not say where."""


@app.command()
def search(
    words: Annotated[
        list[str] | None, typer.Argument(help="Words that must all occur; none: every run.")
    ] = None,
    *,
    tag: Annotated[str | None, typer.Option(help="Only runs with this tag.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many.")] = SHOWN,
    offset: Annotated[int, typer.Option(min=0, help="Leave out so many of the latest.")] = 0,
    folder: Folder = None,
    index: Index = None,
    json: Json = None,
) -> None:
    """Runs in whose name, experiment, rig, notes, tags, or verdict every word occurs."""
    check_outputs(json)
    catalogue = Catalogue(_chosen(folder), index)
    catalogue.refresh()
    page = catalogue.search(" ".join(words or ()), tag, limit, offset)
    if json is not None:
        write_json(json, {"total": page.total, "runs": [run.row() for run in page.runs]})
    _show(page.runs)
    if page.total > len(page.runs):
        Console(stderr=True).print(f"{len(page.runs)} of {page.total}: see --limit and --offset")


@app.command()
def show(which: Which, *, folder: Folder = None, index: Index = None) -> None:
    """All that the catalogue knows of a run, as JSON."""
    catalogue, number = _one(which, folder, index)
    typer.echo(json_library.dumps(catalogue.get(number).row(), indent=2))


@app.command()
def note(
    which: Which,
    *,
    notes: Annotated[str | None, typer.Option(help="The notes, instead of what is there.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="A tag to give. Repeatable.")] = None,
    untag: Annotated[list[str] | None, typer.Option(help="A tag to take. Repeatable.")] = None,
    operator: Annotated[str | None, typer.Option(help="Who ran it.")] = None,
    folder: Folder = None,
    index: Index = None,
) -> None:
    """Write notes and tags beside a recording; they outlive the index."""
    catalogue, number = _one(which, folder, index)
    before = catalogue.get(number).tags
    tags = [*(one for one in before if one not in (untag or ())), *(tag or ())]
    _show([catalogue.annotate(number, notes=notes, tags=tags, operator=operator)])


@app.command()
def rebuild(*, folder: Folder = None, index: Index = None) -> None:
    """Read every recording again, into a new index where the old one is damaged."""
    done = Catalogue(_chosen(folder), index).rebuild()
    Console(stderr=True).print(f"{done.added + done.changed + done.unchanged} recordings")


@app.command()
def prune(
    *,
    older_than: Annotated[str, typer.Option(help="An age: 36h, 90d, 12w, 2y.")],
    keep_tag: Annotated[
        list[str] | None, typer.Option(help="Runs with this tag are kept. Repeatable.")
    ] = None,
    deleting: Annotated[
        bool, typer.Option("--delete", help="Delete them, after asking; else they are listed.")
    ] = False,
    confirmed: Annotated[
        int | None,
        typer.Option(help="Do not ask: delete if it is exactly so many recordings."),
    ] = None,
    folder: Folder = None,
    index: Index = None,
) -> None:
    """List recordings that are older than an age and bear no tag that keeps them.

    With --delete they and the files beside them are deleted, once their number is confirmed.
    """
    catalogue = Catalogue(_chosen(folder), index)
    catalogue.refresh()
    found = let_go(catalogue.all(), age(older_than), keep_tag or (), datetime.now(UTC))
    _show(found)
    console = Console(stderr=True, emoji=False)
    size_mb = sum(run.bytes for run in found) / 1e6
    console.print(f"{len(found)} recordings, {size_mb:.1f} MB, are older than {older_than}.")
    if not deleting or not found:
        return
    if confirmed is None:
        confirmed = typer.prompt(f"Type {len(found)} to delete them for good", type=int, err=True)
    if confirmed != len(found):
        raise ConfigError(
            f"{confirmed} were confirmed and {len(found)} would go: nothing was deleted."
        )
    done = delete(catalogue, found)
    console.print(f"{done.deleted} deleted, {done.bytes / 1e6:.1f} MB.")
    if done.kept:
        raise RecordingError("kept: " + "; ".join(done.kept))


def _chosen(folder: Path | None) -> Path:
    """The folder that is meant: in that of a daemon the same runs have the daemon's ids."""
    if folder is not None:
        return folder
    if not BENCH.is_file():
        return Path()
    return Path(str(read_toml(BENCH).get("recordings", RECORDINGS)))


def _one(which: str, folder: Path | None, index: Path | None) -> tuple[Catalogue, str]:
    """The catalogue, and the id of a run that was named by id or by path."""
    path = Path(which)
    named = path.suffix.lower() == ".mcap"
    catalogue = Catalogue(path.parent if named and folder is None else _chosen(folder), index)
    catalogue.refresh()
    return catalogue, catalogue.id_of(path) if named else which


def _show(runs: Iterable[Run]) -> None:
    table = Table(show_edge=False, pad_edge=False)
    for column in ("id", "started (UTC)", "s", "state"):
        table.add_column(column, no_wrap=True)
    for column in ("name", "VAF fresh", "verdict", "tags"):
        table.add_column(column, overflow="fold")
    for run in runs:
        vaf = run.figures.get("vaf_fresh_order3_percent")
        table.add_row(
            *(run.id, run.started_utc[:16].replace("T", " ")),
            f"{run.seconds:.0f}" if run.seconds is not None else "",
            *(run.state, run.name),
            f"{vaf:.2f} %" if isinstance(vaf, float) else "",
            " ".join([run.verdict or "", *run.causes]).strip(),
            " ".join(run.tags),
        )
    console = Console(markup=False, emoji=False, highlight=False)
    console.print(table)
