"""The commands in Markdown: their usage, their words, and every argument and option.

All of it is asked of the command tree that `servo-bench --help` prints.
"""

import inspect
from collections.abc import Iterator
from typing import Any, NamedTuple

import typer

from servo_bench.cli.app import COMMANDS, app
from servo_bench.cli.on_demand import loaded


class Node(NamedTuple):
    """A command and the words that call it: ("effects", "show"); the program itself has none."""

    words: tuple[str, ...]
    command: Any

    @property
    def name(self) -> str:
        """As it is typed."""
        return " ".join(("servo-bench", *self.words))


def nodes() -> Iterator[Node]:
    """The program, every command, and every command of a group, in the order of the help."""
    yield Node((), typer.main.get_command(app))
    for name, entry in COMMANDS.items():
        yield from _below(Node((name,), loaded(name, entry)))


def _below(node: Node) -> Iterator[Node]:
    yield node
    for name, command in getattr(node.command, "commands", {}).items():
        yield from _below(Node((*node.words, name), command))


def command_sections() -> Iterator[str]:
    """The lines of the page, a section for each command."""
    for node in nodes():
        context = typer.Context(node.command, info_name=node.name)
        usage = " ".join((node.name, *node.command.collect_usage_pieces(context)))
        yield from (f"### `{node.name}`", "", f"    {usage}", "")
        yield from (inspect.cleandoc(node.command.help or ""), "")
        rows = [
            f"| {_code(left)} | {cell(right)} |"
            for parameter in node.command.params
            if (record := parameter.get_help_record(context)) is not None
            for left, right in [record]
        ]
        if rows:
            yield from ("| argument or option | meaning |", "|---|---|", *rows, "")


def _code(text: str) -> str:
    return f"`{cell(text)}`"


def cell(text: str) -> str:
    """A text as it may stand in a table of Markdown: one line, no bar that ends the cell."""
    return " ".join(text.split()).replace("|", r"\|")
