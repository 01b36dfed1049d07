"""A group of commands whose modules are imported when they are called, and not before.

A command's module brings numpy, scipy, numba, or matplotlib: a second and more of imports. The
group shows a name and a line for each; the module behind the one that was called is loaded then.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup


class Entry(NamedTuple):
    """Where a command is, and its line in `servo-bench --help`.

    The module has either `add_to(app)`, which registers the command, or `app`, a group of them.
    """

    module: str
    line: str


class OnDemandGroup(TyperGroup):
    """A group of the commands in `entries`, which a subclass names."""

    entries: Mapping[str, Entry]

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, entry in self.entries.items():
            self.add_command(TyperCommand(name, help=entry.line))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Load the command that `args` begins with, and hand it over."""
        name = args[0]
        if name in self.entries:
            self.add_command(loaded(name, self.entries[name]), name)
        return super().resolve_command(ctx, args)


def loaded(name: str, entry: Entry) -> Any:
    """The command behind an entry, its module imported."""
    module = import_module(entry.module)
    holder = typer.Typer(rich_markup_mode="rich")
    if hasattr(module, "add_to"):
        module.add_to(holder)
    else:
        holder.add_typer(module.app, name=name)
    return typer.main.get_group(holder).commands[name]
