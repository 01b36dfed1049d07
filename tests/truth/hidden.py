"""Seals: a seed hides what is wrong with the truth until the verdict on it is written.

    draw(seed)                            a gap wider or narrower than nominal by 10..40 %
    draw(seed, "one")                     one effect of the catalogue, at a strength of its range
    draw(seed, "outside")                 one that the catalogue lacks
    draw(seed, "pair")                    two of the catalogue at once
    draw(seed, "none"), nothing(seed)     nothing but the nuisances: a diagnosis must find no cause
    draw(seed, "one", among=("cogging",)) out of these only
    hide(seed, {"cogging": 5e-3})         these, so strong
    wire_one, wire_pair, ...              the same as a rig's plant, "tests.truth.hidden:wire_one"
    record(sealed, experiment, nominal)   the experiment on that axis, as the bench would record it
    record(..., take=1, sized_for_rad_s=v)   once more: other noise, the same axis
    sealed.open()                         what it was

The recording is made without a wire. It carries the bench's values (`Recording`, `Experiment`)
and no rig: whoever hands it on adds the rig that the diagnosis may see, without `[simulated]`.
`tests.truth.rigs` has nominal rigs, the paper's and others drawn from a seed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.recording import Recording
from sim_rig.plant import Plant
from tests.truth.catalogue import (
    BY_NAME,
    IN_THE_CATALOGUE,
    OUTSIDE_THE_CATALOGUE,
    Hiding,
    Scale,
    same_as,
)
from tests.truth.effects import NONE, Effects
from tests.truth.nuisances import scattered
from tests.truth.plant import NominalValues, TruthPlant

Kind = Literal["gap", "one", "none", "outside", "pair"]

COUNTS_PER_REVOLUTION = 65536
"""Of both encoders, as they come over the wire."""

RATED_TORQUE_NM = 0.64
"""The drive reports torque in thousandths of this (CiA 402 object 0x6077)."""

LOAD_ENCODER_NOISE_COUNTS = 1.0
"""Standard deviation of the load encoder's white noise."""

SMALLEST_ERROR, LARGEST_ERROR = 0.10, 0.40
"""Of a gap that alone is hidden, as a fraction of the nominal one."""

PAPER_VELOCITY_RAD_S = math.radians(150.0)


@dataclass(frozen=True, slots=True)
class Drawn:
    """One effect as it was drawn: its size in the catalogue's units, its phases and choices."""

    name: str
    size: float
    fields: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class HiddenTruth:
    """What a seal hides."""

    kind: Kind
    drawn: tuple[Drawn, ...]
    noise_seed: int

    @property
    def causes(self) -> tuple[str, ...]:
        """The names that a verdict should give; empty where nothing is hidden."""
        return tuple(drawn.name for drawn in self.drawn)

    @property
    def accepted(self) -> tuple[frozenset[str], ...]:
        """For each cause, the names that nobody could tell from it, itself among them."""
        return tuple(same_as(name) for name in self.causes)

    @property
    def also(self) -> frozenset[str]:
        """Effects that stand beside the causes, because those need them; right, if named."""
        return frozenset(name for cause in self.causes for name in BY_NAME[cause].also)

    @property
    def gap_factor(self) -> float:
        """The true gap as a multiple of the nominal one."""
        return 1.0 + sum(drawn.size for drawn in self.drawn if drawn.name == "backlash_width")

    def backlash_gap_rad(self, nominal: NominalValues) -> float:
        """The true gap."""
        return self.gap_factor * nominal.backlash_gap_rad

    def strengths(self, nominal: NominalValues, velocity_rad_s: float) -> dict[str, float]:
        """Cause and strength in its SI unit, on this rig at this largest commanded velocity."""
        scale = Scale(nominal, velocity_rad_s)
        return {d.name: d.size * scale.of(BY_NAME[d.name].per) for d in self.drawn}

    def effects(self, nominal: NominalValues, velocity_rad_s: float) -> Effects:
        """Everything that is set in the plant."""
        scale = Scale(nominal, velocity_rad_s)
        fields: dict[str, float] = {}
        for drawn in self.drawn:
            fields |= BY_NAME[drawn.name].fields(drawn.size, scale, drawn.fields)
        return NONE._replace(**fields)


