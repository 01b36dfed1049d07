"""The rules that a machine can check: style, types, imports, and that what is promised is there."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BIN = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [
        ("ruff", "check", "."),
        ("ruff", "format", "--check", "."),
        ("mypy",),
        ("lint-imports", "--no-cache"),
    ],
    ids=" ".join,
)
def test_the_tools_have_nothing_to_say(command: tuple[str, ...]) -> None:
    done = subprocess.run(
        [BIN / command[0], *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_top_level_is_the_one_that_was_agreed() -> None:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    allowed = {
        *("pyproject.toml", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE"),
        *("requirements.lock", ".gitignore"),
        *("servo_bench", "drivers", "sim_rig", "recordings", "tests", "docs", "examples", ".ci"),
    }
    assert {name.split("/")[0] for name in listed} <= allowed


def test_every_public_module_says_what_it_is() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for package in ("servo_bench", "drivers", "sim_rig")
        for path in (ROOT / package).rglob("*.py")
        if not path.read_text().lstrip().startswith('"""')
    ]
    assert silent == []


def test_nothing_loads_a_pickle() -> None:
    words = ("import pickle", "allow_pickle=True", "joblib", "import shelve", "import marshal")
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for package in ("servo_bench", "drivers", "sim_rig")
        for path in (ROOT / package).rglob("*.py")
        for word in words
        if word in path.read_text()
    ]
    assert found == []
