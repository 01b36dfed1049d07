"""Verdicts on measured data from four other benches; skipped where the folder is absent.

What must come out is what those who measured say, or another part of their data: the cogging map
held at standstill, the play that a thesis publishes. They are judged as the command judges them.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.elsewhere import diagnose_open, is_open
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.plant import ForeignPlant
from servo_bench.recording.recording import Recording
from tests.foreign_files import REALDATA, measured
from tests.test_foreign_realdata import CYCLOIDAL, bam, cycloidal, laas, undcmotor

TARGETED = ("coulomb", "viscous", "stribeck", "cogging")


def static_map() -> tuple[int, float]:
    """The strongest order of the holding current against angle, and its amplitude in A."""
    recording = laas("stopped_data")
    angle, current = recording["motor_position_rad"], recording["current_a"]
    place = np.round(angle / (2 * np.pi) * 720).astype(int)
    places = np.unique(place)
    at = np.array([angle[place == k].mean() for k in places])
    held = np.array([current[place == k].mean() for k in places])
    orders = np.arange(2, 161)
    heights = [abs(np.mean((held - held.mean()) * np.exp(1j * n * at))) for n in orders]
    best = int(np.argmax(heights))
    return int(orders[best]), 2.0 * float(heights[best])


def lines_of(verdict: Verdict) -> dict[float, float]:
    """Amplitude by order."""
    found = next(c for c in verdict.causes if c.effect == "cogging").parameters
    return {
        found[f"{place}order"].value: found[f"{place}torque_nm"].value
        for place in ("", "second_", "third_")
        if f"{place}order" in found
    }


def test_cogging_of_the_direct_drive_is_that_of_its_static_map() -> None:
    recording = laas("acc_current")
    assert is_open(recording)
    verdict = conclude([recording], only=TARGETED).verdict
    order, amplitude_a = static_map()
    assert order == 72
    assert {"coulomb", "cogging"} <= set(verdict.names)
    assert "stribeck" not in verdict.names
    assert lines_of(verdict)[order] == pytest.approx(amplitude_a, rel=0.15)
    assert verdict.error is not None
    assert verdict.error.after < 0.3 * verdict.error.before


@pytest.mark.long
def test_a_pendulum_on_a_position_loop_has_weight_and_friction_that_grows_with_load() -> None:
    """As those who measured it say; the weight is known from its mass and length."""
    measured("bam_xl330/2026-01-15_10h28m10.json")
    names = sorted(p.stem[-8:] for p in (REALDATA / "bam_xl330").glob("*.json"))
    recordings = [bam(name) for name in names]
    verdict = conclude(recordings).verdict
    assert {"load_dependent_friction", "gravity_imbalance"} <= set(verdict.names)
    assert "stribeck" not in verdict.names
    plant = recordings[0].plant
    assert plant is not None
    assert plant.pendulum is not None
    weight_nm = plant.pendulum.mass_kg * 9.80665 * plant.pendulum.length_m
    found = next(c for c in verdict.causes if c.effect == "gravity_imbalance")
    assert found.parameters["torque_nm"].value == pytest.approx(weight_nm, rel=0.15)
    assert verdict.error is not None
    assert verdict.error.after < 0.25 * verdict.error.before


def test_nothing_is_invented_where_quantised_speed_is_all_there_is() -> None:
    verdict = conclude([undcmotor("prbs_open_exp")]).verdict
    assert (verdict.verdict, verdict.causes) == ("none", ())
    assert "Nothing pays" in verdict.sentence


@pytest.mark.long
@pytest.mark.parametrize(("name", "play_deg"), CYCLOIDAL.items())
def test_play_of_a_locked_gear(name: str, play_deg: float) -> None:
    """Against the figure that was published, and by how much it beats a linear spring."""
    verdict = conclude([cycloidal(name)]).verdict
    (cause,) = verdict.causes
    assert cause.effect == "backlash_width"
    found = float(np.rad2deg(cause.parameters["change_rad"].value))
    assert found == pytest.approx(play_deg, rel=0.15)
    assert verdict.error is not None
    assert verdict.error.after < 0.4 * verdict.error.before


def spun(
    current: NDArray[np.float64], friction_a: float, seed: int, viscous_a_s: float = 0.004
) -> Recording:
    """A motor of 500 rad/s2 a ampere at 1 kHz, its dry friction exact, its sensors noisy."""
    speed, angle, speeds, angles = 0.0, 0.0, [], []
    for value in current:
        drive = value - np.sign(speed) * friction_a - viscous_a_s * speed
        speed += 1e-3 * 500.0 * drive
        angle += 1e-3 * speed
        speeds.append(speed)
        angles.append(angle)
    noise = np.random.default_rng(seed).normal(size=(2, current.size))
    channels = {
        "t_s": 1e-3 * np.arange(current.size),
        "current_a": current,
        "motor_velocity_rad_s": np.array(speeds) + 1e-2 * noise[0],
        "motor_position_rad": np.array(angles) + 1e-4 * noise[1],
    }
    return Recording(channels, 1e-3, None, None, {}, plant=ForeignPlant(name="spun"))


def driven(seed: int) -> NDArray[np.float64]:
    levels = np.random.default_rng(seed).uniform(-1.0, 1.0, 150)
    return np.asarray(np.repeat(levels, 100))


def test_friction_of_a_known_motor_is_found_in_amperes_and_absent_where_there_is_none() -> None:
    verdict = diagnose_open([spun(driven(1), 0.15, 2)], only=TARGETED)
    assert "coulomb" in verdict.names
    (cause,) = (c for c in verdict.causes if c.effect == "coulomb")
    assert cause.parameters["torque_nm"].unit == "A"
    assert cause.parameters["torque_nm"].value == pytest.approx(0.15, rel=0.1)
    assert "coulomb" not in diagnose_open([spun(driven(1), 0.0, 2)], only=TARGETED).names


@pytest.mark.long
def test_a_constant_that_nobody_can_place_is_told_with_its_size() -> None:
    """A sensor's offset turns the motor as a load does: no cause, and more than nothing."""
    recording = spun(driven(1), 0.15, 2)
    shifted = {**recording.channels, "current_a": recording["current_a"] - 0.05}
    told = diagnose_open([replace(recording, channels=shifted)], only=TARGETED)
    (constant,) = (words for words in told.undecided if "constant" in words)
    assert float(constant.split("constant ")[1].split()[0]) == pytest.approx(0.05, rel=0.1)
    assert " A beside the effort" in constant
    even = diagnose_open([recording], only=TARGETED)
    assert not any("constant" in words for words in even.undecided)