class Sealed:
    """A truth that can be played, and shows itself only by `open()`."""

    __slots__ = ("__truth",)

    def __init__(self, truth: HiddenTruth) -> None:
        self.__truth = truth

    def open(self) -> HiddenTruth:
        """What was hidden; for after the verdict."""
        return self.__truth

    def plant(
        self,
        nominal: NominalValues,
        velocity_rad_s: float = PAPER_VELOCITY_RAD_S,
        *,
        take: int = 0,
    ) -> TruthPlant:
        """The axis at rest, its effects sized for commands up to this velocity.

        Every take is the same axis with other noise. ValueError where a hidden gap is a multiple
        of a nominal one of zero: no factor could show.
        """
        per_gap = any(BY_NAME[name].per == "gap" for name in self.__truth.causes)
        if per_gap and nominal.backlash_gap_rad == 0.0:
            raise ValueError(
                "a hidden gap is a multiple of the nominal one, and backlash_gap_rad = 0.0: "
                "give the nominal rig a gap above zero"
            )
        truth = self.__truth
        return TruthPlant(
            nominal,
            truth.noise_seed + take,
            truth.effects(nominal, velocity_rad_s),
            scattered(truth.noise_seed),
        )


def draw(seed: int, kind: Kind = "gap", *, among: Sequence[str] | None = None) -> Sealed:
    """Hide something. `among` narrows the names that "one", "outside", and "pair" draw from.

    ValueError where `among` has too few names of the catalogue.
    """
    rng = np.random.default_rng(seed)
    if kind == "gap":
        error = rng.choice((-1.0, 1.0)) * rng.uniform(SMALLEST_ERROR, LARGEST_ERROR)
        drawn: tuple[Drawn, ...] = (Drawn("backlash_width", float(error), {}),)
    else:
        number = {"none": 0, "one": 1, "outside": 1, "pair": 2}[kind]
        table = OUTSIDE_THE_CATALOGUE if kind == "outside" else IN_THE_CATALOGUE
        drawn = _drawn(rng, [h for h in table if among is None or h.name in among], number)
    return Sealed(HiddenTruth(kind, drawn, int(rng.integers(1 << 32))))


def hide(seed: int, sizes: Mapping[str, float]) -> Sealed:
    """These effects at these sizes, in the catalogue's units: for limits of detection.

    The seed draws phases, choices, and nuisances. ValueError for a name that is not there.
    """
    unknown = sorted(set(sizes) - set(BY_NAME))
    if unknown:
        raise ValueError(f"no effect is called {unknown}: give names of tests.truth.catalogue")
    rng = np.random.default_rng(seed)
    drawn = tuple(replace(_sized(rng, BY_NAME[name]), size=size) for name, size in sizes.items())
    kind: Kind = "none" if not drawn else "one" if len(drawn) == 1 else "pair"
    return Sealed(HiddenTruth(kind, drawn, int(rng.integers(1 << 32))))


def nothing(seed: int) -> Sealed:
    """Nothing wrong but what no model has."""
    return draw(seed, "none")


ON_THE_WIRE = tuple(name for name in BY_NAME if name != "clock_skew")
"""What can be hidden behind a bus: of clocks, only a recorder that knows the future runs late."""


def wire_one(nominal: NominalValues, seed: int) -> Plant:
    """`draw(seed, "one", among=ON_THE_WIRE)` as a rig's plant: "tests.truth.hidden:wire_one"."""
    return draw(seed, "one", among=ON_THE_WIRE).plant(nominal)


def wire_pair(nominal: NominalValues, seed: int) -> Plant:
    """`draw(seed, "pair", among=ON_THE_WIRE)` as a rig's plant."""
    return draw(seed, "pair", among=ON_THE_WIRE).plant(nominal)


def wire_outside(nominal: NominalValues, seed: int) -> Plant:
    """`draw(seed, "outside")` as a rig's plant."""
    return draw(seed, "outside").plant(nominal)


def wire_nothing(nominal: NominalValues, seed: int) -> Plant:
    """`draw(seed, "none")` as a rig's plant."""
    return draw(seed, "none").plant(nominal)


