"""Commands are imported when they are called: the table is true, and help waits for nothing."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from servo_bench.cli.app import COMMANDS, app
from servo_bench.cli.on_demand import loaded

HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pandas", "sklearn")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_says_what_the_command_itself_says(name: str) -> None:
    command = loaded(name, COMMANDS[name])
    assert command.name == name
    assert command.get_short_help_str(200) == COMMANDS[name].line


def test_the_help_names_every_command_and_imports_nothing_heavy() -> None:
    program = (
        "import sys; from servo_bench.cli.app import main\n"
        "try: main()\n"
        f"finally: print('imported:', [m for m in {HEAVY!r} if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True
    )
    assert "imported: []" in done.stdout
    assert all(f" {name} " in done.stdout for name in COMMANDS)


@pytest.mark.parametrize(("words", "said"), [("analyze", "analyse"), ("sequences", "sequence")])
def test_a_misspelt_command_is_answered_with_the_right_one(words: str, said: str) -> None:
    done = CliRunner().invoke(app, [words])
    assert done.exit_code == 2
    assert f"'{said}'" in done.output


def test_a_group_behind_the_table_has_its_own_commands() -> None:
    done = CliRunner().invoke(app, ["sequence", "--help"])
    assert done.exit_code == 0
    assert "search" in done.output
    assert "show" in done.output
