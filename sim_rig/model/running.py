"""From a model to the page's arrays and back."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sim_rig.errors import SimulationError
from sim_rig.model.ahead import cut_ahead
from sim_rig.model.engine import Engine, engine
from sim_rig.model.skeleton import CLOSED
from sim_rig.model.state import COLUMNS, Array, ModelState, Simulated, simulated

if TYPE_CHECKING:
    from sim_rig.model.model import Model


def own_array(values: ArrayLike) -> Array:
    """A float array of our own: the compiled page takes no read-only one, and a row at least."""
    return np.array(values, np.float64, ndmin=1, order="C")


def checked_durations(samples: Array, durations_s: ArrayLike) -> Array:
    """One duration for every slot, in whole nanoseconds, so that equal times are equal bits."""
    durations = np.asarray(durations_s, np.float64)
    if samples.ndim != 1 or durations.shape not in ((), samples.shape):
        raise SimulationError(
            f"inputs of shape {samples.shape} and durations of shape {durations.shape}: "
            "give one row of inputs, and one duration for each or one for all."
        )
    if not (np.isfinite(durations).all() and (durations >= 0.0).all()):
        raise SimulationError("durations_s: every duration must be finite and not negative.")
    whole = np.rint(durations * 1e9) * 1e-9
    return np.broadcast_to(whole, samples.shape).copy()


class Inputs(NamedTuple):
    """What the page is played: arrays of shape (slots,), and what a cut-open loop is given."""

    commands: Array
    durations: Array
    given: Array
    mode: int = CLOSED


def play(model: "Model", inputs: Inputs, start: ModelState | None) -> Simulated:
    """Run the page over checked inputs."""
    machine = engine()
    begin = start or model.at_rest()
    values = np.array(begin.values)
    if values.shape != (machine.state_size,):
        raise SimulationError("the start is another catalogue's state: make it with Model.state.")
    rows = _rows(machine, model, values, inputs, begin.time_s)
    if not np.isfinite(rows).all():
        when = float(
            inputs.durations[: int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])].sum()
        )
        raise SimulationError(
            f"the simulation ran away {when:.3f} s after its start: an effect is too stiff for "
            f"steps of {model.longest_step_s} s, or the loop is not stable. Shorten longest_step_s."
        )
    return simulated(begin, rows, values)


def _rows(machine: Engine, model: "Model", values: Array, inputs: Inputs, clock_s: float) -> Array:
    """What is recorded at every slot's end; commands may act ahead of the closed loop's slots."""
    cut = None
    if inputs.mode == CLOSED:
        cut = cut_ahead(model, inputs.commands, inputs.durations, clock_s)
    if cut is not None:
        inputs = Inputs(cut.commands, cut.durations, np.zeros((cut.commands.size, 4)))
    rows = np.empty((inputs.commands.size, COLUMNS))
    run_page(machine, model, values, inputs, rows)
    return rows if cut is None else rows[cut.ends]


def run_page(
    machine: Engine,
    model: "Model",
    values: Array,
    inputs: Inputs,
    rows: Array,
) -> None:
    """Play the inputs from `values`, which is left at the end, into `rows`."""
    parameters, longest = flat_parameters(model, machine), steps_of(model)
    if not machine.run(
        *(rig_array(model), parameters, values, inputs.commands, inputs.durations),
        *(inputs.given, inputs.mode, longest, rows),
    ):
        raise SimulationError(
            "more than 64 commands are on their way at once: the delay is too long for slots "
            "as short as these. Lower transport_delay or lengthen the slots."
        )


def rig_array(model: "Model") -> Array:
    """The page's nominal values: K_T, J, K_P, K_I, W."""
    nominal = model.nominal
    return np.array(
        [
            nominal.torque_constant_nm_per_a,
            nominal.inertia_kg_m2,
            nominal.proportional_gain_a_s_per_rad,
            nominal.integral_gain_a_per_rad,
            nominal.backlash_gap_rad,
        ]
    )


def steps_of(model: "Model") -> float:
    """The longest step: the model's, or what the propagator's series is exact for."""
    nominal = model.nominal
    damping = 2.0 * nominal.damping_ratio * nominal.natural_frequency_rad_s
    return min(model.longest_step_s, 0.5 / (damping + nominal.natural_frequency_rad_s))


def flat_parameters(model: "Model", machine: Engine) -> Array:
    """The page's parameters: the model's, and defaults for effects that it does not name."""
    chosen = model.effects
    return np.array(
        [
            getattr(chosen[name], parameter) if name in chosen else default
            for (name, parameter), default in zip(machine.parameters, machine.defaults, strict=True)
        ]
    )
