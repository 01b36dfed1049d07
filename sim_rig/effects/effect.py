"""The words an effect is written in: port, parameters with priors, law, memory.

An effect is one physical cause in one file. `sum` ports add what every law returns; `pipe` ports
hand a value through every law in turn, and a law finds the value in the signal of the port's own
name. The same law runs compiled in the simulator, on whole recordings as a regressor, and in
plain Python.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from sim_rig.errors import EffectError

Value = float | NDArray[np.float64]
"""A number, or one for every sample of a recording."""


class Signals(NamedTuple):
    """What a law may read; scalars in the simulator, arrays of shape (samples,) on a recording.

    In a step they are taken at its middle, in the order below; a pipe's signal holds the value
    on its way. `contact_torque_nm` is the torque that the load takes from the motor, one step old.
    """

    # the slot, once for each
    slot: Any = 0.0
    slot_duration_s: Any = 0.008
    slot_command_rad_s: Any = 0.0
    command_delay_s: Any = 0.0
    # clocks: a step has a length; a look at its end or at a jump of the command has none
    time_s: Any = 0.0
    step_s: Any = 0.0
    since_s: Any = 0.0
    # nominal values
    torque_constant_nm_per_a: Any = 0.036
    nominal_inertia_kg_m2: Any = 2.5e-4
    proportional_gain_a_s_per_rad: Any = 1.0
    integral_gain_a_per_rad: Any = 70.0
    nominal_gap_rad: Any = 0.0
    inertia_kg_m2: Any = 2.5e-4
    # state
    motor_angle_rad: Any = 0.0
    motor_velocity_rad_s: Any = 0.0
    load_angle_rad: Any = 0.0
    load_velocity_rad_s: Any = 0.0
    contact_torque_nm: Any = 0.0
    backlash_gap_rad: Any = 0.0
    # controller
    command_rad_s: Any = 0.0
    measured_velocity_rad_s: Any = 0.0
    integral_rad: Any = 0.0
    velocity_error_rad_s: Any = 0.0
    current_demand_a: Any = 0.0
    current_command_a: Any = 0.0
    integral_rate_rad_s: Any = 0.0
    current_a: Any = 0.0
    # mechanics and transmission
    electric_torque_nm: Any = 0.0
    motor_torque_nm: Any = 0.0
    load_torque_nm: Any = 0.0
    # sensors
    measured_motor_angle_rad: Any = 0.0
    measured_current_a: Any = 0.0
    measured_load_angle_rad: Any = 0.0


class Port(StrEnum):
    """Where an effect enters; the value is the signal it changes. In the order of a step."""

    INERTIA = "inertia_kg_m2"
    """pipe, once a simulation: total inertia; the law reads parameters and nominal values only"""
    TRANSMISSION = "transmission"
    """sum, once a simulation: (compliance rad/Nm, compliance x damping time rad s/Nm, load inertia
    kg m^2, slope of the restitution s/rad); any compliance makes the load a second mass that is
    driven through the gap"""
    COUPLING = "coupling"
    """sum, once a simulation: the first three of a spring between the motor and what drives the
    gap; any compliance makes that a mass of its own"""
    SLOT_DURATION = "slot_duration_s"
    """pipe, once a slot: the slot's length on the rig's own clock"""
    SLOT_COMMAND = "slot_command_rad_s"
    """pipe, once a slot: the command that arrives in it"""
    COMMAND_DELAY = "command_delay_s"
    """sum, once a slot: how much later than the slot's start its command acts"""
    BACKLASH_GAP = "backlash_gap_rad"
    """pipe: full width of the gap"""
    COMMAND = "command_rad_s"
    """pipe: velocity command as the loop sees it"""
    VELOCITY_FEEDBACK = "measured_velocity_rad_s"
    """pipe: motor velocity as the loop sees it"""
    INTEGRAL = "integral_rad"
    """pipe on the integrator's state (no memory of its own): clamps"""
    CURRENT_DEMAND = "current_demand_a"
    """pipe: what the velocity loop's gains make of its error, before any limit"""
    CURRENT_COMMAND = "current_command_a"
    """pipe: what the velocity loop asks of the current loop"""
    INTEGRAL_RATE = "integral_rate_rad_s"
    """pipe: what the integrator integrates; the limited current command is known here"""
    CURRENT = "current_a"
    """pipe: the motor's current"""
    ELECTRIC_TORQUE = "electric_torque_nm"
    """pipe: torque that the current makes, K_T i nominally"""
    MOTOR_TORQUE = "motor_torque_nm"
    """sum: further torques on the motor's shaft"""
    LOAD_TORQUE = "load_torque_nm"
    """sum: torques on the load's shaft"""
    MOTOR_SENSOR = "measured_motor_angle_rad"
    """pipe, at every look: motor angle as recorded"""
    CURRENT_SENSOR = "measured_current_a"
    """pipe, at every look: current as recorded"""
    LOAD_SENSOR = "measured_load_angle_rad"
    """pipe, at every look: load angle as recorded"""

    @property
    def is_sum(self) -> bool:
        """Whether what the laws return is added up."""
        return self in _SUMS


