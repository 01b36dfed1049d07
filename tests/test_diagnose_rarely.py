"""What acts a few times only: a clamp that the validation never asks for."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.evidence import quick_evidence
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.coasting import Face, coasting
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.rarely import acts_again
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, STANDSTILL, VALIDATION, recorded

MODEL = Model(NOMINAL)
SLOTS, BEGINNING, V_RAD_S = 3600, 2200, 4.0


def commands(seed: int) -> NDArray[np.float64]:
    """Half speeds for runs of 1 to 20 slots, and seldom a full reversal; a validation without."""
    rng = np.random.default_rng(seed)
    runs = rng.integers(1, 20, SLOTS)
    levels = rng.choice([-0.5, 0.0, 0.5], SLOTS) + rng.choice([0.0, 1.0], SLOTS, p=[0.93, 0.07])
    moving = np.repeat(levels, runs)[:SLOTS]
    moving[-VALIDATION:] = np.minimum(moving[-VALIDATION:], 0.5)
    return V_RAD_S * np.concatenate((np.zeros(STANDSTILL), moving))


def integral_a(model: Model, played: NDArray[np.float64]) -> NDArray[np.float64]:
    """The controller's integral at the samples."""
    done, nominal = model.simulate(played, 0.008), model.nominal
    heard = np.append(0.0, played[:-1])
    wanted_rad_s = heard - done.motor_velocity_rad_s
    return np.asarray(
        np.abs(done.motor_current_a - nominal.proportional_gain_a_s_per_rad * wanted_rad_s)
    )


@pytest.mark.parametrize(
    "seed",
    [pytest.param(61, marks=pytest.mark.long), pytest.param(62, marks=pytest.mark.nightly)],
)
def test_a_clamp_that_no_validation_asks_for_is_named(seed: int) -> None:
    played = commands(seed)
    reached = integral_a(MODEL, played)
    clamp_a = 1.1 * reached[-VALIDATION:].max()
    assert 3 < (reached > clamp_a).sum() < 0.03 * reached.size
    rig = MODEL.with_effect("integrator_clamp", clamp_per_a=1.0 / clamp_a)
    recording = recorded(rig, seed, played=played)
    verdict = verdict_of(find_causes([recording], MODEL))
    assert verdict.names == ("integrator_clamp",)
    found = verdict.causes[0].parameters["clamp_per_a"]
    assert found.value == pytest.approx(1.0 / clamp_a, rel=0.03)


@pytest.mark.nightly
def test_so_is_one_that_a_load_which_coasts_shows_alone() -> None:
    """What the load does in its gap is more of the cost than a clamp that acts rarely."""
    played = commands(64)
    clamp_a = 1.1 * integral_a(MODEL, played)[-VALIDATION:].max()
    rig = MODEL.with_effect("integrator_clamp", clamp_per_a=1.0 / clamp_a)
    seen = recorded(
        coasting(rig, 760.0, Face(3e-5, 0.0)), 64, played=played, channels=("load_angle_rad",)
    )
    assert verdict_of(find_causes([seen], MODEL)).names == ("integrator_clamp",)


def test_what_comes_after_the_beginning_is_neither_fitted_nor_held_out() -> None:
    recording = recorded(MODEL, 63, played=commands(63))
    quick = quick_evidence([recording], MODEL, BEGINNING)
    (after,), (held,), (seen,) = (ask([MODEL]) for ask in (quick.after, quick.held_out, quick.seen))
    came_after = np.isfinite(after.rows).any(axis=0)
    held_out = np.isfinite(held.rows).any(axis=0)
    assert came_after.sum() > 0
    assert not (came_after & held_out).any()
    assert after.group[came_after].min() >= seen.group.max()
    assert after.group[came_after].max() <= held.group[held_out].min()


def test_where_nothing_came_after_the_beginning_nothing_acts_again() -> None:
    """A recording that is no longer than its own quick look, whole or cut."""
    empty, held = SimpleNamespace(cost=lambda _: 0.0), SimpleNamespace(cost=lambda _: 1.0)
    asked: list[Model] = []

    def after(models: list[Model]) -> list[SimpleNamespace]:
        asked.extend(models)
        return [empty] * len(models)

    quick: Any = SimpleNamespace(after=after, held_out=lambda models: [held] * len(models))
    rig = MODEL.with_effect("integrator_clamp", clamp_per_a=1.0)
    clamp = SimpleNamespace(
        effect="integrator_clamp",
        seen_gain=0.2,
        seen_z=5.0,
        held_gain=0.0,
        held_z=0.0,
        held=held,
        found=SimpleNamespace(model=rig),
    )
    base = SimpleNamespace(model=MODEL)
    played: Any = SimpleNamespace(contenders=(clamp,), base=base, sigma=None)
    assert acts_again(quick, played) is None
    assert asked == [MODEL, rig]
