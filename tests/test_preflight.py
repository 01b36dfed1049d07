"""What is said before a run: by hand where it can be, and refused where it must be."""

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers.canopen.profile import Gain, Gains, Shaping, generic
from servo_bench.cli.app import app
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.excitation.prediction import predict
from servo_bench.excitation.sequences import RandomUniform
from servo_bench.rig import RigConfig, load_rig, rig_from_table
from servo_bench.run import preflight_read
from servo_bench.run.finding import Finding, Level
from servo_bench.run.preflight import preflight
from servo_bench.run.preflight_read import read_drive
from tests.fake_canopen import I32, U16, U32, Entry, FakeRig


def experiment(amplitude_rad_s: float = 2.0, length: int = 500) -> Experiment:
    return Experiment(
        name="short",
        rig="rigs/paper.toml",
        period_s=0.008,
        memory=8,
        standstill_s=0.2,
        lead_in=16,
        identification=MSequence(polynomial="2327", amplitude_rad_s=amplitude_rad_s, length=length),
        validation=RandomBinary(
            kind="random-binary", seed=2, amplitude_rad_s=amplitude_rad_s, length=32
        ),
    )


@pytest.fixture(scope="module")
def rig() -> RigConfig:
    return load_rig("rigs/paper.toml")


def by_subject(findings: list[Finding]) -> dict[str, Finding]:
    return {it.subject: it for it in findings}


def test_the_prediction_is_the_loops_own_arithmetic(rig: RigConfig) -> None:
    seen = predict(experiment().schedule(), rig)
    # the first instant of a reversal: K_P times 2 V
    assert seen.peak_current_a >= rig.nominal.proportional_gain_a_s_per_rad * 4.0
    assert 0.0 < seen.rms_current_a < seen.peak_current_a
    commanded_rad = np.abs(np.cumsum(experiment().schedule().velocity_rad_s) * 0.008).max()
    overshoot_rad = 2.0 * 2.0 / rig.nominal_values().natural_frequency_rad_s
    assert seen.motor_travel_rad == pytest.approx(commanded_rad, abs=overshoot_rad)
    half_gap_rad = rig.nominal.backlash_gap_rad / 2
    assert abs(seen.motor_travel_rad - seen.load_travel_rad) <= 2 * half_gap_rad + 1e-9


def test_all_of_it_grows_with_the_amplitude(rig: RigConfig) -> None:
    one, two = (predict(experiment(v).schedule(), rig) for v in (1.0, 2.0))
    assert two.rms_current_a == pytest.approx(2 * one.rms_current_a, rel=1e-6)
    assert two.peak_velocity_rad_s == pytest.approx(2 * one.peak_velocity_rad_s, rel=1e-6)


