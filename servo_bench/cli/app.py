"""`servo-bench`: the commands gathered, and the one place where errors become exit codes.

Exit codes: 0 done, 1 any other failure of ours, 2-8 see `servo_bench.errors`, 130 stopped by the
operator before there was anything to keep.
"""

import sys

import typer
from rich.console import Console

from servo_bench import __version__
from servo_bench.cli import (
    analyse,
    benchmark,
    demo,
    drives,
    effects,
    export,
    fit,
    import_,
    paper,
    recover,
    rig,
    run,
    sequence,
)
from servo_bench.errors import BenchError, gathered

app = typer.Typer(
    name="servo-bench",
    help="A test bench for AC servo rigs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for command in (demo, rig, drives, run, analyse, fit, import_, export, recover, paper):
    command.add_to(app)
app.add_typer(sequence.app, name="sequence")
app.add_typer(effects.app, name="effects")
app.add_typer(benchmark.app, name="benchmark")


def _version(wanted: bool) -> None:
    if wanted:
        Console().print(f"servo-bench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and end."
    ),
) -> None:
    """A test bench for AC servo rigs: excite, record, identify.

    It is not a safety function: a rig needs a hard-wired emergency stop or STO, and an axis that
    holds a load needs its brake set before the drive is disabled.
    """


def main() -> None:
    """Entry point of the `servo-bench` program."""
    try:
        with gathered():
            app()
    except BenchError as error:
        _fail(str(error), error.exit_code)


def _fail(text: str, exit_code: int) -> None:
    Console(stderr=True).print("[bold red]error:[/]", end=" ")
    console = Console(stderr=True, markup=False, highlight=False, emoji=False, soft_wrap=True)
    console.print(text)
    sys.exit(exit_code)


if __name__ == "__main__":
    main()
