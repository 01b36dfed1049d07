"""Recordings of drives that are not ours, as the rig's own model can play them.

A voltage. The electric time constant is short beside the mechanics, so that the winding's current
is what resistance and back-EMF leave,

    K_T i = (K_T/R) u - (K_T^2/R) omega:     a current u/R, and a viscous drag K_T^2/R more.

Where nobody published R, it counts as one ohm: K_T is then the torque per volt, and the back-EMF is
part of what is fitted as viscous friction.

A position loop, u = gain (command - angle). It is a velocity loop without a proportional part: the
integral of the command's rate less the motor's is the angle's error,

    i* = K_I z,   dz/dt = d(command)/dt - omega,   K_I = gain/R,

and a voltage limit U is a current limit U/R. Commands are held between two rows, half a row late;
so is the central difference that is taken for their rate. What the angle is off at the beginning
is commanded in the first row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.comparison import Choice, Comparison, compare
from servo_bench.diagnosis.comparing.rows import EFFORTS, Array
from servo_bench.errors import FitError
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.recording import Recording
from sim_rig.effects import find_effect
from sim_rig.model import Model

View = Callable[[Model], Model]

FULL = 0.99
"""Of the limit: a voltage beyond does not follow its command."""


@dataclass(frozen=True, slots=True, eq=False)
class DrivenComparison(Comparison):
    """A comparison in which what is played is a model seen through its drive."""

    view: View

    def errors(self, model: Model) -> Array:
        """Measured minus simulated, of what the drive makes of the model."""
        return Comparison.errors(self, self.view(model))


def is_driven(recording: Recording) -> bool:
    """Whether nothing but a voltage drives, or a position is commanded."""
    if recording.rig is not None or (recording.plant and recording.plant.output_locked):
        return False
    return _by_voltage(recording) or _by_position(recording)


def compare_driven(
    recording: Recording,
    model: Model,
    block: Choice,
    window_s: float | None,
    *,
    scales: Sequence[int] = (),
) -> DrivenComparison:
    """The recording beside models such as `model`. Raises as `compare` does, for `scales` too."""
    looped = _by_position(recording)
    if block == "auto":
        open_ = any(b.name == "mechanics" for b in blocks_of(recording))
        block = "mechanics" if open_ else "loop"
    looped = looped and block in ("loop", "controller")
    # beside the voltage over R, which the loop is played with, a measured current is another thing
    shown = _without_efforts(recording) if looped else recording
    shown = _in_amperes(shown) if _by_voltage(shown) else shown
    if looped:
        shown = _with_rate(shown)
    made = compare(shown, model, block, window_s, scales=scales)
    known = {field.name: getattr(made, field.name) for field in fields(made)}
    return DrivenComparison(**known, view=_view(recording, looped=looped))


def resistance_ohm(recording: Recording) -> float:
    """The winding's, or one where nobody published it."""
    return (recording.plant and recording.plant.resistance_ohm) or 1.0


def _by_voltage(recording: Recording) -> bool:
    return "voltage_v" in recording and not any(name in recording for name in EFFORTS)


def _by_position(recording: Recording) -> bool:
    return "position_command_rad" in recording and "velocity_command_rad_s" not in recording


def _view(recording: Recording, *, looped: bool) -> View:
    """Back-EMF as damping, where the resistance is known."""
    published = recording.plant.resistance_ohm if recording.plant else None
    if published is None or not (looped or _by_voltage(recording)):
        return lambda model: model

    def view(model: Model) -> Model:
        drag = find_effect("viscous").params()
        drag = model.effects.get("viscous", drag)
        more = model.nominal.torque_constant_nm_per_a**2 / published
        damped = drag._replace(damping_nm_s_per_rad=drag.damping_nm_s_per_rad + more)
        return replace(model, effects={**model.effects, "viscous": damped})

    return view


def _in_amperes(recording: Recording) -> Recording:
    """With the current that the voltage would drive through a motor at rest.

    A current is played as straight lines from row to row. What is held from its row to the next, a
    commanded voltage or the command's part of a position loop's, acts as much as the means of
    neighbours do, and at the same time.
    """
    voltage = np.asarray(recording["voltage_v"], np.float64)
    held, loop = voltage, recording.plant.position_loop if recording.plant else None
    if _by_position(recording):
        gain = loop.proportional_gain_v_per_rad if loop else 0.0
        held = gain * np.asarray(recording["position_command_rad"], np.float64)
    jumps = np.diff(held, prepend=held[:1])
    jumps[_run_starts(recording)] = 0.0
    if loop is not None and loop.voltage_limit_v is not None:
        jumps[np.abs(voltage) >= FULL * loop.voltage_limit_v] = 0.0
    current = (voltage - 0.5 * jumps) / resistance_ohm(recording)
    for name, values in recording.channels.items():
        if "enable" in name:
            # an open winding is driven by nothing that was recorded
            current = np.where(values != 0, current, np.nan)
    return replace(recording, channels={**recording.channels, "current_a": current})


def _run_starts(recording: Recording) -> NDArray[np.intp]:
    """Where runs begin, but for the first."""
    run = recording["run"] if "run" in recording else np.zeros(len(recording))
    return np.flatnonzero(np.diff(run) != 0) + 1


def _with_rate(recording: Recording) -> Recording:
    """With a velocity command whose integral is the position's, run by run."""
    if "motor_position_rad" not in recording:
        raise FitError(
            "a position was commanded and no motor position recorded: what the loop acts on is "
            "their difference. Map motor_position, or fit the mechanics (--block mechanics)."
        )
    time_s = np.asarray(recording["t_s"], np.float64)
    command = np.asarray(recording["position_command_rad"], np.float64)
    angle = np.asarray(recording["motor_position_rad"], np.float64)
    rate = np.zeros(command.size)
    for rows in np.split(np.arange(command.size), _run_starts(recording)):
        if rows.size > 2:
            rate[rows] = np.gradient(command[rows], time_s[rows])
            off = command[rows[0]] - angle[rows[0]]
            rate[rows[0]] += off / (time_s[rows[1]] - time_s[rows[0]])
    return replace(recording, channels={**recording.channels, "velocity_command_rad_s": rate})


def _without_efforts(recording: Recording) -> Recording:
    kept = {name: values for name, values in recording.channels.items() if name not in EFFORTS}
    return replace(recording, channels=kept)
