"""Limits and likeness, computed from the truth plant alone. Run once, before the campaigns:

    python -m tests.trials.measuring        writes limits.json and likeness.json beside this file

D(s)   change of the signals (angles of load and motor, torque; each over its floor) when a cause of
       size s is put into the axis with mean nuisances, without noise and without counts, whose
       rounding alone makes a floor out of any change; companions are there before and after
N      the same for each nuisance, one standard deviation of its scatter
e      floor: a null recording, with a rig's own nuisances and all noise, less the mean axis
All three are projected: X - N (N'N + I)^-1 N'X, the nuisances fitted with their priors.

Limit: the size at which |D|^4 / sum_b (D_b . e_b)^2 = lambda, over blocks b of 0.25 s. For a cause
that is linear in its size this is the block sandwich, s* = sqrt(lambda) sqrt(sum g_b^2)/(S'S); for
one that is not (a limit, a dead zone) it is the Kullback distance at its own size. lambda is 20.9
for one number and 23.8 where a phase is sought besides (power 0.9 at a false alarm of 1e-3).

Likeness: |cos| between the D of two causes in the middle of their ranges; the largest canonical
correlation where a phase is free. Here in velocities instead of angles: in angles whatever makes
the axis drift looks the same, since a floor that is white by assumption does not drown a drift.

Where the definition had to be bent:

- A nuisance of a cause's own kind (K_T and J for either, the
friction for friction) is not projected away, for it would take the cause with it. Its scatter is in
e.
- The secants go through impacts: a heavy load that rattles freely in its gap (gravity, a load
  torque, and what they need) ends elsewhere after any change at all. Where a thousandth of the
  range's low end already shows, no limit is written.
- The truth's drive looks for telegrams once in its period of 125 us: a delay shows when it reaches
  the next one, and then as a whole period.
"""

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Schedule
from tests.trials.drawing import Question
from tests.trials.limits import LIMITS
from tests.trials.names import LIKENESS, Channels
from tests.trials.seeds import DEVELOPMENT_BELOW
from tests.truth import hidden
from tests.truth.catalogue import IN_THE_CATALOGUE, Hiding, Scale
from tests.truth.effects import NONE, Effects
from tests.truth.hidden import HiddenTruth
from tests.truth.nuisances import SCATTER, Nuisances
from tests.truth.plant import NominalValues, TruthPlant

Array = NDArray[np.float64]

SEEDS: Final = (1901, 1902, 1903)
"""Rigs, excitations, phases, and floors; the median over them is what is written."""

BLOCK_S = 0.25
LAMBDA_ONE, LAMBDA_PHASE = 20.9, 23.8
BISECTIONS = 8
SMALLEST, LARGEST = 1e-3, 4.0
"""Where a limit is sought: from so much of the range's low end to so much of its high end."""

WRITTEN = 0.3
"""Cosines below are not worth a line."""

SIGNALS: Mapping[Channels, tuple[int, ...]] = {"all": (0, 1, 2), "load": (0,)}
MEAN = Nuisances(torque_noise_nm=0.0, motor_counts_per_revolution=float(1 << 44), loop_phase=2)

OWN_KIND: Mapping[str, frozenset[str]] = {
    "coulomb_friction": frozenset({"motor_friction_nm"}),
    "viscous_friction": frozenset({"motor_viscous_nm_s_per_rad"}),
    "torque_constant_error": frozenset({"torque_constant_error", "inertia_error"}),
    "inertia_error": frozenset({"torque_constant_error", "inertia_error"}),
    "current_lag": frozenset({"current_lag_s"}),
    "transport_delay": frozenset({"loop_phase"}),
    "contact_stiffness": frozenset({"contact_stiffness_nm_per_rad15"}),
    "contact_damping": frozenset({"contact_damping_s_per_rad"}),
    "load_friction": frozenset({"load_friction_nm"}),
}


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """One rig and one schedule, and what the mean axis does there; signals of shape (3, rows)."""

    nominal: NominalValues
    schedule: Schedule
    velocity_rad_s: float
    seed: int
    plain: Array
    floor: Array
    scale: Array

    def change(self, effects: Effects, base: Effects = NONE, nuisances: Nuisances = MEAN) -> Array:
        """Whitened change of the signals, shape (3, rows)."""
        plain = self.plain if base == NONE else self.signals(base, MEAN)
        with np.errstate(invalid="ignore", over="ignore"):
            changed = self.signals(effects, nuisances) - plain
        return np.asarray(changed / self.scale)

    def signals(self, effects: Effects, nuisances: Nuisances) -> Array:
        """Load angle, motor angle, torque without a sensor's noise, shape (3, rows)."""
        plant = TruthPlant(self.nominal, self.seed, effects, nuisances)
        played = plant.play(self.schedule.velocity_rad_s, self.schedule.period_s)
        torque_nm = self.nominal.torque_constant_nm_per_a * played.motor_current_a
        return np.stack([played.load_angle_rad, played.motor_position_rad, torque_nm])