def _drawn(rng: np.random.Generator, table: list[Hiding], number: int) -> tuple[Drawn, ...]:
    """So many effects that nobody confuses, and that set nothing in common."""
    if len(table) < number:
        raise ValueError(
            f"{len(table)} effects to draw {number} from: give names of tests.truth.catalogue"
        )
    drawn: list[Drawn] = []
    while len(drawn) < number:
        if not table:
            raise ValueError(f"no second effect goes with {drawn[0].name}: give more names")
        hiding = table[int(rng.integers(len(table)))]
        drawn.append(_sized(rng, hiding))
        table = [other for other in table if _go_together(hiding, other)]
    return tuple(drawn)


def _go_together(one: Hiding, other: Hiding) -> bool:
    names = (same_as(one.name) | set(one.also), same_as(other.name) | set(other.also))
    return names[0].isdisjoint(names[1])


def _sized(rng: np.random.Generator, hiding: Hiding) -> Drawn:
    size = math.exp(rng.uniform(math.log(hiding.low), math.log(hiding.high)))
    if hiding.signed:
        size *= float(rng.choice((-1.0, 1.0)))
    fields = {name: float(rng.uniform(0.0, math.tau)) for name in hiding.phases}
    fields |= {name: float(rng.choice(values)) for name, values in hiding.choices.items()}
    return Drawn(hiding.name, size, fields)


def record(
    sealed: Sealed,
    experiment: Experiment,
    nominal: NominalValues,
    *,
    take: int = 0,
    sized_for_rad_s: float | None = None,
) -> Recording:
    """Play the experiment on the sealed axis: outputs at a slot's start, then its command.

    Another `take` has other noise. What is sized by the command is sized by this experiment's
    largest velocity, or by `sized_for_rad_s`: the same for every recording of one axis.

    Channels: slot, phase, chip, asked_ns, velocity_command_rad_s, motor_position_rad (counts of
    the drive's 65536 per turn), motor_torque_nm (thousandths of rated torque), load_angle_counts
    and load_angle_rad (65536 per turn, white noise of one count), each of shape (slots,).
    """
    schedule = experiment.schedule()
    sized_for_rad_s = schedule.peak_velocity_rad_s if sized_for_rad_s is None else sized_for_rad_s
    plant = sealed.plant(nominal, sized_for_rad_s, take=take)
    played = plant.play(schedule.velocity_rad_s, schedule.period_s)
    slot = np.arange(schedule.slots, dtype=np.int64)
    rng = np.random.default_rng((sealed.open().noise_seed + take, 5))
    noise_counts = LOAD_ENCODER_NOISE_COUNTS * rng.standard_normal(schedule.slots)
    load_counts = _counts(played.load_angle_rad, noise_counts)
    motor_counts = _counts(played.motor_position_rad, np.zeros(schedule.slots))
    torque_nm = nominal.torque_constant_nm_per_a * played.motor_current_a
    quantum_nm = RATED_TORQUE_NM / 1000.0
    return Recording(
        channels={
            "slot": slot,
            "phase": schedule.phase.copy(),
            "chip": schedule.chip.copy(),
            "asked_ns": np.rint(slot * (schedule.period_s * 1e9)).astype(np.int64),
            "velocity_command_rad_s": schedule.velocity_rad_s.copy(),
            "motor_position_rad": _angle_rad(motor_counts),
            "motor_torque_nm": np.rint(torque_nm / quantum_nm) * quantum_nm,
            "load_angle_counts": load_counts,
            "load_angle_rad": _angle_rad(load_counts),
        },
        period_s=schedule.period_s,
        experiment=experiment,
        rig=None,
        provenance={"source": "tests.truth"},
    )


def _counts(angle_rad: NDArray[np.float64], noise_counts: NDArray[np.float64]) -> NDArray[np.int64]:
    turns = angle_rad / math.tau
    return np.floor(turns * COUNTS_PER_REVOLUTION + noise_counts).astype(np.int64)


def _angle_rad(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    return counts.astype(np.float64) * (math.tau / COUNTS_PER_REVOLUTION)