def by_its_angle(recording: Recording, seed: int) -> Recording:
    """Without its velocity, and an angle with the noise of a coarse encoder."""
    rough = np.random.default_rng(seed).normal(size=len(recording))
    angle = recording["motor_position_rad"] + 3e-3 * rough
    channels = {n: v for n, v in recording.channels.items() if n != "motor_velocity_rad_s"}
    return replace(recording, channels={**channels, "motor_position_rad": angle})


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_motor_that_turns_evenly_where_it_is_judged_tells_nothing(seed: int) -> None:
    """Else what it is named for is its noise."""
    current = np.concatenate((driven(seed)[:10_000], np.zeros(5_000)))
    verdict = diagnose_open([by_its_angle(spun(current, 0.0, seed, viscous_a_s=0.0), seed)])
    assert (verdict.verdict, verdict.causes) == ("unknown", ())
    assert "does not rise above its noise" in verdict.sentence
    assert verdict.next_run


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_a_motor_that_turns_evenly_against_a_drag_tells_the_drag(seed: int) -> None:
    """By the current that holds its speed."""
    current = np.concatenate((driven(seed)[:10_000], np.full(5_000, 0.4)))
    (cause,) = diagnose_open([by_its_angle(spun(current, 0.0, seed), seed)]).causes
    assert cause.effect == "viscous"
    assert cause.parameters["damping_nm_s_per_rad"].value == pytest.approx(0.004, rel=0.05)


def test_what_cannot_be_judged_is_said() -> None:
    short = spun(driven(1)[:2000], 0.1, 2)
    with pytest.raises(FitError, match="less than 10 s"):
        diagnose_open([short])
    with pytest.raises(ConfigError, match="no recording"):
        diagnose_open([])
    blind = replace(short, channels={"t_s": short["t_s"], "current_a": short["current_a"]})
    assert not is_open(blind)
    with pytest.raises(FitError, match="Map a current"):
        diagnose_open([blind])
