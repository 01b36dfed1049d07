"""Runs with the load's angle from a serial counter on a pty, beside a drive of either kind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from servo_bench.errors import BenchError, LimitError, WireError
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.axes import open_axis
from servo_bench.run.doctor import counter
from servo_bench.run.session import RunSummary, run
from sim_rig.process import spawn
from tests.contract_axis import check_axis
from tests.test_modbus_wire import is_enabled as modbus_is_enabled
from tests.test_run_session import (
    OPERATION_ENABLED,
    STATUSWORD_MASK,
    assert_standing,
    experiment,
    sdo_read,
)

import can  # isort: skip

pytestmark = pytest.mark.wire
PERIOD_S = 0.008


def config(on: str = "canopen", framing: str = "generic-binary", *faults: str) -> RigConfig:
    """The shipped rig, or its counter beside a drive on Modbus TCP."""
    made = load_rig("rigs/serial-counter.toml")
    assert made.encoder is not None
    encoder = made.encoder.model_copy(update={"profile": framing, "baud_rate": 230400})
    if on == "modbus-tcp":
        made = load_rig("rigs/modbus-tcp.toml")
        drive = made.drive.model_copy(update={"second_encoder": None})
        made = made.model_copy(update={"drive": drive})
    return made.model_copy(update={"encoder": encoder}).with_faults(*faults).on_a_free_port()


@contextmanager
def started(rig: RigConfig) -> Iterator[RigConfig]:
    with spawn(rig.simulation_settings()) as running:
        yield rig.with_bus(**running.bus)


def played(rig: RigConfig, out: Path, seconds: float = 1.5) -> tuple[Recording, RunSummary | None]:
    """The recording of a run, and how it ended where it ended well."""
    summary = None
    try:
        summary = run(experiment(seconds), rig, out)
    except BenchError:
        if not out.exists():
            raise
    return load(out, allow_cut=True), summary


def is_enabled(rig: RigConfig) -> bool:
    if rig.drive.protocol != "canopen":
        return modbus_is_enabled(rig)
    with can.Bus(**rig.bus) as bus:
        return sdo_read(bus, 1, 0x6041) & STATUSWORD_MASK == OPERATION_ENABLED


@pytest.mark.parametrize(
    ("on", "framing"), [("canopen", "generic-ascii"), ("modbus-tcp", "generic-binary")]
)
def test_an_axis_with_a_counter_keeps_the_promise_of_every_axis(on: str, framing: str) -> None:
    with started(config(on, framing)) as rig:
        check_axis(lambda: open_axis(rig, PERIOD_S), lambda: is_enabled(rig), period_s=PERIOD_S)


@pytest.mark.parametrize(
    ("on", "framing"), [("canopen", "generic-binary"), ("modbus-tcp", "generic-ascii")]
)
def test_a_run_records_the_load_and_when_it_was_sampled(
    on: str, framing: str, tmp_path: Path
) -> None:
    out = tmp_path / "run.mcap"
    with started(config(on, framing)) as rig:
        recording, summary = played(rig, out)
    assert summary is not None
    motor_rad, load_rad = recording["motor_position_rad"], recording["load_angle_rad"]
    both = np.isfinite(motor_rad) & np.isfinite(load_rad)
    assert both.sum() > 0.5 * len(recording), "a busy machine may cost some"
    assert np.ptp(load_rad[both]) > 0.3
    apart_rad = np.ptp((motor_rad - load_rad)[both])
    moved_rad = 2 * np.nanmax(np.abs(recording["motor_velocity_rad_s"])) * 0.0025
    assert apart_rad <= rig.nominal.backlash_gap_rad + moved_rad, "the gap, and a late sample's way"
    request_s = {"generic-binary": 2, "generic-ascii": 4}[framing] * 10 / 230400
    if on == "canopen":  # a Modbus drive whose line was busy is asked later in its slot
        assert np.nanmin(recording["load_sampled_s"]) >= request_s
    told = {it.name: it for it in summary.alignment}
    assert {"command", "load sample", "motor answer", "load answer", "device clock"} <= set(told)
    assert told["load sample"].median_s == pytest.approx(request_s, abs=2e-4)
    with out.open("rb") as file:
        facts = {it.name: it.metadata for it in make_reader(file).iter_metadata()}
    assert facts["servo_bench.alignment"]["load sample"] == told["load sample"].facts()
    _check_current(recording)


def _check_current(recording: Recording) -> None:
    """The drive's torque is its current times K_T, to the resolution of a per mille of each."""
    current_a, torque_nm = recording["motor_current_a"], recording["motor_torque_nm"]
    assert np.nanmax(np.abs(current_a)) > 0.1
    np.testing.assert_allclose(current_a * 0.03606, torque_nm, atol=1.1 * 0.64e-3)
    inputs = {block.name: block.inputs for block in blocks_of(recording)}
    assert "motor_current_a" in inputs["mechanics"]


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("counter-unplugged at=30", WireError, r"the counter on .* is gone: "),
        ("counter-lost at=30 count=0", WireError, "has given no good answer for"),
        ("counter-damaged at=30 count=0", WireError, "has given no good answer for"),
        ("counter-fault at=30", WireError, "has given no good answer for"),
        ("counter-stuck at=60", WireError, "the load's encoder has stayed at"),
        ("counter-jump at=30 counts=6000", LimitError, "load's velocity reached"),
    ],
)
def test_a_counter_that_fails_stops_the_rig_with_its_cause(
    fault: str, error: type[BenchError], words: str, tmp_path: Path
) -> None:
    out = tmp_path / "run.mcap"
    with started(config("canopen", "generic-binary", fault)) as rig:
        with pytest.raises(error, match=words):
            run(experiment(4.0), rig, out)
        assert_standing(rig)
    assert load(out, allow_cut=True).rig is not None, "what was seen is kept"


def test_answers_that_are_lost_are_missing_and_never_the_ones_before(tmp_path: Path) -> None:
    faults = (
        "counter-lost at=40 count=3",
        "counter-damaged at=60 count=2",
        "counter-late at=90 delay_ms=6",
    )
    with started(config("canopen", "generic-binary", *faults)) as rig:
        recording, summary = played(rig, tmp_path / "run.mcap")
    assert summary is not None
    load_rad = recording["load_angle_rad"]
    assert np.isnan(load_rad).sum() >= 6
    lost = [event for event in recording.events if event.kind == "load sample lost"]
    assert len(lost) >= 6
    assert np.isnan(recording["encoder_latency_s"]).sum() == np.isnan(load_rad).sum()
    assert not np.isnan(recording["motor_position_rad"]).all()


def test_the_doctor_asks_the_counter(tmp_path: Path) -> None:
    with started(config()) as rig:
        settings = rig.counter_settings(PERIOD_S)
        assert settings is not None
        told = {finding.subject: finding.text for finding in counter.examine(settings)}
    assert "from request to answer at the median" in told["load counter"]
    assert told["counter's framing"] == "check sum, number, and index."
