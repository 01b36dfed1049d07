"""`servo-bench design diagnosis`: the experiment that best tells causes apart on a rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_text
from servo_bench.diagnosis.candidates import candidates
from servo_bench.diagnosis.design import Separation, ranked, separation
from servo_bench.diagnosis.judging.extended import toml_lines
from servo_bench.diagnosis.judging.undecided import check_effects
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.diagnosis.searching.classes import splitting
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment
from servo_bench.rig import load_rig

MOST_PAIRS = 3

app = typer.Typer(no_args_is_help=True, help="Design an experiment for a purpose.")


@app.callback()
def _group() -> None:
    """Design an experiment for a purpose."""


@app.command()
def diagnosis(
    *,
    rig: Annotated[str, typer.Option(help="Rig file: its nominal values and limits are used.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Write the experiment to this file.")],
    effects: Annotated[
        str, typer.Option(help="The causes to tell apart: all, or names with commas.")
    ] = "all",
    minutes: Annotated[float, typer.Option(min=0.1, max=600.0, help="How long it may play.")] = 1.0,
    period_s: Annotated[
        float, typer.Option(min=1e-4, max=1.0, help="Period of commands and samples.")
    ] = 0.008,
    verdict: Annotated[
        Path | None, typer.Option(help="Split what this verdict (JSON) could not tell apart.")
    ] = None,
) -> None:
    """Choose levels, bias, dwell, and amplitude by predicted separation of causes per minute.

    Prints the ranking of a small grid inside the rig's limits, and writes the best as an
    experiment that `servo-bench run` takes.
    """
    check_outputs(out)
    config = load_rig(rig)
    names = () if effects == "all" else tuple(n.strip() for n in effects.split(",") if n.strip())
    check_effects(names)
    if names and verdict is not None:
        raise ConfigError("--effects and --verdict both say what to tell apart: give one of them.")
    told = read_verdict(verdict) if verdict is not None else None
    pairs = ambiguous_pairs(told) if told is not None else frozenset[frozenset[str]]()
    only = tuple(sorted(frozenset().union(*pairs))) if pairs else names
    sizes = dict(told.effects) if told is not None else {}
    found = [
        separation(plan, config.model(), only=only, pairs=pairs, sizes=sizes)
        for plan in track(
            candidates(config, rig, minutes, period_s),
            description="playing",
            console=Console(stderr=True),
            transient=True,
        )
    ]
    ranking = ranked(found)
    _show(ranking)
    if told is not None:
        for pair in sorted(tuple(sorted(p)) for p in pairs):
            Console().print(f"{' against '.join(pair)}: {splitting(pair)}", soft_wrap=True)
    write_text(out, experiment_text(ranking[0].plan.experiment))
    Console().print(f"written: {escape(str(out))}", soft_wrap=True)


def experiment_text(experiment: Experiment) -> str:
    """The TOML text from which `load_experiment` makes the same experiment."""
    table = experiment.model_dump(mode="json", exclude_none=True)
    return "\n".join(toml_lines("", table)) + "\n"


def read_verdict(path: Path) -> Verdict:
    """A verdict's JSON; ConfigError where it is missing or none."""
    try:
        return Verdict.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}. Correct the path.") from error
    except ValidationError as error:
        what = error.errors(include_url=False)[0]
        raise ConfigError(
            f"{path} is no verdict: {'.'.join(map(str, what['loc'])) or 'file'}: {what['msg']}. "
            "Give what `servo-bench diagnose --json` wrote."
        ) from error


def ambiguous_pairs(verdict: Verdict) -> frozenset[frozenset[str]]:
    """Each cause with every name that it may be instead; ConfigError where there is none.

    A cause that is certain is paired with its best rival.
    """
    found: set[frozenset[str]] = set()
    for cause in verdict.causes:
        found |= {frozenset({cause.effect, other}) for other in cause.ambiguous_with}
    if not found:
        found = {frozenset({c.effect, c.rival}) for c in verdict.causes if c.rival is not None}
    if not found:
        raise ConfigError(
            f"the verdict is {verdict.verdict!r} and leaves no two causes to tell apart: design "
            "for the catalogue instead, with --effects and without --verdict."
        )
    return frozenset(found)


def _show(ranking: Sequence[Separation]) -> None:
    console = Console()
    table = Table("excitation", show_edge=False)
    for column in ("rad/s", "bias", "told", "σ/√min", "min to 5 σ"):
        table.add_column(column, justify="right")
    table.add_column("worst pair")
    for one in ranking:
        worst = f"{one.pairs[0].one}, {one.pairs[0].other}" if one.pairs else "-"
        table.add_row(
            one.plan.words,
            f"{one.plan.amplitude_rad_s:.3g}",
            f"{one.plan.bias_rad_s:.3g}",
            f"{100.0 * one.told:.0f} %",
            f"{one.worst:.3g}",
            f"{one.minutes_to_split:.2g}",
            worst,
        )
    console.print(table)
    best = ranking[0]
    for pair in best.pairs[1 : 1 + MOST_PAIRS]:
        console.print(f"next: {pair.one}, {pair.other}: {pair.apart:.3g} σ/√min", highlight=False)
    if len(best.pairs) > 1:
        console.print(
            f"[yellow]note:[/] the minutes are for the worst of {len(best.pairs)} confusable "
            f"pairs, at the smallest size that is worth a name; {best.split_in_a_minute} of them "
            "are told in one minute. Twice the size takes a quarter of the time.",
            soft_wrap=True,
        )
    if best.unseen:
        console.print(
            f"[yellow]note:[/] not shown at the smallest size worth a name: "
            f"{', '.join(best.unseen)}",
            soft_wrap=True,
        )
