"""One motion equation: base columns, accepted terms, and their coefficients.

    d omega/dt = g tau + h omega + c + sum_k (torque of term k) x coefficients

    tau    the effort: a torque, a current (times K_T/J) or a voltage (times K_T/(R J))
    h      with a voltage only: back-EMF over the resistance, and whatever damps in proportion
    c      what is constant: an offset of the sensor, a load

With a voltage the electric torque is tau + (h/g) omega, in volts: what the resistance leaves.

Where the effort goes into what resists a motor and little of it into speed (a slow ramp, a speed
that is held), the same is solved for the effort, with the acceleration as a column:

    tau = (1/g) d omega/dt - (h/g) omega - c/g - sum_k (torque of term k) x size k
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from servo_bench.diagnosis.elsewhere.terms import Electric, Term, columns
from servo_bench.diagnosis.elsewhere.weak import WeakRows
from servo_bench.diagnosis.fitting.foreign_channels import Array, Stretch

Mask = np.ndarray[tuple[int], np.dtype[np.bool_]]
BINS = 24
LEAST_SCATTER = 0.3
"""Least scatter of a velocity's rows over that of all."""
STICKS = 0.01
"""A motor slower than this share of its rms velocity may stick."""


@dataclass(frozen=True)
class Design:
    """The columns of an equation in one set of rows; terms own the last ones, in order.

    `target`, shape (rows,), is what they explain: the acceleration, or where `inverse` the effort.
    """

    rows: WeakRows
    voltage: bool
    terms: tuple[Term, ...]
    matrix: Array
    target: Array
    inverse: bool = False

    @property
    def base(self) -> int:
        """How many columns belong to no term."""
        return 3 if self.voltage else 2

    def owned(self, number: int) -> slice:
        """The columns of a term."""
        widths = [1 if t.phase is None else 2 for t in self.terms]
        first = self.base + sum(widths[:number])
        return slice(first, first + widths[number])

    def without(self, number: int) -> "Design":
        """The same but for one term."""
        gone = self.owned(number)
        kept = [k for k in range(self.matrix.shape[1]) if not gone.start <= k < gone.stop]
        terms = (*self.terms[:number], *self.terms[number + 1 :])
        return replace(self, terms=terms, matrix=self.matrix[:, kept])

    def plus(self, term: Term, added: Array) -> "Design":
        """The same and one term more."""
        matrix = np.concatenate([self.matrix, added], axis=1)
        return replace(self, terms=(*self.terms, term), matrix=matrix)

    def in_effort(self, coefficients: Array) -> Array:
        """All coefficients as torques in units of the effort; shape (columns,). The first is one
        over the acceleration that a unit of it makes."""
        if self.inverse:
            return np.concatenate([coefficients[:1], -coefficients[1:]])
        return np.asarray(np.concatenate([[1.0], coefficients[1:]]) / coefficients[0])

    def gradient(self, along: Array, ratio: Array, coefficients: Array) -> Array:
        """Of a number q of a term by the first coefficient and its own, from dq/d ratio `along`,
        where `ratio` are the own ones in units of the effort."""
        if self.inverse:
            return np.concatenate([[0.0], -along])
        return np.asarray(np.concatenate([[-float(along @ ratio)], along]) / coefficients[0])


def base_design(rows: WeakRows, *, voltage: bool, inverse: bool = False) -> Design:
    """Effort, constant, and with a voltage the velocity; or the acceleration for the effort."""
    effort = rows.column(lambda s: s.effort)
    target, first = (effort, rows.left) if inverse else (rows.left, effort)
    found = [first, np.ones(rows.left.size)]
    if voltage:
        found.append(rows.column(lambda s: s.velocity_rad_s))
    return Design(rows, voltage, (), np.stack(found, axis=1), target, inverse)


def design(
    rows: WeakRows,
    terms: Sequence[Term],
    electric: Electric,
    *,
    voltage: bool,
    inverse: bool = False,
) -> Design:
    """The base and these terms."""
    found = base_design(rows, voltage=voltage, inverse=inverse)
    for term in terms:
        found = found.plus(term, columns(term, rows, electric))
    return found


