"""A rig that can be simulated: nominal values, and effects with their strengths.

    command -> [controller] -> current -> [mechanics] -> motor -> [transmission] -> load angle

`Model(nominal)` is the paper's rig, G(s) and a rigid play, exactly. Effects are named by their
file and given as their `Params`; every combination runs the same compiled page.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim_rig.effects import effects_from_table, find_effect
from sim_rig.effects.effect import Port, Signals
from sim_rig.errors import EffectError, SimulationError
from sim_rig.model.engine import engine
from sim_rig.model.plant import ModelPlant
from sim_rig.model.running import Inputs, checked_durations, own_array, play, run_page
from sim_rig.model.state import COLUMNS, ModelState, Simulated
from sim_rig.settings import Nominal

LONGEST_STEP_S = 50e-6


@dataclass(frozen=True)
class Model:
    """Nominal values and effects. Raises EffectError where an effect cannot be what it is told.

    `longest_step_s`: a slot is played in equal steps no longer than this, nor than half of the
    ideal loop's fastest time.
    """

    nominal: Nominal
    effects: Mapping[str, Any] = field(default_factory=dict)
    longest_step_s: float = LONGEST_STEP_S

    def __post_init__(self) -> None:
        for name, params in self.effects.items():
            effect = find_effect(name)
            if not isinstance(params, effect.params):
                raise EffectError(
                    f"{name} was given {params!r}: give its Params, a NamedTuple of "
                    f"{', '.join(effect.params._fields)}, or use Model.with_effect."
                )
            effect.check(params)
        if not (math.isfinite(self.longest_step_s) and self.longest_step_s > 0.0):
            raise SimulationError(
                f"longest_step_s = {self.longest_step_s}: must be a finite time above zero, "
                f"such as {LONGEST_STEP_S}."
            )
        object.__setattr__(self, "effects", MappingProxyType(dict(self.effects)))
        self._check_inertias()

    def __reduce__(self) -> tuple[Any, ...]:
        return Model, (self.nominal, dict(self.effects), self.longest_step_s)

    def __hash__(self) -> int:
        return hash((self.nominal, frozenset(self.effects.items()), self.longest_step_s))

    def with_effect(self, name: str, **values: float) -> "Model":
        """The same rig with this effect set to these parameters, the others at their defaults."""
        params = find_effect(name).make(values)
        return replace(self, effects={**self.effects, name: params})

    def without(self, *names: str) -> "Model":
        """The same rig with these effects off."""
        kept = {name: params for name, params in self.effects.items() if name not in names}
        return replace(self, effects=kept)

    @classmethod
    def from_table(cls, nominal: Nominal, table: Mapping[str, Mapping[str, float]]) -> "Model":
        """From the `[effects.NAME]` tables of a TOML file: `torque_nm = 0.01` and so on."""
        return cls(nominal, effects_from_table(table))

    def to_table(self) -> dict[str, dict[str, float]]:
        """What `from_table` takes; parameters at their defaults are left out."""
        return {
            name: {
                parameter.name: getattr(params, parameter.name)
                for parameter in find_effect(name).parameters
                if getattr(params, parameter.name) != parameter.default
            }
            for name, params in self.effects.items()
        }

    def simulate(
        self,
        commands_rad_s: ArrayLike,
        durations_s: ArrayLike,
        start: ModelState | None = None,
    ) -> Simulated:
        """Hold command k, shape (slots,), for duration k, shape (slots,) or (); from rest.

        Raises SimulationError where shapes or values make no sense, or the simulation runs away.
        """
        commands = own_array(commands_rad_s)
        durations = checked_durations(commands, durations_s)
        if not np.isfinite(commands).all():
            raise SimulationError("commands_rad_s: every command must be finite.")
        return play(self, Inputs(commands, durations, np.zeros((commands.size, 4))), start)

    def plant(self, seed: int = 0) -> ModelPlant:  # noqa: ARG002 - nothing in the model is random
        """The model behind the `Plant` protocol, at rest: what a rig on the wire is given."""
        return ModelPlant(self, self.at_rest())

    def at_rest(self) -> ModelState:
        """Power stage off, everything at zero, the load in the middle of its gap."""
        return self.state()

    def state(
        self,
        *,
        motor_angle_rad: float = 0.0,
        motor_velocity_rad_s: float = 0.0,
        integral_rad: float = 0.0,
        load_angle_rad: float = 0.0,
        load_velocity_rad_s: float = 0.0,
        command_rad_s: float | None = None,
        time_s: float = 0.0,
    ) -> ModelState:
        """A state to start from; None: power stage off. Memories of effects are empty."""
        machine = engine()
        values = np.zeros(machine.state_size)
        values[:5] = (
            *(motor_angle_rad, motor_velocity_rad_s, integral_rad),
            *(load_angle_rad, load_velocity_rad_s),
        )
        values[5] = np.nan if command_rad_s is None else command_rad_s  # acts, however late
        values[10:13] = motor_angle_rad, motor_velocity_rad_s, self.nominal.backlash_gap_rad
        rows = np.zeros((1, COLUMNS))
        look = values[5:6].copy()
        run_page(machine, self, values, Inputs(look, np.zeros(1), np.zeros((1, 4))), rows)
        values[6:8] = time_s, 0.0
        return ModelState(tuple(values.tolist()), tuple(rows[0].tolist()))

    def _check_inertias(self) -> None:
        inertia = self.nominal.inertia_kg_m2
        behind = 0.0
        for name, params in self.effects.items():
            effect = find_effect(name)
            if effect.port is Port.INERTIA and not effect.is_off(params):
                inertia = float(effect.law(Signals(inertia_kg_m2=inertia), params))
            if effect.port in (Port.TRANSMISSION, Port.COUPLING) and not effect.is_off(params):
                behind += effect.law(Signals(), params)[2]
        if not inertia > 0.0:
            raise EffectError(f"the effects make the inertia {inertia} kg m^2: must be above zero.")
        if not 0.0 <= behind < inertia:
            raise EffectError(
                f"the load's inertia is {behind:g} kg m^2 of {inertia:g} in all: it is a part of "
                "the total; lower load_inertia_kg_m2 of contact and coupling_compliance."
            )


def simulate_many(
    models: Sequence[Model],
    commands_rad_s: ArrayLike,
    durations_s: ArrayLike,
    starts: Iterable[ModelState] | None = None,
    workers: int | None = None,
) -> list[Simulated]:
    """Every model under the same commands, over the machine's cores (the page holds no lock).

    Raises SimulationError where starts are given, and not one for each model.
    """
    begin = [None] * len(models) if starts is None else list(starts)
    if len(begin) != len(models):
        raise SimulationError(f"{len(begin)} starts for {len(models)} models: give one for each.")
    engine()
    with ThreadPoolExecutor(workers) as pool:
        return list(
            pool.map(
                lambda model, start: model.simulate(commands_rad_s, durations_s, start),
                models,
                begin,
            )
        )
