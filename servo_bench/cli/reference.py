"""`servo-bench reference`: every command, option, key, and exit code, from the code itself.

`docs/reference.md` is what `servo-bench reference --markdown` writes; a test compares the two, so
that nothing can be added to the bench and be missing from its documentation.
"""

from collections.abc import Iterator
from typing import Annotated

import typer
from rich.console import Console
from rich.markdown import Markdown

from servo_bench.cli.check import NOT_PASSED
from servo_bench.cli.findings import FAILED
from servo_bench.cli.reference_commands import command_sections
from servo_bench.cli.reference_keys import FILES, key_sections
from servo_bench.cli.run import STOPPED_BY_OPERATOR
from servo_bench.errors import BenchError

_HEAD = """\
# Reference

Every command with its options (`--help` prints the same), every key of the files that people write
and of the verdict, and every exit code. In rig, experiment, bench, and plan a number, or a list of
numbers, may be given in a reader's unit instead: `_deg` for `_rad`, `_deg_s` or `_rpm` for
`_rad_s`, `_mnm` for `_nm`, `_ms` for `_s`. Written by `servo-bench reference --markdown`; a test
keeps it so. What to do with them is in the pages that [the index](index.md) names."""


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("reference")(reference)


def reference(
    *,
    markdown: Annotated[bool, typer.Option(help="As Markdown, for the docs.")] = False,
) -> None:
    """Every command, option, key, and exit code on one page."""
    if markdown:
        typer.echo(page(), nl=False)
    else:
        Console().print(Markdown(page()))


def page() -> str:
    """The page in Markdown: `docs/reference.md`."""
    lines = [_HEAD, "", "## Commands", "", *command_sections()]
    for file in FILES:
        lines += [f"## {file.title}", "", *key_sections(file)]
    codes = [f"| {code} | {meaning} |" for code, meaning in exit_codes().items()]
    lines += ["## Exit codes", "", "| code | meaning |", "|---|---|", *codes]
    return "\n".join(lines) + "\n"


def exit_codes() -> dict[int, str]:
    """What each exit code of `servo-bench` means, in rising order."""
    codes = {
        0: "Done.",
        FAILED: "`doctor` or `preflight` found what must be changed first; or any other failure.",
        NOT_PASSED: "The rig did not pass its acceptance plan (`check`).",
        STOPPED_BY_OPERATOR: "Stopped by the operator before there was anything to keep.",
    }
    for kind in _kinds(BenchError):
        sentence = " ".join((kind.__doc__ or "").split())
        codes[kind.exit_code] = f"{sentence} (`{kind.__name__}`)"
    return dict(sorted(codes.items()))


def _kinds(root: type[BenchError]) -> Iterator[type[BenchError]]:
    """The classes below `root` that have an exit code of their own."""
    for kind in root.__subclasses__():
        if "exit_code" in vars(kind):
            yield kind
        yield from _kinds(kind)
