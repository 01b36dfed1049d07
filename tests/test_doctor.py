"""The doctor against the software rig: what is right, and each thing that can be wrong."""

import json
import math
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.canopen.budget import bus_budget, frame_bits
from drivers.errors import DriveError
from servo_bench.cli.app import app
from servo_bench.cli.doctor import _move
from servo_bench.errors import WireError
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.doctor import canopen, host, modbus, move
from servo_bench.run.finding import Finding, Level
from servo_bench.run.session import RunSummary
from sim_rig.process import spawn
from tests.fake_canopen import U16, Entry, FakeRig

PERIOD_S = 0.008


@pytest.fixture(scope="module")
def rig() -> Iterator[RigConfig]:
    """One software rig for all: nobody leaves it otherwise than it was found."""
    config = load_rig("rigs/paper.toml").on_a_free_port()
    with spawn(config.simulation_settings()) as started:
        yield config.with_bus(**started.bus)


def changed(rig: RigConfig, **tables: dict[str, object] | None) -> RigConfig:
    """The same rig, its file saying something else."""
    table = rig.model_dump(mode="json")
    for name, keys in tables.items():
        table[name] = None if keys is None else (table[name] or {}) | keys
    return RigConfig.model_validate(table)


def stops(findings: list[Finding]) -> dict[str, str]:
    return {it.subject: it.text for it in findings if it.level is Level.STOP}


@pytest.mark.wire
def test_a_rig_that_is_as_its_file_says_has_nothing_to_stop(rig: RigConfig) -> None:
    findings = canopen.examine(rig.canopen_settings(PERIOD_S))
    assert stops(findings) == {}
    told = {it.subject: it.text for it in findings}
    assert "node 1: CiA 402 drive" in told["nodes"]
    assert "node 2: CiA 406 encoder" in told["nodes"]
    assert "0.3 s after its last word" in told["own stop"]
    assert {"bus load", "drive's ratios", "encoder's counts", "state"} <= set(told)


@pytest.mark.wire
@pytest.mark.parametrize(
    ("tables", "subject", "words"),
    [
        ({"drive": {"node_id": 7}}, "drive", "no node 7 on this bus; there: 1, 2. Correct drive."),
        ({"encoder": {"node_id": 9}}, "encoder", "no node 9"),
        ({"drive": {"product_code": 5}}, "drive's identity", "the configuration says 0x5"),
        ({"drive": {"profile": "maxon-epos4", "vendor_id": None}}, "drive's identity", "0xFB"),
        ({"drive": {"counts_per_revolution": 4096}}, "drive's ratios", "65536"),
        ({"encoder": {"counts_per_revolution": 1000}}, "encoder's counts", "65536"),
        ({"encoder": {"vendor_id": 3}}, "encoder's identity", "another device"),
    ],
)
def test_what_the_file_says_otherwise_is_named_with_what_to_change(
    rig: RigConfig, tables: dict[str, dict[str, object] | None], subject: str, words: str
) -> None:
    found = stops(canopen.examine(changed(rig, **tables).canopen_settings(PERIOD_S)))
    assert set(found) == {subject}
    assert words in found[subject]


