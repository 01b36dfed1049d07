"""A load's angle in coarse steps: what it hides of the motion is no error of the simulation."""

import math

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.comparing.rounding import rounding_of
from servo_bench.diagnosis.concluding import conclude
from servo_bench.report.diagnosis_page import diagnosis_report
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, nominal_with, recorded, with_channels

MODEL = Model(NOMINAL)


@pytest.mark.parametrize("quantum_rad", [1e-3, 2.5e-3])
def test_rounding_adds_to_every_signal_what_it_is_said_to_add(quantum_rad: float) -> None:
    """Of a rig that is its model to the digit all that is left of the twist is the rounding."""
    run = recorded(MODEL, 71, slots=2500, noise_counts=0.0)
    coarse = np.rint(np.array(run["load_angle_rad"]) / quantum_rad) * quantum_rad
    whole = evidence_of([with_channels(run, load_angle_rad=coarse)], MODEL)
    left = whole.seen([MODEL], coarse=False)[0].rms()
    period_s = whole.fitted[0].source.rows.period_s
    for signal, rms in zip(whole.fitted[0].signals, left, strict=True):
        said = rounding_of(signal, quantum_rad, period_s)
        if signal.channel == "motor_position_rad":
            assert said == 0.0
        elif signal.channel == "load_angle_rad" and signal.stride < 30:
            # over longer ones a slow angle rests on one step
            assert rms == pytest.approx(said, rel=0.15), signal.name


@pytest.mark.long
def test_a_very_coarse_encoder_is_named_and_the_extended_rig_has_it() -> None:
    """Its steps are a fifth of the gap, where no simulation comes any nearer."""
    rig, quantum_rad = Model(nominal_with(backlash_gap_rad=math.radians(0.6))), math.radians(0.12)
    hidden = rig.with_effect("quantisation", count_rad=quantum_rad)
    run = recorded(hidden, 72, slots=1500)
    concluded = conclude([run], model=rig, only=("quantisation", "coulomb"))
    verdict = concluded.verdict
    assert verdict.names == ("quantisation",), verdict.sentence
    assert verdict.effects["quantisation"]["count_rad"] == pytest.approx(quantum_rad, rel=1e-3)
    assert verdict.error is not None
    assert verdict.error.after == pytest.approx(verdict.error.noise_floor, rel=0.2)
    assert "lies on steps of 0.002094 rad" in diagnosis_report(*concluded, run)