def test_a_long_schedule_is_predicted_to_its_end(
    rig: RigConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its fast part comes last; in pieces or at once, the same."""
    plan = experiment(1.0)
    faster = plan.validation.model_copy(update={"amplitude_rad_s": 10.0})
    schedule = plan.model_copy(update={"validation": faster}).schedule()
    at_once = predict(schedule, rig)
    assert at_once.peak_velocity_rad_s > 10.0
    monkeypatch.setattr("servo_bench.excitation.prediction.SLOTS_AT_ONCE", 100)
    in_pieces = predict(schedule, rig)
    assert asdict(in_pieces) == pytest.approx(asdict(at_once), rel=1e-12)


@pytest.mark.parametrize(
    ("heartbeat_s", "timeout_s", "refused"),
    [(0.1, 0.3, False), (0.1, 0.15, False), (0.1, 0.104, True), (0.3, 0.3, True)],
)
def test_a_master_whose_heartbeat_comes_too_late_is_refused_and_its_file_is_read(
    rig: RigConfig, heartbeat_s: float, timeout_s: float, refused: bool
) -> None:
    times = {"heartbeat_s": heartbeat_s, "heartbeat_timeout_s": timeout_s}
    table = rig.model_dump(mode="json")
    slow = rig_from_table({**table, "drive": {**table["drive"], **times}}, "a recording's")
    found = by_subject(preflight(experiment(), slow))
    assert ("period and line" in found) is refused
    if refused:
        assert "heartbeat_timeout_s" in found["period and line"].text


RPDO_TIMER = """
title = "mine"
[[answers]]
pdo = 1
objects = ["0x6041", "0x6064"]
[stopping]
watchdog = "rpdo-timer"
"""


@pytest.mark.parametrize(
    ("profile", "timeout_s", "words"),
    [
        ("generic-node-guarding", 0.04, "node guarding's questions"),
        ("generic-node-guarding", 0.11, ""),
        ("rpdo-timer", 0.05, "commands"),
        ("rpdo-timer", 0.06, ""),
    ],
)
def test_whatever_word_a_drive_awaits_must_come_before_its_timeout(
    rig: RigConfig, tmp_path: Path, profile: str, timeout_s: float, words: str
) -> None:
    if profile == "rpdo-timer":
        path = tmp_path / "mine.toml"
        path.write_text(RPDO_TIMER)
        profile = str(path)
    changes = {"profile": profile, "heartbeat_timeout_s": timeout_s, "vendor_id": None}
    table = rig.model_dump(mode="json")
    slow = rig_from_table({**table, "drive": {**table["drive"], **changes}}, "a rig")
    found = by_subject(preflight(experiment().model_copy(update={"period_s": 0.05}), slow))
    assert ("period and line" in found) is bool(words)
    if words:
        told = found["period and line"].text
        assert f"{words} (" in told
        assert "go out every 0.05 s" in told
        assert "shorten the period" in told


@pytest.mark.parametrize("told", ["500k", -5, 0, 500, 0.5, True])
def test_a_bit_rate_that_is_none_is_refused_in_words(
    rig: RigConfig, told: str | int | float | bool
) -> None:
    found = by_subject(preflight(experiment(), rig.with_bus(bitrate=told)))
    assert found["period and line"].level is Level.STOP
    assert f"bus.bitrate = {told!r}: it is a whole number" in found["period and line"].text
    assert "bus load" in by_subject(preflight(experiment(), rig.with_bus(bitrate=5e5)))


def test_a_memory_that_a_run_would_refuse_is_refused_before(rig: RigConfig) -> None:
    plan = experiment().model_copy(update={"memory": 30, "lead_in": 64})
    found = by_subject(preflight(plan, rig))
    assert found["memory"].level is Level.STOP
    assert "collide beyond" in found["memory"].text


def test_an_interface_that_no_bus_has_is_said_before_a_run(rig: RigConfig) -> None:
    found = by_subject(preflight(experiment(), rig.model_copy(update={"bus": {"interface": "sc"}})))
    assert found["bus"].level is Level.STOP
    assert "python-can does not know" in found["bus"].text
    assert "bus" not in by_subject(preflight(experiment(), rig))


def test_a_temperature_that_nobody_can_ask_is_no_limit(rig: RigConfig, tmp_path: Path) -> None:
    profile = tmp_path / "hot.toml"
    shipped = Path(drivers.__file__).parent / "profiles/canopen/generic.toml"
    told = '\n[temperature]\nobject = "0x3201:1"\nc_per_digit = 0.1\n'
    profile.write_text(shipped.read_text() + told)
    limits = rig.limits.model_copy(update={"drive_temperature_c": 60.0})
    drive = rig.drive.model_copy(update={"profile": str(profile)})
    hot = rig.model_copy(update={"limits": limits, "drive": drive})
    assert by_subject(preflight(experiment(), hot))["temperature"].level is Level.OK
    alone = {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 1_000_000}
    found = by_subject(preflight(experiment(), hot.model_copy(update={"bus": alone})))
    assert found["temperature"].level is Level.CHANGE
    assert "slcan has one owner" in found["temperature"].text


def test_a_run_that_would_trip_is_stopped_before(rig: RigConfig) -> None:
    limits = rig.limits.model_copy(update={"velocity_rad_s": 2.05, "torque_nm": 0.01})
    found = by_subject(preflight(experiment(), rig.model_copy(update={"limits": limits})))
    assert found["limits"].level is Level.OK, "the command itself is within"
    assert found["motor velocity"].level is Level.STOP
    assert "the run would trip" in found["motor velocity"].text
    assert found["current"].level is Level.STOP


def test_heat_is_the_square_of_the_current(rig: RigConfig) -> None:
    seen = predict(experiment().schedule(), rig)
    rms_nm = seen.rms_current_a * rig.nominal.torque_constant_nm_per_a
    for rated_nm, level in ((0.9 * rms_nm, Level.STOP), (1.1 * rms_nm, Level.CHANGE)):
        assert rig.simulated is not None
        simulated = rig.simulated.model_copy(update={"rated_torque_nm": rated_nm})
        found = by_subject(preflight(experiment(), rig.model_copy(update={"simulated": simulated})))
        margin = 100 * (1 - (rms_nm / rated_nm) ** 2)
        assert found["current"].level is level
        assert f"thermal margin {margin:.0f} %" in found["current"].text
    unknown = by_subject(preflight(experiment(), rig.model_copy(update={"simulated": None})))
    assert "thermal margin unknown" in unknown["current"].text


@pytest.mark.parametrize(
    ("profile", "amplitude_deg_s", "level", "share"),
    [("maxon-epos4", 150.0, Level.OK, "0.004 %"), ("delta-asda-a2", 150.0, Level.OK, "0.4 %")],
)
def test_the_velocity_quantum_stands_beside_the_amplitude(
    rig: RigConfig, profile: str, amplitude_deg_s: float, level: Level, share: str
) -> None:
    mode = "pv" if profile == "delta-asda-a2" else "csv"
    drive = rig.drive.model_copy(update={"profile": profile, "mode": mode})
    found = by_subject(
        preflight(
            experiment(math.radians(amplitude_deg_s)), rig.model_copy(update={"drive": drive})
        )
    )
    assert found["velocity quantum"].level is level
    assert share in found["velocity quantum"].text
    assert (found["ramps"].level is Level.CHANGE) == (mode == "pv")
    known = profile == "maxon-epos4"
    assert ("0x30A2:1" in found["K_P, K_I"].text) == known
    assert ("unknown: will be fitted" in found["K_P, K_I"].text) == (not known)


def test_a_line_that_is_too_slow_is_a_stop_with_its_sum() -> None:
    slow = load_rig("rigs/modbus-rtu.toml").with_bus(baud_rate=115200)
    found = by_subject(preflight(experiment(), slow))
    assert found["period and line"].level is Level.STOP
    assert "19 + 33 bytes at 115200 Bd" in found["period and line"].text


def test_a_modbus_rig_is_told_its_wire_and_its_units() -> None:
    found = by_subject(preflight(experiment(), load_rig("rigs/modbus-tcp.toml")))
    assert "turnaround" in found["wire budget"].text
    assert found["velocity quantum"].level is Level.OK
    assert "per mille rated" in found["unit of the torque"].text


# What the drive itself says, read


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    fake = FakeRig(tmp_path, monkeypatch)
    profile = generic().model_copy(
        update={
            "gains": Gains(
                proportional_a_s_per_rad=Gain.model_validate(
                    {"object": "0x30A2:1", "per_digit": 1e-6}
                )
            ),
            "shaping": (
                Shaping.model_validate(
                    {"object": "0x30A2:3", "what": "feed-forward", "neutral": 0}
                ),
            ),
        }
    )
    fake.drive.objects[0x30A2, 1] = Entry(U32, 346_644)
    fake.drive.objects[0x30A2, 3] = Entry(U32, 17)
    fake.drive.objects[0x6072, 0] = Entry(U16, 1000)
    fake.drive.objects[0x6080, 0] = Entry(U32, 10)
    fake.drive.objects[0x6083, 0] = Entry(U32, 100_000)
    fake.drive.objects[0x6084, 0] = Entry(U32, 2_000_000_000)
    fake.drive.objects[0x607F, 0] = Entry(I32, 2_000_000)
    settings = fake.settings(profile=profile, mode="pv")
    monkeypatch.setattr(preflight_read, "axis_settings", lambda rig, period_s: settings)
    return fake


def test_what_the_drive_would_do_to_the_excitation_is_read(fake: FakeRig, rig: RigConfig) -> None:
    findings = read_drive(experiment(), rig)
    found = {(it.subject, it.level): it.text for it in findings}
    assert "K_P is 0.3466 A s/rad" in found["K_P", Level.OK]
    assert "feed-forward (0x30A2:3) = 17: alters" in found["shaping", Level.CHANGE]
    assert "0x6080 allows 60 deg/s" in found["speed limit", Level.CHANGE]
    assert "0x607F" in found["speed limit", Level.OK]
    slope_rad_s2 = 100_000 * math.tau / 65536
    takes_ms = 4.0 / slope_rad_s2 * 1e3
    assert f"takes {takes_ms:.3g} ms of a period of 8 ms" in found["ramps", Level.CHANGE]
    assert "0x6084" in found["ramps", Level.OK]
    assert "a digit of 0x6077 is 0.00064 N m" in found["current", Level.OK]
    assert [frame for frame in fake.world.sent if frame[1][:1] in (b"\x23", b"\x2b", b"\x2f")] == []


def test_a_torque_limit_below_the_peak_is_said(fake: FakeRig, rig: RigConfig) -> None:
    fake.drive[0x6072, 0] = 10
    text = by_subject(read_drive(experiment(), rig))["torque limit"].text
    assert "(0x6072) to 10 per mille: the excitation's steps will be cut" in text


def test_the_command_prints_lines_and_ends_with_what_they_come_to(tmp_path: Path) -> None:
    good = CliRunner().invoke(app, ["preflight", "experiments/demo.toml"])
    assert good.exit_code == 0, good.output
    assert "nothing stands against this run" in good.output
    table = tmp_path / "tight.toml"
    source = Path("servo_bench/library/rigs/paper.toml").read_text()
    table.write_text(source.replace("velocity_deg_s = 400", "velocity_deg_s = 10"))
    bad = CliRunner().invoke(app, ["preflight", "experiments/demo.toml", "--rig", str(table)])
    assert bad.exit_code == 1
    assert "to mend before the rig runs" in bad.output


def test_a_load_that_is_thrown_is_faster_than_its_motor(rig: RigConfig) -> None:
    """In a soft gap, by a run's own arithmetic: two samples of its angle, a period apart."""
    thrown = {"compliance_rad_per_nm": 0.02, "load_inertia_kg_m2": 5e-5, "damping_s": 5e-5}
    soft = rig.model_copy(update={"effects": {"contact": thrown}})
    schedule = experiment().schedule()
    seen = predict(schedule, soft)
    played = soft.model().simulate(schedule.velocity_rad_s, schedule.period_s)
    step_rad = np.abs(np.diff(played.load_angle_rad)).max()
    assert seen.load_velocity_rad_s == pytest.approx(step_rad / schedule.period_s, rel=0.05)
    assert seen.load_velocity_rad_s > 1.1 * seen.peak_velocity_rad_s
    limit = 0.5 * (seen.load_velocity_rad_s + seen.peak_velocity_rad_s)
    tight = soft.model_copy(
        update={"limits": soft.limits.model_copy(update={"velocity_rad_s": limit})}
    )
    found = by_subject(preflight(experiment(), tight))
    assert found["motor velocity"].level is Level.OK
    assert found["load velocity"].level is Level.STOP


def test_levels_drawn_at_random_are_not_judged_by_the_least_of_them(rig: RigConfig) -> None:
    validation = RandomUniform(
        kind="random-uniform", seed=11, amplitude_rad_s=2.0, length=400, bias_rad_s=0.0
    )
    found = by_subject(preflight(experiment().model_copy(update={"validation": validation}), rig))
    (quantum,) = (it for it in found.values() if "one digit" in it.text)
    assert quantum.level is Level.OK
