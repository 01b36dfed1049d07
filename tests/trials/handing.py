"""What the diagnoser gets: two recordings and the nominal rig. No seed, no name, no `[simulated]`.

    seen.mcap, holdout.mcap, rig.toml      in a folder of their own

Recorded straight from the truth plant, or by the bench over a real wire from a rig whose plant is
the truth (`wired.py`), or written and imported as another bench's data are (`measured.py`).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.judging.extended import rig_text
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.mcap_file import RecordingWriter, load
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE, Recording
from servo_bench.rig import Limits, NominalConfig, RigConfig, SimulatedConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn
from tests.trials.drawing import Bus, Question
from tests.trials.measured import cut_of, write_measured
from tests.trials.names import Channels
from tests.truth import hidden
from tests.truth.hidden import Sealed
from tests.truth.plant import NominalValues

RIGS: dict[Bus, str] = {
    "canopen": "rigs/paper.toml",
    "modbus-rtu": "rigs/modbus-rtu.toml",
    "modbus-tcp": "rigs/modbus-tcp.toml",
    "serial-counter": "rigs/serial-counter.toml",
}
FACTS = {"source": "a trial", "command": "servo-bench run"}
NOMINAL = (
    *("torque_constant_nm_per_a", "inertia_kg_m2", "proportional_gain_a_s_per_rad"),
    *("integral_gain_a_per_rad", "backlash_gap_rad"),
)
LIMITS = Limits(velocity_rad_s=20.0, travel_rad=400.0, run_time_s=3600.0)
NOT_COUNTED = ("device_time_us", "motor_position_counts")
MOTOR_CHANNELS = ("motor_position_rad", "motor_velocity_rad_s", "motor_torque_nm")


class Handed(NamedTuple):
    """The files."""

    seen: Path
    held_out: Path
    rig: Path


def hand_over(question: Question, sealed: Sealed, folder: Path) -> Handed:
    """Record the trial into an empty folder."""
    handed = Handed(folder / "seen.mcap", folder / "holdout.mcap", folder / "rig.toml")
    rig = nominal_rig(question.nominal, question.bus)
    handed.rig.write_text(rig_text(rig))
    for take, (path, experiment) in enumerate(zip(handed, question.plan, strict=False)):
        if question.wire:
            _over_the_wire(question, experiment, rig, path, take)
        else:
            recording = straight(question, sealed, take)
            if question.measured:
                write_measured(recording, path, question.channels, cut_of(question.seed, take))
            else:
                _write(recording, experiment, rig, path, question.channels)
    return handed


def straight(question: Question, sealed: Sealed, take: int) -> Recording:
    """What is seen (take 0) or held out (1), straight from the truth plant."""
    return hidden.record(
        sealed,
        question.plan[take],
        question.nominal,
        take=take,
        sized_for_rad_s=question.plan.velocity_rad_s,
    )


def nominal_rig(nominal: NominalValues, bus: Bus = "canopen") -> RigConfig:
    """The paper's rig with these nominal values, as one would write it: nothing simulated."""
    values = {name: getattr(nominal, name) for name in NOMINAL}
    changes = {
        "name": "rig",
        "nominal": NominalConfig(**values),
        "limits": LIMITS,
        "simulated": None,
    }
    return load_rig(RIGS[bus]).model_copy(update=changes)


def _write(
    recording: Recording,
    experiment: Experiment,
    rig: RigConfig,
    path: Path,
    channels: Channels,
) -> None:
    with RecordingWriter(path, experiment, rig, FACTS, 1.0 / experiment.period_s) as writer:
        writer.samples(_rows(recording, channels))


def _rows(recording: Recording, channels: Channels) -> NDArray[np.void]:
    """The recording's rows as a run writes them; what did not come is NaN or MISSING."""
    rows = np.zeros(len(recording), SAMPLE_DTYPE)
    for name, kind in SAMPLE_DTYPE.fields.items() if SAMPLE_DTYPE.fields else ():
        if name in recording:
            rows[name] = recording[name]
        elif kind[0].kind == "f":
            rows[name] = np.nan
        elif name in NOT_COUNTED:
            rows[name] = MISSING
    if channels == "load":
        for name in MOTOR_CHANNELS:
            rows[name] = np.nan
    return rows


def _over_the_wire(
    question: Question, experiment: Experiment, rig: RigConfig, path: Path, take: int
) -> None:
    """Run the experiment on a software rig whose plant is the truth; keep the chosen channels."""
    behind = SimulatedConfig(
        plant=f"tests.trials.wired:{question.kind}",
        seed=2 * question.seed + take,
        load_encoder_noise_rad=hidden.LOAD_ENCODER_NOISE_COUNTS
        * 2.0
        * np.pi
        / hidden.COUNTS_PER_REVOLUTION,
        rated_torque_nm=hidden.RATED_TORQUE_NM,
    )
    truth = rig.on_a_free_port().model_copy(update={"simulated": behind})
    raw = path.with_suffix(".raw")
    with spawn(truth.simulation_settings()) as started:
        run(experiment, rig.with_bus(**started.bus), raw, facts=FACTS)
    _write(load(raw), experiment, rig, path, question.channels)
    raw.unlink()
