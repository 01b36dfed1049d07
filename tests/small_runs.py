"""Short runs on the software rig in virtual time, for tests of what is done with recordings."""

import math
from functools import cache
from typing import Any

from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.virtual import run_virtually

AMPLITUDE_RAD_S = math.radians(150.0)
NOISE_RAD = 1e-4


@cache
def experiment() -> Experiment:
    """Seven seconds: 511 chips."""
    return Experiment(
        name="small",
        rig="rigs/paper.toml",
        period_s=0.008,
        memory=9,
        standstill_s=0.8,
        lead_in=64,
        identification=MSequence(polynomial="1021", amplitude_rad_s=AMPLITUDE_RAD_S),
        validation=RandomBinary(
            kind="random-binary", seed=1, amplitude_rad_s=AMPLITUDE_RAD_S, length=200
        ),
    )


@cache
def paper_rig() -> RigConfig:
    """The paper's rig."""
    return load_rig("rigs/paper.toml")


def noisy_rig(seed: int, **simulated: Any) -> RigConfig:
    """The paper's rig with white noise on both encoders; `simulated` as in `[simulated]`."""
    rig = paper_rig()
    assert rig.simulated is not None
    noise = {"load_encoder_noise_rad": NOISE_RAD, "motor_encoder_noise_rad": NOISE_RAD}
    changes = {"seed": seed, **noise, **simulated}
    return rig.model_copy(update={"simulated": rig.simulated.model_copy(update=changes)})


@cache
def small_run(seed: int = 1) -> Recording:
    """The small experiment on the noisy rig."""
    return run_virtually(experiment(), noisy_rig(seed))
