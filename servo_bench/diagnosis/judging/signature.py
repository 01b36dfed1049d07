"""What an effect does to a recording, computed: its residual against the same rig without it.

    e = y(with the effect's sample) - y(without)

on one standard excitation (see `standard_commands`), on the paper's rig with a gap. Nothing is
fitted and nothing projected out: a fit of the nominal values would take its share of a residual.
Free are only what nobody knows: the load angle's zero, and the phase of an effect that has one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_rig.effects import catalogue, find_effect
from sim_rig.effects.effect import Effect
from sim_rig.model import Model, Simulated, simulate_many
from sim_rig.settings import Nominal

Array = NDArray[np.float64]

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, 0.0262)
"""The paper's rig with a gap of 1.5 degrees."""
PERIOD_S = 1e-3
CHIP_PERIODS = 8
CHIPS = 4096
LEVELS_RAD_S = (-6.0, -3.0, 0.0, 0.2, 3.0, 6.0, 9.0)
SEED = 20
CHANNELS = ("load angle", "load velocity", "motor current")
PHASE, SHIFT_RAD = "phase_rad", 1.0
"""An effect with this parameter is simulated twice; both residuals span those of every phase."""


def standard_commands(chips: int = CHIPS) -> Array:
    """Velocity command, rad/s, in slots of 1 ms: seven levels, each for one to four chips of 8 ms.

    Several sizes, none, and almost none; long runs; a mean of 1.3 rad/s, so that in its 33 s the
    shaft makes full turns. Not periodic and not an M-sequence, which has two levels.
    """
    rng = np.random.default_rng(SEED)
    runs = rng.integers(1, 5, chips)
    levels = np.repeat(rng.choice(np.array(LEVELS_RAD_S), chips), runs)[:chips]
    return np.repeat(levels, CHIP_PERIODS)


@dataclass(frozen=True, eq=False)
class Signature:
    """The residual of one effect's sample; arrays of shape (samples,), at 1 kHz.

    `plain` is the rig without the effect, but with what the effect shows beside; `shifted` are
    the channels at another phase, for an effect that has one.
    """

    name: str
    commands_rad_s: Array
    plain: Simulated
    load_rad: Array
    velocity_rad_s: Array
    current_a: Array
    shifted: tuple[Array, Array, Array] | None = None

    @property
    def channels(self) -> tuple[Array, Array, Array]:
        """In the order of CHANNELS."""
        return self.load_rad, self.velocity_rad_s, self.current_a


def signatures(names: Sequence[str] | None = None, chips: int = CHIPS) -> dict[str, Signature]:
    """The signatures of these effects, or of the whole catalogue, by name."""
    wanted = [find_effect(name) for name in (catalogue() if names is None else names)]
    commands = standard_commands(chips)
    models = {effect.name: _models(effect) for effect in wanted}
    every = list(dict.fromkeys(model for row in models.values() for model in row))
    done = dict(zip(every, simulate_many(every, commands, PERIOD_S), strict=True))
    return {
        name: _signature(name, commands, [done[model] for model in row])
        for name, row in models.items()
    }


def _models(effect: Effect) -> list[Model]:
    """Without, with, and, where it has a phase, with another one."""
    plain = Model.from_table(NOMINAL, effect.beside)
    models = [plain, plain.with_effect(effect.name, **effect.sample)]
    if PHASE in effect.params._fields:
        phase = effect.sample.get(PHASE, 0.0) + SHIFT_RAD
        models.append(plain.with_effect(effect.name, **{**effect.sample, PHASE: phase}))
    return models


def _signature(name: str, commands: Array, done: Sequence[Simulated]) -> Signature:
    plain, *shown = done
    first, *others = (_residual(plain, one) for one in shown)
    return Signature(name, commands, plain, *first, others[0] if others else None)


def _residual(plain: Simulated, shown: Simulated) -> tuple[Array, Array, Array]:
    load = shown.load_angle_rad - plain.load_angle_rad
    current = shown.motor_current_a - plain.motor_current_a
    return load, np.gradient(load, PERIOD_S), current


def cosine(own: Array, *others: Array) -> float:
    """Of the angle between a residual and another, or the plane of two (then it has no sign).

    1 alike, -1 alike with the other sign, 0 where either is nothing.
    """
    size = float(np.linalg.norm(own))
    rows = np.stack(others)
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    if size == 0.0 or not sizes.all():
        return 0.0
    units = rows / sizes
    seen = units @ own / size
    if len(others) == 1:
        return float(seen[0])
    return float(np.sqrt(seen @ np.linalg.lstsq(units @ units.T, seen, rcond=None)[0]))


@dataclass(frozen=True, slots=True)
class Rival:
    """Another effect, and the cosine of both signatures in every channel; its phase is free.

    `declared`: the effect's file names it.
    """

    name: str
    cosines: tuple[float, float, float]
    declared: bool

    @property
    def likeness(self) -> float:
        """How alike they look to the load encoder alone, 0 to 1."""
        load, velocity, _ = self.cosines
        return (abs(load) + abs(velocity)) / 2.0


def rivals(name: str, every: Mapping[str, Signature], most: int = 5) -> tuple[Rival, ...]:
    """Those that the effect's file names, and the `most` likest others; the likest first."""
    own, declared = every[name], find_effect(name).confused_with
    found = [
        Rival(other.name, _cosines(own, other), other.name in declared)
        for other in every.values()
        if other.name != name
    ]
    found.sort(key=lambda rival: -rival.likeness)
    others = [rival for rival in found if not rival.declared][:most]
    return tuple(rival for rival in found if rival.declared or rival in others)


def _cosines(own: Signature, other: Signature) -> tuple[float, float, float]:
    phases = [other.channels] if other.shifted is None else [other.channels, other.shifted]
    load, velocity, current = (
        cosine(own_channel, *theirs)
        for own_channel, *theirs in zip(
            *(_zeroed(own.channels), *(_zeroed(channels) for channels in phases)), strict=True
        )
    )
    return load, velocity, current


def _zeroed(channels: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The load angle from its mean; the others as they are."""
    load, velocity, current = channels
    return load - load.mean(), velocity, current
