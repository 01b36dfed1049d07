"""`servo-bench`: the commands gathered, and the one place where errors become exit codes.

Exit codes: 0 done, 1 any other failure of ours, 2-9 see `servo_bench.errors`, 10 a rig that did not
pass its acceptance plan, 130 stopped by the operator before there was anything to keep.
"""

import os
import sys

import typer
from rich.console import Console

from servo_bench import __version__
from servo_bench.cli.on_demand import Entry, OnDemandGroup
from servo_bench.errors import BenchError, gathered

COLUMNS = 200
"""Of a table that goes to no terminal."""

# To register a command add its row, in the order of the help: the name; its module, which has an
# `add_to(app)`, or an `app` of its own if it is a group; and the first sentence of its help (a
# test compares them). Do not import the module here: `--help` must not wait for numpy.
COMMANDS = {
    "demo": Entry(
        "servo_bench.cli.demo",
        "Start the software rig, run a 44 s experiment on its wire, analyse it, write the report.",
    ),
    "rig": Entry(
        "servo_bench.cli.rig",
        "Start the software rig: drive and encoder on a bus, standing in for the hardware.",
    ),
    "drives": Entry(
        "servo_bench.cli.drives",
        "List the drives and serial counters that a rig file can name; a new one needs a TOML "
        "file and no code.",
    ),
    "doctor": Entry(
        "servo_bench.cli.doctor",
        "Examine computer, wire, drive, and encoder, and print what to change.",
    ),
    "preflight": Entry(
        "servo_bench.cli.preflight",
        "Say what an experiment will do to a rig: travel, current, heat, units, ramps, wire.",
    ),
    "run": Entry("servo_bench.cli.run", "Play an experiment on a rig and record it."),
    "analyse": Entry(
        "servo_bench.cli.analyse",
        "Extract the Volterra kernels of a recording and judge them on its held-out validation.",
    ),
    "fit": Entry(
        "servo_bench.cli.fit",
        "Fit numbers of the rig's model to a recording, with standard errors.",
    ),
    "diagnose": Entry(
        "servo_bench.cli.diagnose",
        "Say what the simulation of a rig gets wrong, name the cause, and measure what mending "
        "gains.",
    ),
    "design": Entry("servo_bench.cli.design", "Design an experiment for a purpose."),
    "import": Entry(
        "servo_bench.cli.import_", "Turn measured data from elsewhere into a recording."
    ),
    "export": Entry(
        "servo_bench.cli.export",
        "Write every channel of a recording, with units in the columns' names.",
    ),
    "recover": Entry(
        "servo_bench.cli.recover",
        "Write everything that a cut recording still holds into a new, complete file.",
    ),
    "paper": Entry(
        "servo_bench.cli.paper",
        "Compute the paper's simulation again: a second-order system with backlash, and its "
        "kernels.",
    ),
    "sequence": Entry(
        "servo_bench.cli.sequence", "Choose an M-sequence, and see what it can tell."
    ),
    "effects": Entry(
        "servo_bench.cli.effects", "What can be wrong with a rig, and how each of it shows."
    ),
    "daemon": Entry(
        "servo_bench.cli.daemon",
        "Own a rig: run control, live page, catalogue, and API, until SIGTERM or Ctrl-C.",
    ),
    "stop": Entry(
        "servo_bench.cli.stop",
        "Stop the rig and hold the daemon's queue; works even when the daemon has crashed.",
    ),
    "catalogue": Entry(
        "servo_bench.cli.catalogue", "The recordings of a folder: find, annotate, prune."
    ),
    "replay": Entry(
        "servo_bench.cli.replay",
        "Play a recording again: to the page, into a rig, or through today's analysis.",
    ),
    "compare": Entry(
        "servo_bench.cli.compare",
        "Compare two recordings: kernels, noise, and the rig's numbers, with standard errors.",
    ),
    "check": Entry(
        "servo_bench.cli.check",
        "Play a plan's experiment and judge the result: figures, fitted numbers, verdict.",
    ),
    "benchmark": Entry(
        "servo_bench.cli.benchmark", "Measure the bench, with a reference beside it."
    ),
    "reference": Entry(
        "servo_bench.cli.reference", "Every command, option, key, and exit code on one page."
    ),
}


class Commands(OnDemandGroup):
    """The commands of the bench."""

    entries = COMMANDS


app = typer.Typer(
    name="servo-bench",
    cls=Commands,
    help="A test bench for AC servo rigs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


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
    if not sys.stdout.isatty():  # a pipe or a log has no edge at which a number could be cut
        os.environ.setdefault("COLUMNS", str(COLUMNS))
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