def electric_of(found: Design, coefficients: Array) -> Electric:
    """The electric torque, in units of the effort, by the present equation."""
    if not found.voltage:
        return lambda s: s.effort
    back = min(float(found.in_effort(coefficients)[2]), 0.0)

    def electric(stretch: Stretch) -> Array:
        return np.asarray(stretch.effort + back * stretch.velocity_rad_s)

    return electric


def solve(matrix: Array, left: Array, weight: Array) -> Array:
    """Weighted least squares; `weight` is one over the standard deviation."""
    heavy = matrix * weight[:, None]
    scale = np.linalg.norm(heavy, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    gram = heavy.T @ heavy / np.outer(scale, scale)
    found = np.linalg.lstsq(gram, heavy.T @ (left * weight) / scale, rcond=1e-10)[0]
    return np.asarray(found / scale)


def covariance(found: Design, coefficients: Array, weight: Array) -> Array:
    """Block sandwich of the coefficients, shape (columns, columns)."""
    heavy = found.matrix * weight[:, None]
    errors = (found.target - found.matrix @ coefficients) * weight
    sums = np.stack([np.bincount(found.rows.block, c * errors) for c in heavy.T], axis=1)
    inverse = np.linalg.pinv(heavy.T @ heavy, hermitian=True)
    return np.asarray(inverse @ (sums.T @ sums) @ inverse)


def size_of(found: Design, number: int, coefficients: Array, spread: Array) -> tuple[float, float]:
    """A term's size in units of the effort, with a phase its amplitude, and its standard error by
    the delta method from the coefficients' covariance."""
    own = found.owned(number)
    ratio = found.in_effort(coefficients)[own]
    size = float(np.hypot.reduce(ratio)) if found.terms[number].phase else float(ratio[0])
    toward = ratio / size if size else np.ones_like(ratio)
    return size, error_of(found, number, coefficients, spread, toward)


def error_of(found: Design, number: int, coefficients: Array, spread: Array, along: Array) -> float:
    """Standard error of a number of a term, of which `along` is the derivative by its own
    coefficients in units of the effort."""
    own = found.owned(number)
    at = [0, *range(own.start, own.stop)]
    ratio = found.in_effort(coefficients)[own]
    slope = found.gradient(along, ratio, coefficients)
    return float(np.sqrt(max(float(slope @ spread[np.ix_(at, at)] @ slope), 0.0)))


def offset_of(found: Design, coefficients: Array, spread: Array) -> tuple[float, float]:
    """What is constant beside the effort, in its unit, and its standard error."""
    size = found.in_effort(coefficients)[1:2]
    slope = found.gradient(np.ones(1), size, coefficients)
    return float(size[0]), float(np.sqrt(max(float(slope @ spread[:2, :2] @ slope), 0.0)))


def usual_torques(rows: WeakRows, *, inverse: bool = False) -> Array:
    """What effort, speed, friction and a weight may make, whatever of it is there."""
    return np.stack(
        [
            *base_design(rows, voltage=True, inverse=inverse).matrix.T,
            rows.column(lambda s: np.sign(s.velocity_rad_s)),
            rows.column(lambda s: np.nan_to_num(np.sin(s.angle_rad))),
            rows.column(lambda s: np.nan_to_num(np.cos(s.angle_rad))),
        ],
        axis=1,
    )


def weights(rows: WeakRows, errors: Array) -> Array:
    """One over the scatter of the errors at each row's speed, zero where it sticks; (rows,).

    What holds a motor that sticks takes any value: such rows tell nothing of the equation.
    """
    speed = np.abs(rows.velocity_rad_s)
    parts = np.array_split(np.argsort(speed), BINS)
    parts = [part for part in parts if part.size]
    scatter = np.array([1.4826 * np.median(np.abs(errors[part])) for part in parts])
    middle = np.array([np.median(speed[part]) for part in parts])
    found = np.interp(speed, middle, scatter)
    least = LEAST_SCATTER * float(np.sqrt(np.mean(scatter**2)))
    turning = speed > STICKS * float(np.sqrt(np.mean(speed**2)))
    return np.where(turning, 1.0 / np.maximum(found, max(least, 1e-12)), 0.0)
