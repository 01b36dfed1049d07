"""What is tried reaches from what is worth a name to the most that a rig has of its own."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.hypotheses import VEHICLE, Hypothesis, hypotheses
from servo_bench.diagnosis.searching.scales import Scales, band_of, scales_of
from servo_bench.diagnosis.searching.screening import screen
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.sizes import OWN, OWN_MOST, REACH, STEEP, material_sizes
from sim_rig.effects import find_effect
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded

MODEL = Model(NOMINAL)
GENTLY, USUALLY, HARD = 0.05, 1.0, 4.0
"""Of a usual excitation's amplitude."""


def scales(amplitude: float) -> Scales:
    return scales_of(MODEL, amplitude * commands(3, 400), PERIOD_S)


def told(tried: Hypothesis, sign: float) -> Iterator[tuple[float, float]]:
    """The sizes that each of its trials of that sign tells of, from the smallest."""
    strength = find_effect(tried.effect).strengths[0]
    rigid = (t for t in tried.trials if VEHICLE not in t.beside)  # whose load has sizes of its own
    values = sorted({sign * float(t.settings[strength]) for t in rigid})
    yield from ((REACH[0] * v, REACH[1] * v) for v in values if v > 0.0)


def signs(tried: Hypothesis) -> set[float]:
    strength = find_effect(tried.effect).strengths[0]
    return {float(np.sign(t.settings[strength])) for t in tried.trials}


@pytest.mark.parametrize("amplitude", [GENTLY, USUALLY, HARD])
def test_whatever_the_excitation_trials_tell_of_what_is_worth_a_name(amplitude: float) -> None:
    here = scales(amplitude)
    least = material_sizes(here)
    for tried in hypotheses(here):
        phased = "phase_rad" in find_effect(tried.effect).params._fields
        if phased or tried.effect not in least.keys() - STEEP:
            continue
        for sign in signs(tried):
            low, _ = next(told(tried, sign))
            assert low <= least[tried.effect] * (1.0 + 1e-9), tried.effect


@pytest.mark.parametrize("amplitude", [GENTLY, USUALLY, HARD])
def test_torques_of_the_rigs_own_are_told_without_a_gap_to_the_largest(amplitude: float) -> None:
    here = scales(amplitude)
    for tried in (h for h in hypotheses(here) if h.effect in OWN):
        for sign in signs(tried):
            reaches = list(told(tried, sign))
            assert all(
                low <= high * (1.0 + 1e-9) for (_, high), (low, _) in itertools.pairwise(reaches)
            ), tried.effect
            assert reaches[-1][1] >= OWN_MOST * here.rig_torque_nm, tried.effect


def test_what_droops_is_worth_a_name_whenever_its_current_is_sampled() -> None:
    """A stiff loop's jump is over before a slow logger's next sample, and flows all the same."""
    gains = {"proportional_gain_a_s_per_rad": 2.0, "integral_gain_a_per_rad": 300.0}
    stiff = Model(replace(NOMINAL, **gains))
    slow = commands(5, 600)[::2]
    droop = [
        material_sizes(scales_of(stiff, np.repeat(slow, k), 0.016 / k))["torque_constant_droop"]
        for k in (1, 16)
    ]
    sampled_a = [scales_of(stiff, np.repeat(slow, k), 0.016 / k).currents_a[0] for k in (1, 16)]
    assert sampled_a[1] > 2.0 * sampled_a[0]
    assert droop[0] == pytest.approx(droop[1], rel=0.15)


def hard(seed: int) -> NDArray[np.float64]:
    return HARD * commands(seed, 900)


def test_a_little_of_what_favours_one_direction_promises_something_under_a_hard_excitation() -> (
    None
):
    """Half a millinewtonmetre, where the excitation asks for a quarter of a newtonmetre."""
    played = hard(71)
    here = scales_of(MODEL, played, PERIOD_S)
    size_nm = 1.3 * material_sizes(here)["asymmetric_friction"]
    assert size_nm < 0.002 * here.torque_nm
    hidden = MODEL.with_effect("asymmetric_friction", difference_torque_nm=size_nm)
    seen = evidence_of([recorded(hidden, 71, played=played)], MODEL)
    base = seek(seen, MODEL, band_of(here, MODEL), iterations=4)
    (found,) = screen(seen, base, hypotheses(here, only=("asymmetric_friction",)))
    assert found.gain > 0.0
    assert found.trial.settings["difference_torque_nm"] == pytest.approx(size_nm, rel=0.5)