@pytest.mark.wire
def test_an_encoder_with_the_wrong_sign_trips_early_and_the_change_is_said(
    rig: RigConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what was recorded until then is kept: it shows more than a sentence can."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    findings = move.examine(changed(rig, encoder={"direction": -1}), PERIOD_S)
    (kept,) = (f.text.split(": ", 1)[1] for f in findings if f.subject == "recording")
    assert load(Path(kept), allow_cut=True).channels["load_angle_rad"].size
    found = stops(findings)
    assert "encoders disagree" in found["move"] or "left the motor's" in found["move"]
    assert "Set encoder.direction = 1." in found["load encoder"]
    assert "motor" not in found


@pytest.mark.long
@pytest.mark.wire
def test_an_encoder_with_wrong_counts_is_given_the_right_ones(rig: RigConfig) -> None:
    second = {"second_encoder": {"counts_per_revolution": 50000}}
    wrong = changed(rig, encoder=None, drive=second)
    found = stops(move.examine(wrong, PERIOD_S))
    said = found["load encoder"]
    told = float(said.split("= about ")[1].split()[0])
    assert told == pytest.approx(65536, rel=0.01)


@pytest.mark.wire
def test_the_command_asks_before_it_moves_and_says_that_the_rig_is_ready(rig: RigConfig) -> None:
    port = str(rig.bus["port"])
    refused = CliRunner().invoke(app, ["doctor", "--port", port, "--move"], input="n\n")
    assert refused.exit_code == 0, refused.output
    assert "Is the rig clear" in refused.output
    assert "were not tried" in refused.output
    moved = CliRunner().invoke(app, ["doctor", "--port", port, "--move", "--yes"])
    assert moved.exit_code == 0, moved.output
    assert "the load's encoder counts +1.0" in moved.output
    assert "the rig is ready." in moved.output


def test_nobody_there_is_one_line_and_an_exit_code() -> None:
    told = CliRunner().invoke(app, ["doctor", "--port", "9"])
    assert told.exit_code == 1
    assert "no socketcand server" in told.output


@pytest.mark.wire
def test_a_drive_on_modbus_is_examined_and_a_wrong_one_refused() -> None:
    config = load_rig("rigs/modbus-tcp.toml").on_a_free_port()
    with spawn(config.simulation_settings()) as started:
        config = config.with_bus(**started.bus)
        findings = modbus.examine(config.modbus_settings(PERIOD_S))
        assert stops(findings) == {}
        assert {it.subject for it in findings} == {
            *("drive's identity", "state", "line", "own stop"),
        }
        other = changed(config, drive={"counts_per_revolution": 4096})
        found = stops(modbus.examine(other.modbus_settings(PERIOD_S)))
        assert "is 65536" in found["drive's identity"]


def test_this_computer_is_judged_whatever_it_is() -> None:
    subjects = [it.subject for it in host.examine()]
    assert {"scheduling", "locked memory", "clock", "wake-ups", "processors"} <= set(subjects)
    assert all(it.level is not Level.STOP for it in host.examine())


LINK = {
    "linkinfo": {
        "info_data": {"state": "ERROR-ACTIVE", "restart_ms": 100},
        "info_xstats": {"bus_error": 0, "error_passive": 0},
    }
}


@pytest.mark.parametrize(
    ("data", "counts", "levels", "words"),
    [
        ({}, {}, [Level.OK], "no errors counted"),
        ({}, {"bus_error": 12}, [Level.CHANGE], "bus_error 12"),
        ({"state": "ERROR-PASSIVE"}, {}, [Level.STOP], "120 ohm"),
        ({"restart_ms": 0}, {}, [Level.OK, Level.CHANGE], "restart-ms 100"),
    ],
)
def test_the_kernels_error_counters_are_read_in_words(
    data: dict[str, object], counts: dict[str, int], levels: list[Level], words: str
) -> None:
    info = LINK["linkinfo"]
    link = {
        "linkinfo": {
            "info_data": info["info_data"] | data,
            "info_xstats": info["info_xstats"] | counts,
        }
    }
    findings = canopen.judge_link(json.dumps([link]), "can0")
    assert [it.level for it in findings] == levels
    assert words in " ".join(it.text for it in findings)


@pytest.mark.parametrize("told", ["", "[]", "{}", "[1]", '[{"linkinfo": 5}]', "not json"])
def test_an_ip_that_says_something_else_is_a_note(told: str) -> None:
    assert [it.level for it in canopen.judge_link(told, "can0")] == [Level.NOTE]


def test_the_torque_limit_is_lowered_and_given_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    fake.drive.objects[0x6072, 0] = Entry(U16, 1500)
    settings = fake.settings()
    with canopen.lowered_torque(settings, 300) as finding:
        assert "from 1500 to 300" in finding.text
        assert fake.drive[0x6072, 0] == 300
    assert fake.drive[0x6072, 0] == 1500
    with pytest.raises(KeyError), canopen.lowered_torque(settings, 300):
        raise KeyError("the move failed")
    assert fake.drive[0x6072, 0] == 1500
    fake.drive[0x6072, 0] = 200
    with canopen.lowered_torque(settings, 300):
        assert fake.drive[0x6072, 0] == 200, "never raised"


def test_a_torque_limit_that_cannot_be_given_back_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    fake.drive.objects[0x6072, 0] = Entry(U16, 1500)
    left = r"is gone.* 0x6072 may still be 300 per mille, was 1500: write it back\."
    with pytest.raises(WireError, match=left), canopen.lowered_torque(fake.settings(), 300):
        fake.world.dead = True


def test_whoever_is_interrupted_while_lowering_the_torque_gives_it_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    fake.drive.objects[0x6072, 0] = Entry(U16, 1500)
    on_write = fake.drive.on_write

    def interrupt(index: int, sub: int, value: int) -> None:
        on_write(index, sub, value)
        if (index, value) == (0x6072, 300):
            raise KeyboardInterrupt

    monkeypatch.setattr(fake.drive, "on_write", interrupt)
    with pytest.raises(KeyboardInterrupt), canopen.lowered_torque(fake.settings(), 300):
        pytest.fail("entered")
    assert fake.drive[0x6072, 0] == 1500


def test_a_signal_ends_the_move_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    left = []

    @contextmanager
    def lowered(rig: RigConfig, _period_s: float) -> Iterator[tuple[RigConfig, Finding]]:
        yield rig, Finding(Level.OK, "torque limit", "lowered")
        left.append("given back")

    def interrupted(
        plan: Experiment, _: RigConfig, out: Path, *, stop: Callable[[], bool], **__: object
    ) -> RunSummary:
        signal.raise_signal(signal.SIGINT)
        assert stop()
        return RunSummary(out, plan.schedule().slots, 0, 0, stopped_early=True)

    monkeypatch.setattr(move, "_lowered", lowered)
    monkeypatch.setattr(move, "run", interrupted)
    told = _move(load_rig("rigs/paper.toml"), PERIOD_S, [], yes=True)
    assert "(Ctrl-C): repeat it." in stops(told)["move"]
    assert left == ["given back"]


def test_a_second_bench_ends_the_examination(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    fake.world.deliver(0x77F, b"\x05")
    with pytest.raises(WireError, match="another master"):
        canopen.examine(fake.settings())


def test_a_drive_that_refuses_a_lower_torque_is_not_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    fake.drive.objects[0x6072, 0] = Entry(U16, 1500)
    fake.drive.sticky.add((0x6072, 0))
    entering = canopen.lowered_torque(fake.settings(), 300)
    with pytest.raises(Exception, match="keeps") as caught:
        entering.__enter__()
    assert isinstance(caught.value.__cause__, DriveError)


@pytest.mark.parametrize(("data_bytes", "bits"), [(0, 55), (8, 135)])
def test_a_frame_is_as_long_as_the_standard_allows(data_bytes: int, bits: int) -> None:
    """ISO 11898-1 with the worst stuffing: 8 bytes take 135 bits at the most."""
    assert frame_bits(data_bytes) == bits


def test_the_bus_load_is_the_sum_over_the_period() -> None:
    rig = load_rig("rigs/paper.toml")
    fast, slow = (bus_budget(rig.canopen_settings(period_s)) for period_s in (0.001, 0.008))
    ratio = fast.load(10**6) / slow.load(10**6)
    assert ratio == pytest.approx(8.0, rel=0.03), "but for the heartbeats"
    assert math.isclose(slow.load(500_000), 2 * slow.load(1_000_000))