_SUMS = {
    *(Port.TRANSMISSION, Port.COUPLING, Port.COMMAND_DELAY),
    *(Port.MOTOR_TORQUE, Port.LOAD_TORQUE),
}


@dataclass(frozen=True, slots=True)
class Prior:
    """Where a parameter usually lies (`low`..`high`) and what has a meaning at all.

    A value below `least`, above `most`, or not greater than `above` has none.
    """

    low: float
    high: float
    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf

    def objection(self, value: float) -> str | None:
        """What is allowed, where `value` is not."""
        if math.isfinite(value) and self.least <= value <= self.most and value > self.above:
            return None
        words = ["a finite number"]
        if self.least > -math.inf:
            words.append(f"at least {self.least:g}")
        if self.most < math.inf:
            words.append(f"at most {self.most:g}")
        if self.above > -math.inf:
            words.append(f"above {self.above:g}")
        return ", ".join(words)


def LogUniform(low: float, high: float, *, most: float = math.inf) -> Prior:  # noqa: N802
    """A magnitude: between `low` and `high` by its logarithm; never negative, zero is none."""
    return Prior(low, high, least=0.0, most=most)


def Uniform(  # noqa: N802
    low: float, high: float, *, least: float = -math.inf, most: float = math.inf
) -> Prior:
    """A signed quantity: between `low` and `high`."""
    return Prior(low, high, least=least, most=most)


def Known(low: float = -math.inf, high: float = math.inf, *, above: float = 0.0) -> Prior:  # noqa: N802
    """Not fitted: numerical, or read from a data sheet. Above zero unless said otherwise."""
    return Prior(low, high, above=above)


class Parameter(NamedTuple):
    """One field of an effect's `Params`."""

    name: str
    default: float
    prior: Prior


@dataclass(frozen=True)
class Effect:
    """One physical cause. `name`, `equation` and `summary` come from its file.

    `law(s, p)` or, with memory, `law(s, z, p)`; `advance(s, z, p, dt_s)` returns the memory at
    the end of a step of `dt_s` that began with `z`; `dt_s` is 0 at a look. `strengths` are the
    parameters that must all be zero for the effect to be off; the first one, by default.
    """

    port: Port
    params: type[Any]
    law: Callable[..., Any]
    shows: str
    confused_with: tuple[str, ...]
    source: str
    memory: type[Any] | None = None
    advance: Callable[..., Any] | None = None
    strengths: tuple[str, ...] = ()
    sample: Mapping[str, float] = field(default_factory=dict)
    """Parameters of a plainly visible case, for tests and for plots of the signature."""
    beside: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Other effects, by name, without which the sample would not show."""

    def __post_init__(self) -> None:
        if not self.strengths:
            object.__setattr__(self, "strengths", self.params._fields[:1])

    @property
    def name(self) -> str:
        """The name of its file."""
        return self.law.__module__.rpartition(".")[2]

    @cached_property
    def _doc(self) -> str:
        return self.law.__globals__.get("__doc__") or ""

    @property
    def summary(self) -> str:
        """The first line of its file."""
        return self._doc.strip().partition("\n")[0]

    @property
    def equation(self) -> str:
        """The indented lines under the first one."""
        paragraphs = self._doc.strip().split("\n\n")
        return next((p for p in paragraphs[1:] if p.startswith("    ")), "")

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every parameter with its default and prior, strengths first."""
        hints = get_type_hints(self.params, include_extras=True)
        return tuple(
            Parameter(name, float(self.params._field_defaults[name]), _prior(self, name, hint))
            for name, hint in hints.items()
        )

    def is_off(self, params: Any) -> bool:
        """Whether every strength is exactly zero."""
        return all(getattr(params, name) == 0.0 for name in self.strengths)

    def check(self, params: Any) -> None:
        """Raise EffectError where a value has no meaning."""
        for parameter in self.parameters:
            value = getattr(params, parameter.name)
            allowed = parameter.prior.objection(float(value))
            if allowed is not None:
                raise EffectError(
                    f"{self.name}.{parameter.name} = {value}: must be {allowed}; "
                    f"usual values lie between {parameter.prior.low:g} and "
                    f"{parameter.prior.high:g}. Leave it out for {parameter.default:g}."
                )

    def make(self, values: Mapping[str, float]) -> Any:
        """Params from a table. EffectError for an unknown name or a value without meaning."""
        names = self.params._fields
        for name, value in values.items():
            if name not in names:
                raise EffectError(
                    f"{self.name} has no parameter {name!r}; it has {', '.join(names)}."
                )
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise EffectError(f"{self.name}.{name} = {value!r}: must be a number.")
        params = self.params(**{name: float(value) for name, value in values.items()})
        self.check(params)
        return params

    def regressor(self, signals: Signals, params: Any) -> Any:
        """The law on whole arrays; only for laws without memory."""
        return self.law(signals, params)


def _prior(effect: Effect, name: str, hint: Any) -> Prior:
    priors = [a for a in get_args(hint)[1:] if isinstance(a, Prior)]
    if get_origin(hint) is not Annotated or len(priors) != 1:
        raise EffectError(
            f"{effect.name}.{name}: annotate it with one prior, "
            "such as Annotated[float, LogUniform(1e-4, 1.0)]."
        )
    return priors[0]
