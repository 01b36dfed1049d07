"""A second hand's servo axis, grown: every effect of `effects` can be hidden in it.

It shares no equation, no integrator, and no step with the software rig's own model, and knows of
it only `sim_rig.plant`. `drive` runs at 8 kHz on counts of its own encoder; `mechanics` has
set-valued friction and tabulated cogging; `transmission` has a gap with Hertz's contact;
`sensors` is the load encoder; `nuisances` is what is always there; `motion` and `stepping` are the
integrator.

    make(nominal, seed)                       nothing hidden: "tests.truth.plant:make"
    hidden(coulomb_nm=0.02)                   a factory like it, with effects
    TruthPlant(nominal, seed, effects, nuisances)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim_rig.plant import Plant, PlantOutputs
from tests.truth.drive import Rig
from tests.truth.effects import NONE, Effects
from tests.truth.energy import energy_j
from tests.truth.mechanics import TABLE_SIZE, torque_table_nm
from tests.truth.nuisances import Nuisances, scattered
from tests.truth.sensors import BitErrors, reported_rad
from tests.truth.state import State, at_rest
from tests.truth.stepping import (
    COLUMNS,
    CREEP_RAD,
    CURRENT_A,
    LOAD_RAD,
    MOTOR_RAD,
    MOTOR_RAD_S,
    ROUNDING,
    run,
)


class NominalValues(Protocol):
    """What is read of a rig's nominal values."""

    @property
    def torque_constant_nm_per_a(self) -> float: ...
    @property
    def inertia_kg_m2(self) -> float: ...
    @property
    def proportional_gain_a_s_per_rad(self) -> float: ...
    @property
    def integral_gain_a_per_rad(self) -> float: ...
    @property
    def backlash_gap_rad(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Played:
    """What ideal sensors (and the load encoder) saw at each command's start; shapes (n,)."""

    motor_position_rad: NDArray[np.float64]
    motor_velocity_rad_s: NDArray[np.float64]
    motor_current_a: NDArray[np.float64]
    load_angle_rad: NDArray[np.float64]


class TruthPlant:
    """The axis behind the `Plant` protocol, at rest at first. The seed is in its noise alone."""

    def __init__(
        self,
        nominal: NominalValues,
        seed: int,
        effects: Effects = NONE,
        nuisances: Nuisances | None = None,
    ) -> None:
        self._rig = Rig(
            float(nominal.torque_constant_nm_per_a),
            float(nominal.inertia_kg_m2),
            float(nominal.proportional_gain_a_s_per_rad),
            float(nominal.integral_gain_a_per_rad),
            float(nominal.backlash_gap_rad),
        )
        self._effects = Effects(*map(float, effects))
        self._nuisances = scattered(seed) if nuisances is None else nuisances
        self._table = torque_table_nm(self._nuisances, self._effects)
        self._noise = np.random.default_rng((seed, 1))
        self._losses = np.random.default_rng((seed, 2))
        self._jitter = np.random.default_rng((seed, 4))
        self._bit_errors = BitErrors(
            self._effects.bit_errors_per_s, np.random.default_rng((seed, 3))
        )
        self._state = at_rest(self._rig, self._nuisances)
        self._elapsed_s = 0.0
        self._edge_s = np.empty(0)
        self._edge_rad_s = np.empty(0)
        self._now = self._run(np.zeros(1))  # compiles, or loads, before any clock runs

    @property
    def state(self) -> State:
        """All of it, at the last whole step."""
        return self._state

    @property
    def effects(self) -> Effects:
        """What is wrong with it."""
        return self._effects

    @property
    def waiting(self) -> int:
        """How many telegrams are on their way."""
        return int(self._edge_s.size)

    def put(self, state: State) -> None:
        """Start over from this state, at time zero of its step count."""
        self._state = state
        self._elapsed_s = state.step * self._nuisances.step_s

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command for `duration_s`; each call is a telegram.

        ValueError where the hidden clock skew is below zero: commands would have to act before
        they are given. `play` knows them all and can.
        """
        if self._effects.clock_skew < 0.0:
            raise ValueError(
                f"clock_skew = {self._effects.clock_skew}: a recorder that samples later and "
                "later sees answers to commands not yet given; play() the whole schedule instead"
            )
        command = math.nan if velocity_command_rad_s is None else float(velocity_command_rad_s)
        self._receive(np.array([self._elapsed_s]), np.array([command]))
        self._elapsed_s += duration_s
        self._now = self._run(np.array([self._elapsed_s]))

    def outputs(self) -> PlantOutputs:
        """The state now; within a step, angles go on at their velocities."""
        now = self._now[-1]
        return PlantOutputs(
            motor_position_rad=float(now[MOTOR_RAD]),
            motor_velocity_rad_s=float(now[MOTOR_RAD_S]),
            motor_current_a=float(now[CURRENT_A]),
            load_angle_rad=float(self._reported(np.array([self._elapsed_s]), self._now[-1:])[0]),
        )

    def play(self, velocity_rad_s: NDArray[np.float64], period_s: float) -> Played:
        """Every command for a period, and what was seen at its start; NaN: power stage off."""
        slots = np.arange(velocity_rad_s.size + 1, dtype=np.float64)
        begin_s: NDArray[np.float64] = self._elapsed_s + period_s * slots
        self._receive(begin_s[:-1], np.asarray(velocity_rad_s, dtype=np.float64))
        sampled = self._run(begin_s)
        self._elapsed_s, self._now = float(begin_s[-1]), sampled[-1:]
        return Played(
            motor_position_rad=sampled[:-1, MOTOR_RAD].copy(),
            motor_velocity_rad_s=sampled[:-1, MOTOR_RAD_S].copy(),
            motor_current_a=sampled[:-1, CURRENT_A].copy(),
            load_angle_rad=self._reported(begin_s[:-1], sampled[:-1]),
        )

    def torque_nm(self, motor_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cogging and what else is in the table, at these angles, same shape."""
        place = np.mod(motor_rad, math.tau) * (TABLE_SIZE / math.tau)
        return np.interp(place, np.arange(TABLE_SIZE + 1), self._table)

    def energy_j(self) -> float:
        """Kinetic energy, what contact and coupling store, and the load's height."""
        return energy_j(self._rig, self._nuisances, self._effects, self._state)

    def _receive(self, sent_s: NDArray[np.float64], command: NDArray[np.float64]) -> None:
        """Queue telegrams with the times at which the drive has them."""
        effects = self._effects
        due_s = sent_s * (1.0 + effects.clock_skew) + effects.transport_delay_s
        arrived = self._losses.random(due_s.size) >= effects.missed_probability
        arrived |= np.isnan(command)  # no telegram: the drive switches itself off
        late_s = effects.command_jitter_s * np.abs(self._jitter.standard_normal(due_s.size))
        self._edge_s = np.append(self._edge_s, (due_s + late_s)[arrived])
        self._edge_rad_s = np.append(self._edge_rad_s, command[arrived])

    def _run(self, sample_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """On to the last of these times; the state at each, shape (n, COLUMNS)."""
        nuisances, sampled = self._nuisances, np.empty((sample_s.size, COLUMNS))
        self._state, taken = run(
            self._rig,
            nuisances,
            self._effects,
            self._table,
            nuisances.torque_noise_nm * self._noise.standard_normal(self._ticks(sample_s[-1])),
            self._edge_s,
            self._edge_rad_s,
            sample_s,
            self._state,
            sampled,
        )
        self._edge_s, self._edge_rad_s = self._edge_s[taken:], self._edge_rad_s[taken:]
        return sampled

    def _ticks(self, until_s: float) -> int:
        """How many loop periods begin up to then."""
        nuisances = self._nuisances
        last = math.floor(until_s / (nuisances.loop_period_s / nuisances.substeps) + ROUNDING)
        begun = (
            -(-(step + nuisances.loop_phase) // nuisances.substeps)
            for step in (self._state.step, max(last, self._state.step))
        )
        before, after = begun
        return after - before

    def _reported(
        self, time_s: NDArray[np.float64], sampled: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return reported_rad(
            self._effects, self._bit_errors, time_s, sampled[:, LOAD_RAD], sampled[:, CREEP_RAD]
        )


def make(nominal: NominalValues, seed: int) -> Plant:
    """The axis with nothing hidden; the seed scatters its nuisances."""
    return TruthPlant(nominal, seed)


def hidden(**strengths: float) -> Callable[[NominalValues, int], TruthPlant]:
    """A factory like `make` for an axis with these `Effects`."""
    effects = NONE._replace(**strengths)

    def make_changed(nominal: NominalValues, seed: int) -> TruthPlant:
        return TruthPlant(nominal, seed, effects)

    return make_changed
