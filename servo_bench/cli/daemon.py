"""`servo-bench daemon`: the service that owns a rig, with its page and its API."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.errors import ConfigError

UNIT = Path(__file__).parent.parent / "daemon" / "servo-bench.service"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("daemon")(daemon)


def daemon(
    config: Annotated[
        str, typer.Option("--config", help="The bench's file; see docs/daemon.md.")
    ] = "bench.toml",
    *,
    print_unit: Annotated[
        bool, typer.Option("--print-unit", help="Print the systemd unit, and end.")
    ] = False,
) -> None:
    """Own a rig: run control, live page, catalogue, and API, until SIGTERM or Ctrl-C.

    Ending it stops the rig first. The queue is held after every start until an operator arms it.
    """
    if print_unit:
        Console(markup=False, highlight=False, soft_wrap=True).print(UNIT.read_text(), end="")
        return
    try:
        from servo_bench.daemon.config import load_bench  # noqa: PLC0415 - an extra
        from servo_bench.daemon.serve import serve  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"the daemon needs {error.name}, which is not installed. Install its extra: "
            "pip install 'servo-bench[daemon]'"
        ) from error
    serve(load_bench(config))
