"""`servo-bench replay REC`: to the page, against a rig, or through the analyser of today."""

import json as json_library
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table

from servo_bench.catalogue.beside import beside, read_json
from servo_bench.cli.keeping import recorded_at
from servo_bench.cli.output import check_outputs, write_json
from servo_bench.cli.run import play, tell_summary
from servo_bench.errors import ConfigError, LimitError, RecordingError
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.replay.against import Replayed
from servo_bench.replay.against import against as play_against
from servo_bench.replay.through import Reanalysis, reanalyse
from servo_bench.replay.to_page import Daemon, show
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.virtual import run_virtually, save


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("replay")(replay)


def replay(
    recording: Annotated[Path, typer.Argument(help="The recording (MCAP).")],
    *,
    to: Annotated[str | None, typer.Option(help="Show it on a daemon's page, by its URL.")] = None,
    speed: Annotated[float, typer.Option(min=0.1, help="With --to: times real time.")] = 1.0,
    start_s: Annotated[float, typer.Option(min=0.0, help="With --to: where to begin.")] = 0.0,
    token_file: Annotated[
        Path | None, typer.Option(help="With --to: the file with the daemon's token.")
    ] = None,
    against: Annotated[
        str | None, typer.Option(help="Play its command into this rig, and tell the difference.")
    ] = None,
    wire: Annotated[
        bool, typer.Option("--wire", help="With --against: a software rig on a bus, in wall time.")
    ] = False,
    permit_real_rig: Annotated[
        bool,
        typer.Option("--permit-real-rig", help="With --against: move the rig on the file's bus."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="With --against: keep the new recording.")
    ] = None,
    through: Annotated[
        Literal["analyser"] | None, typer.Option(help="Analyse it anew: what has changed?")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(help="With --through: the figures of then, instead of those beside it."),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(help="With --against or --through: write the result to this file."),
    ] = None,
) -> None:
    """Play a recording again: to the page, into a rig, or through today's analysis.

    --against plays on a software rig made from RIG's file; only --permit-real-rig moves the rig
    that the file's bus leads to, within the limits of the file.
    """
    if sum(way is not None for way in (to, against, through)) != 1:
        raise ConfigError("give one of --to URL, --against RIG, --through analyser.")
    if to is not None and (json or out):
        raise ConfigError("--to shows a run on the page and writes nothing: no --json, no --out.")
    if against is None and (out or wire or permit_real_rig):
        raise ConfigError("--out, --wire and --permit-real-rig go with --against: leave them out.")
    if through is None and figures:
        raise ConfigError("--figures are what --through compares with: leave them out.")
    check_outputs(json, out)
    console = Console(stderr=True, emoji=False)
    if to is not None:
        number = show(Daemon(to, _token(token_file)), recording, speed, start_s)
        console.print(f"run {number} plays on the page at {speed:g} times its time.", markup=False)
        return
    loaded = load(recording)
    if against is not None:
        rig = load_rig(against)
        played = _against(loaded, rig, console, out, wire=wire, permitted=permit_real_rig)
        _show_difference(played)
        _write(json, played.numbers())
    else:
        found = reanalyse(loaded, _stored(figures or beside(recording).figures))
        _show_changes(found)
        _write(json, found.numbers())


def _token(path: Path | None) -> str | None:
    try:
        return None if path is None else path.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the token file {path} cannot be read: {error}.") from error


def _against(
    recording: Recording,
    rig: RigConfig,
    console: Console,
    out: Path | None,
    *,
    wire: bool,
    permitted: bool,
) -> Replayed:
    if wire and permitted:
        raise ConfigError("--wire starts a software rig, --permit-real-rig moves a real one: one.")
    with recorded_at(out, "replay.mcap") as target:

        def on_a_bus(experiment: Experiment, config: RigConfig) -> Recording:
            summary = play(
                *(experiment, config, target, console),
                simulated=not permitted,
                who="servo-bench replay",
            )
            tell_summary(summary, console)
            if summary.stopped_early:
                raise LimitError("the operator stopped the run: there is nothing to compare.")
            return load(target)

        def in_virtual_time(experiment: Experiment, config: RigConfig) -> Recording:
            played = run_virtually(experiment, config)
            if out is not None:
                save(played, out)
            return played

        return play_against(recording, rig, on_a_bus if wire or permitted else in_virtual_time)


def _stored(path: Path) -> dict[str, Any]:
    table = read_json(path)
    if table is None:
        raise RecordingError(
            f"there are no figures of then at {path}. Name them with --figures, or keep today's "
            f"for the next time: servo-bench analyse {path.with_suffix('.mcap')} --json {path}"
        )
    return table


def _show_difference(played: Replayed) -> None:
    console = Console(markup=False, highlight=False, emoji=False, soft_wrap=True)
    console.print(f"{played.difference.slots} slots of both runs, new less old:")
    for signal in played.difference.signals:
        console.print(signal.sentence)


def _show_changes(found: Reanalysis) -> None:
    console = Console(markup=False, highlight=False, emoji=False, soft_wrap=True)
    console.print(f"{len(found.changes)} of {found.compared} figures have changed.")
    if found.changes:
        table = Table("figure", "then", "now", show_edge=False)
        for change in found.changes:
            table.add_row(change.name, _text(change.then), _text(change.now))
        console.print(table)
    for reason in found.reasons:
        console.print(reason)


def _text(value: Any) -> str:
    return json_library.dumps(value, ensure_ascii=False)


def _write(path: Path | None, numbers: dict[str, Any]) -> None:
    if path is not None:
        write_json(path, numbers)
