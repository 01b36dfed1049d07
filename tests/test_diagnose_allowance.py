"""What a simulation may miss follows from the motion, not from where a counter begins."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.allowance import SCALES, allowed
from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)


def moved_zero(recording: Recording, by_rad: float) -> Recording:
    load = np.asarray(recording["load_angle_rad"]) + by_rad
    return replace(recording, channels={**recording.channels, "load_angle_rad": load})


@pytest.mark.parametrize("by_rad", [0.1, -3.0])
def test_the_zero_of_the_load_s_encoder_changes_no_allowance_of_the_twist(by_rad: float) -> None:
    run = recorded(MODEL, 51, slots=900)
    here = compare(run, MODEL, scales=SCALES)
    there = compare(moved_zero(run, by_rad), MODEL, scales=SCALES)
    twist = [k for k, s in enumerate(here.signals) if s.name.startswith("twist")]
    assert len(twist) > 1
    np.testing.assert_allclose(allowed(there)[twist], allowed(here)[twist], rtol=1e-6)


def test_what_several_recordings_may_miss_does_not_go_by_which_comes_first() -> None:
    slow, fast = (
        recorded(MODEL, seed, played=v * np.sign(np.random.default_rng(seed).normal(size=900)))
        for seed, v in ((52, 1.0), (53, 8.0))
    )
    either = [evidence_of(them, MODEL).allowed for them in ([slow, fast], [fast, slow])]
    np.testing.assert_allclose(*either)
    alone = [evidence_of([one], MODEL).allowed for one in (slow, fast)]
    assert (either[0] >= np.min(alone, axis=0) * (1.0 - 1e-12)).all()
    assert (either[0] <= np.max(alone, axis=0) * (1.0 + 1e-12)).all()