def bench(seed: int) -> Bench:
    """The rig, the excitation, and the floor of a seed; ValueError for a judging seed."""
    if seed >= DEVELOPMENT_BELOW:
        raise ValueError(f"seed {seed} is for judging: measure with one below {DEVELOPMENT_BELOW}")
    return bench_of(Question(seed=seed, kind="none"))


def bench_of(question: Question) -> Bench:
    """The rig, the excitation, and the floor of a trial; a judging one's after its verdict."""
    seed, experiment = question.seed, question.plan.seen
    schedule = experiment.schedule()
    recording = hidden.record(hidden.nothing(seed), experiment, question.nominal)
    channels = ("load_angle_rad", "motor_position_rad", "motor_torque_nm")
    measured = np.stack([recording[channel] for channel in channels])
    blank = Bench(
        question.nominal,
        schedule,
        question.plan.velocity_rad_s,
        seed,
        *(np.zeros_like(measured), np.zeros_like(measured), np.ones((3, 1))),
    )
    plain = blank.signals(NONE, MEAN)
    floor = measured - plain
    scale = np.sqrt((floor**2).mean(axis=1, keepdims=True))
    return replace(blank, plain=plain, floor=np.asarray(floor / scale), scale=scale)


def nuisance_changes(where: Bench) -> dict[str, Array]:
    """For each nuisance that scatters: the change that one standard deviation of it makes."""
    deviation = SCATTER / math.sqrt(3.0)
    steps: dict[str, Mapping[str, Any]] = {
        name: {name: getattr(MEAN, name) * (1.0 + deviation)}
        for name in (
            *("current_lag_s", "motor_friction_nm", "motor_viscous_nm_s_per_rad", "detent_nm"),
            *("load_friction_nm", "contact_stiffness_nm_per_rad15", "contact_damping_s_per_rad"),
        )
    }
    off = 0.002 / math.sqrt(3.0)
    steps |= {name: {name: off} for name in ("torque_constant_error", "inertia_error")}
    steps |= {
        "bearing_cosine": {"bearing_phase_rad": 0.5 * math.pi},
        "bearing_sine": {"bearing_nm": 2.0 * MEAN.bearing_nm},
        "loop_phase": {"loop_phase": 0},
        "start_in_gap": {"start_in_gap": 0.8 / math.sqrt(3.0)},
    }
    return {
        name: where.change(NONE, nuisances=MEAN._replace(**step)) for name, step in steps.items()
    }


def projected(change: Array, nuisances: Sequence[Array]) -> Array:
    """What of a change the nuisances, with their priors, do not explain; shape as `change`."""
    columns = np.stack([nuisance.ravel() for nuisance in nuisances], axis=1)
    normal = columns.T @ columns + np.eye(columns.shape[1])
    found = np.linalg.solve(normal, columns.T @ change.ravel())
    return np.asarray(change - (columns @ found).reshape(change.shape))


def evidence(change: Array, floor: Array, rows_per_block: int) -> float:
    """|D|^4 / sum_b (D_b . e_b)^2: the Wald statistic with the block sandwich."""
    energy = float((change**2).sum())
    if energy == 0.0:
        return 0.0
    rows = change.shape[1] // rows_per_block * rows_per_block
    product = (change * floor)[:, :rows].sum(axis=0).reshape(-1, rows_per_block).sum(axis=1)
    return energy**2 / float((product**2).sum())


def limits_of(where: Bench, hiding: Hiding, around: Mapping[str, Array]) -> dict[Channels, float]:
    """The smallest detectable size by channels, in the catalogue's unit; NaN for none."""

    @cache
    def caused_by(size: float) -> Array:
        return _caused(where, hiding, size)

    return {channels: _limit(where, hiding, channels, around, caused_by) for channels in SIGNALS}


def margin(
    where: Bench,
    hiding: Hiding,
    channels: Channels,
    around: Mapping[str, Array],
    change: Array,
) -> float:
    """sqrt(evidence/lambda) of a change that a cause makes, shape (3, rows): above one it is found.

    Of a cause that is linear in its size, its size over its limit.
    """
    kept = list(SIGNALS[channels])
    own = OWN_KIND.get(hiding.name, frozenset())
    nuisances = [one[kept] for name, one in around.items() if name not in own]
    if not np.isfinite(change[kept]).all():
        return math.inf  # it has made the loop unstable
    rows_per_block = max(round(BLOCK_S / where.schedule.period_s), 1)
    floor, left = projected(where.floor[kept], nuisances), projected(change[kept], nuisances)
    wanted = LAMBDA_PHASE if hiding.phases else LAMBDA_ONE
    return math.sqrt(evidence(left, floor, rows_per_block) / wanted)


def _limit(
    where: Bench,
    hiding: Hiding,
    channels: Channels,
    around: Mapping[str, Array],
    caused_by: Callable[[float], Array],
) -> float:
    """By bisection; NaN where nothing in reach shows, or everything."""

    def shows(size: float) -> bool:
        return margin(where, hiding, channels, around, caused_by(size)) >= 1.0

    low, high = math.log(SMALLEST * hiding.low), math.log(LARGEST * hiding.high)
    if not shows(math.exp(high)) or shows(math.exp(low)):
        return math.nan
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if shows(math.exp(middle)) else (middle, high)
    return math.exp(high)


