"""The live line of a run: where it is, how long it still takes, how punctual it was just now."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from servo_bench.run.session import Status


@contextmanager
def run_progress(console: Console) -> Iterator[Callable[[Status], None]]:
    """Yield the callback that a run session reports to; nothing is drawn before the rig moves."""
    columns = (
        TextColumn("{task.description:<15}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[left]:>5.0f} s left"),
        TextColumn("late {task.fields[late]}"),
        TextColumn("missed {task.fields[missed]}"),
    )
    bar = Progress(*columns, console=console)
    task = bar.add_task("setting up", total=None, left=0.0, late="-", missed=0)

    def report(status: Status) -> None:
        if status.slot == 0:
            return
        bar.start()
        bar.update(
            task,
            description=status.phase.name.lower().replace("_", "-"),
            total=status.slots,
            completed=status.slot + 1,
            left=status.seconds_left,
            late=_lateness(status),
            missed=status.missed,
        )

    try:
        yield report
    finally:
        bar.stop()


def _lateness(status: Status) -> str:
    return f"{status.lateness_p50_s * 1e6:.0f} us (max {status.lateness_max_s * 1e3:.1f} ms)"
