"""`servo-bench effects`: what can be wrong with a rig, and how each of it shows."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_bytes, write_text
from servo_bench.diagnosis.judging.domains import Domains, domains
from servo_bench.diagnosis.judging.signature import CHANNELS, Rival, rivals, signatures
from servo_bench.errors import ConfigError
from servo_bench.report.effect_words import (
    docstring,
    kind_of,
    one_line,
    overview,
    place_of,
    range_of,
    sample_words,
)
from sim_rig.effects import catalogue, find_effect
from sim_rig.effects.effect import Effect

app = typer.Typer(help="What can be wrong with a rig, and how each of it shows.")
BAR = 12
ENDINGS = (".html", ".png")


@app.callback(invoke_without_command=True)
def effects(
    context: typer.Context,
    *,
    markdown: Annotated[bool, typer.Option(help="As a table in Markdown, for the docs.")] = False,
) -> None:
    """List every effect that the model can have; `effects show NAME` tells all about one."""
    if context.invoked_subcommand is None:
        if markdown:
            typer.echo(overview(), nl=False)
        else:
            _list()


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="Of the effect, as `servo-bench effects` lists it.")],
    out: Annotated[
        Path | None, typer.Option(help="Draw its signature into this file: .html or .png.")
    ] = None,
) -> None:
    """An effect's equation and parameters, and its computed signature and confusions."""
    effect = find_effect(name)
    if out is not None and out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"{out} ends in {out.suffix!r}: name a file that ends in .html or .png.")
    check_outputs(out)
    console = Console()
    _describe(console, effect)
    with console.status("simulating the whole catalogue"):
        every = signatures()
        found, alike = domains(every[name]), rivals(name, every)
    _judge(console, effect, found, alike)
    if out is not None:
        # matplotlib: only who wants a figure waits for it
        from servo_bench.report.effect_page import effect_html, effect_png  # noqa: PLC0415

        if out.suffix.lower() == ".png":
            write_bytes(out, effect_png(effect, every[name], found, alike))
        else:
            write_text(out, effect_html(effect, every[name], found, alike))
        console.print(f"written: {escape(str(out))}", soft_wrap=True)


def _list() -> None:
    console = Console()
    table = Table("effect", "law, and its main parameter", "confused with", show_edge=False)
    for effect in catalogue().values():
        main = effect.parameters[0]
        table.add_row(
            f"[bold]{effect.name}[/]\n[dim]{place_of(effect)}[/]",
            f"{escape(one_line(effect))}\n[dim]{main.name}: {range_of(main)}[/]",
            ", ".join(effect.confused_with),
        )
        table.add_section()
    console.print(table)
    console.print(
        f"{len(catalogue())} effects. All about one, with its computed signature: "
        "servo-bench effects show cogging --out cogging.html",
        highlight=False,
    )


def _describe(console: Console, effect: Effect) -> None:
    console.print(f"[bold]{effect.name}[/]  [dim]{place_of(effect)}[/]\n")
    console.print(docstring(effect), markup=False, highlight=False, soft_wrap=True)
    table = Table("parameter", "default", "usual range", "kind", show_edge=False, pad_edge=False)
    for parameter in effect.parameters:
        table.add_row(
            parameter.name,
            f"{parameter.default:.4g}",
            range_of(parameter),
            kind_of(parameter.prior),
        )
    console.print("", table, "")
    for name, words in (
        ("shows", effect.shows),
        ("confused with", ", ".join(effect.confused_with)),
        ("source", effect.source),
    ):
        console.print(f"[dim]{name}:[/] {escape(words)}", highlight=False)


def _judge(console: Console, effect: Effect, found: Domains, alike: Sequence[Rival]) -> None:
    console.print(f"\n[bold]Computed[/] for {sample_words(effect)}:\n", highlight=False)
    table = Table("share of the residual's variance", show_edge=False, pad_edge=False)
    for channel in CHANNELS:
        table.add_column(channel, justify="right")
    for domain, values in found.shares.items():
        table.add_row(domain, *(f"{100.0 * value:.1f} %" for value in values))
    console.print(table, "")
    table = Table("cosine with", "", show_edge=False, pad_edge=False)
    for channel in CHANNELS:
        table.add_column(channel, justify="right")
    for rival in alike:
        table.add_row(
            rival.name + (" *" if rival.declared else ""),
            "█" * round(BAR * rival.likeness),
            *(f"{value:+.2f}" for value in rival.cosines),
        )
    console.print(table)
    console.print("[dim]* named in the effect's file; bars: by the load encoder alone[/]")