def _caused(where: Bench, hiding: Hiding, size: float, phase_rad: float = 0.0) -> Array:
    """The change that a cause of this size makes; `phase_rad` is added to each of its phases."""
    return change_of(where, hiding, hidden.hide(where.seed, {hiding.name: size}).open(), phase_rad)


def change_of(where: Bench, hiding: Hiding, truth: HiddenTruth, phase_rad: float = 0.0) -> Array:
    """The change that a truth of one cause makes; its companions are there before and after."""
    effects = truth.effects(where.nominal, where.velocity_rad_s)
    moved = {name: getattr(effects, name) + phase_rad for name in hiding.phases}
    scale = Scale(where.nominal, where.velocity_rad_s)
    beside = hiding.beside(getattr(effects, hiding.strength), scale)
    base = effects._replace(**{hiding.strength: 0.0}, **moved) if beside else NONE
    return where.change(effects._replace(**moved), base)


def middles(where: Bench) -> list[list[Array]]:
    """The changes that causes in the middle of their ranges make, one or two for each."""
    return [
        [
            _caused(where, hiding, math.sqrt(hiding.low * hiding.high), phase_rad)
            for phase_rad in ((0.0, 0.5 * math.pi) if hiding.phases else (0.0,))
        ]
        for hiding in IN_THE_CATALOGUE
    ]


def rates(where: Bench, change: Array) -> Array:
    """The same change with velocities for angles, each over its floor; shape (3, rows - 1)."""
    scale = np.sqrt((np.diff(where.floor[:2]) ** 2).mean(axis=1, keepdims=True))
    return np.concatenate([np.diff(change[:2]) / scale, change[2:, 1:]])


def cosines(
    changes: Sequence[Sequence[Array]], channels: Channels, around: Mapping[str, Array]
) -> Array:
    """Likeness of every two causes, shape (causes, causes), as `IN_THE_CATALOGUE` orders them."""
    kept = list(SIGNALS[channels])
    own = [OWN_KIND.get(hiding.name, frozenset[str]()) for hiding in IN_THE_CATALOGUE]

    @cache
    def basis(cause: int, without: frozenset[str]) -> Array:
        nuisances = [change[kept] for name, change in around.items() if name not in without]
        return _basis([change[kept] for change in changes[cause]], nuisances)

    found = np.eye(len(changes))
    for i, j in combinations(range(len(changes)), 2):
        one, other = (basis(k, own[i] | own[j]) for k in (i, j))
        found[i, j] = found[j, i] = np.linalg.svd(one.T @ other, compute_uv=False)[0]
    return found


def _basis(changes: Sequence[Array], nuisances: Sequence[Array]) -> Array:
    columns = [projected(change, nuisances).ravel() for change in changes]
    return np.asarray(np.linalg.qr(np.stack(columns, axis=1)).Q)


def main() -> int:
    """Measure and write both files; prints a line for each seed to standard error."""
    sizes: dict[Channels, list[list[float]]] = {"all": [], "load": []}
    alike: dict[Channels, list[Array]] = {"all": [], "load": []}
    for seed in SEEDS:
        where = bench(seed)
        around, changes = nuisance_changes(where), middles(where)
        turning = {name: rates(where, change) for name, change in around.items()}
        changed = [[rates(where, change) for change in each] for each in changes]
        limits_here = [limits_of(where, hiding, around) for hiding in IN_THE_CATALOGUE]
        for channels, found in sizes.items():
            found.append([each[channels] for each in limits_here])
            alike[channels].append(cosines(changed, channels, turning))
        sys.stderr.write(f"seed {seed} measured\n")
    facts = {"date": datetime.now(UTC).date().isoformat(), "seeds": list(SEEDS)}
    names = [hiding.name for hiding in IN_THE_CATALOGUE]
    limits = {
        channels: {n: _size(float(size)) for n, size in zip(names, _median(found), strict=True)}
        for channels, found in sizes.items()
    }
    likeness = {channels: _pairs(names, _median(found)) for channels, found in alike.items()}
    _write(LIMITS, {**facts, "block_s": BLOCK_S, "limits": limits})
    _write(LIKENESS, {**facts, "cosines": likeness})
    return 0


def _median(found: Sequence[Any]) -> Array:
    """Over seeds; NaN (never seen) counts as the largest."""
    values = np.where(np.isnan(np.array(found)), np.inf, np.array(found))
    return np.asarray(np.median(values, axis=0))


def _size(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def _pairs(names: Sequence[str], found: Array) -> list[tuple[str, str, float]]:
    pairs = combinations(range(len(names)), 2)
    kept = [(names[i], names[j], round(float(found[i, j]), 3)) for i, j in pairs]
    return sorted((p for p in kept if p[2] >= WRITTEN), key=lambda pair: -pair[2])


def _write(path: Path, numbers: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(numbers, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
