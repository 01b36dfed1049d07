"""Whatever moves a rig on its own bus takes the rig's lock first, and says who has it."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.errors import BusyError
from servo_bench.files import find
from servo_bench.rig import load_rig
from servo_bench.run.lock import holding_rig
from servo_bench.run.virtual import save
from tests.small_runs import small_run
from tests.test_check import EXPERIMENT

PLAN = (
    'name = "axis"\nexperiment = "small.toml"\nrig = "rig.toml"\n[limits]\nnoise_rad_s.most = 1\n'
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig on a bus of a name that nobody else has, a plan for it, and a recording."""
    folder = tmp_path_factory.mktemp("master")
    paper = find("rigs/paper.toml").read_text(encoding="utf-8")
    own = paper.replace('channel = "can0"', f'channel = "{folder.parent.name}-{folder.name}"')
    assert own != paper
    (folder / "rig.toml").write_text(own)
    (folder / "small.toml").write_text(EXPERIMENT)
    (folder / "plan.toml").write_text(PLAN)
    save(small_run(1), folder / "run.mcap")
    return folder


ORDERS = {
    "run": ("run", "small.toml", "--rig", "rig.toml", "-o", "new.mcap"),
    "replay": ("replay", "run.mcap", "--against", "rig.toml", "--permit-real-rig"),
    "check": ("check", "plan.toml", "--permit-real-rig"),
}


@pytest.mark.parametrize("command", ORDERS)
def test_a_rig_that_somebody_has_is_not_moved(
    folder: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("the rig was moved")

    monkeypatch.setattr("servo_bench.cli.run.run_session", never)
    monkeypatch.chdir(folder)
    bus = load_rig("rig.toml").bus
    with holding_rig(bus, "the night shift"):
        done = CliRunner().invoke(cli.app, ORDERS[command])
    assert isinstance(done.exception, BusyError), done.output
    sentence = str(done.exception)
    assert sentence.startswith(f"servo-bench {command} cannot have servo-bench-")
    assert "it is held by the night shift (process " in sentence
    # and without the night shift it is this command's
    done = CliRunner().invoke(cli.app, ORDERS[command])
    assert isinstance(done.exception, AssertionError)


@pytest.mark.parametrize("words", [("--move", "--yes"), ()])
def test_a_rig_that_somebody_has_is_not_examined_either(
    folder: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("the rig was asked")

    for name in ("canopen.examine", "move.examine"):
        monkeypatch.setattr(f"servo_bench.run.doctor.{name}", never)
    monkeypatch.setattr("servo_bench.cli.preflight.read_drive", never)
    monkeypatch.chdir(folder)
    with holding_rig(load_rig("rig.toml").bus, "the night shift"):
        seen = CliRunner().invoke(cli.app, ("doctor", "--rig", "rig.toml", *words))
        told = CliRunner().invoke(
            cli.app, ("preflight", "small.toml", "--rig", "rig.toml", "--read")
        )
    assert seen.exit_code == 1, seen.output
    assert "held by the night shift" in " ".join(seen.output.split())
    assert isinstance(told.exception, BusyError)
    alone = CliRunner().invoke(cli.app, ("doctor", "--rig", "rig.toml", *words))
    assert isinstance(alone.exception, AssertionError)
