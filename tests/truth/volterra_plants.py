"""Plants for kernels to be measured on: the paper's, and more that no estimator has as its model.

    x = G(s) u,  u held over dt = 0.5 s           y sampled just before each chip acts, from rest

    G(s) = (2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2)      zeta = 0.4, wn = 1
    G(s) = wn^2 / (s^2 + 2 zeta wn s + wn^2)                      "no zero"

    paper, paper_no_zero   y = play of x, width W = 0.8
    soft_play              y = mean of 15 plays of half width W/2 + 0.12 sigma, at the middles of
                           15 equal shares of the normal distribution
    output_lag             y = play of x behind 1 / (0.5 s + 1)
    two_mass               J w' = T - 0.5 w - 0.05 tanh(w / 0.01), y' = w, J = 0.1, where T is
                           the contact's torque at p = |x - y| - 0.4 > 0, k p + d p' with k = 40
                           and d = 1.5, never pulling
    drawn_two_mass(seed)   the same law, every number drawn

G is exact (matrix exponential) on substeps; the rest follows it there. No unit: the plants are the
paper's normalised ones.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.truth.compiling import kernel

Array = NDArray[np.float64]
Plant = Callable[[NDArray[np.floating]], Array]
"""Inputs, shape (n,), to outputs, shape (n,): sample t is taken before input t acts."""

PERIOD_S = 0.5
PLAY_WIDTH = 0.8
PLAYS_IN_SOFT_PLAY = 15
SOFTNESS = 0.12
PLAY_SUBSTEPS = 40
CONTACT_SUBSTEPS = 400
SERVO_PERIOD_S = 0.008
SERVO_FREQUENCY_RAD_S = 62.5


@dataclass(frozen=True, slots=True)
class Loop:
    """G: a second-order loop, with the zero of a PI controller or without."""

    damping_ratio: float = 0.4
    natural_frequency_rad_s: float = 1.0
    zero: bool = True

    def stepped(self, step_s: float) -> Array:
        """Over one step, rows: z1, z2, then x and dx/dt; columns: z1, z2, u."""
        wn, damping = self.natural_frequency_rad_s, 2 * self.damping_ratio
        system = np.array([[0.0, 1.0, 0.0], [-(wn**2), -damping * wn, 1.0], [0.0, 0.0, 0.0]])
        whole = _exponential(system * step_s)
        row = np.array([wn**2, damping * wn if self.zero else 0.0, 0.0])
        return np.vstack([whole[:2], row, row @ system])


@dataclass(frozen=True, slots=True)
class Contact:
    """What drives the second mass, and what brakes it."""

    inertia: float = 0.1
    half_gap: float = 0.4
    stiffness: float = 40.0
    damping: float = 1.5
    viscous: float = 0.5
    coulomb: float = 0.05
    coulomb_velocity: float = 0.01


def paper(inputs: NDArray[np.floating]) -> Array:
    """The paper's plant, equation 14."""
    return _behind_plays(inputs, Loop(), _one_play(), 0.0)


def paper_no_zero(inputs: NDArray[np.floating]) -> Array:
    """The paper's plant without the zero of its controller."""
    return _behind_plays(inputs, Loop(zero=False), _one_play(), 0.0)


def soft_play(inputs: NDArray[np.floating]) -> Array:
    """A gap whose flanks are met one after the other."""
    places = (np.arange(PLAYS_IN_SOFT_PLAY) + 0.5) / PLAYS_IN_SOFT_PLAY
    halves = PLAY_WIDTH / 2 + SOFTNESS * np.array([_normal_quantile(p) for p in places])
    return _behind_plays(inputs, Loop(), halves, 0.0)


def output_lag(inputs: NDArray[np.floating]) -> Array:
    """A play that is seen through a filter of 0.5 s."""
    return _behind_plays(inputs, Loop(), _one_play(), 0.5)


def two_mass(inputs: NDArray[np.floating]) -> Array:
    """A mass that is pushed through a gap with a springy contact, and brakes by friction."""
    return _pushed(inputs, Loop(), Contact())


def drawn_two_mass(seed: int) -> Plant:
    """A two-mass plant with parameters of its own: each within a factor of two of `two_mass`."""
    rng = np.random.default_rng(seed)

    def near(value: float, factor: float = 2.0) -> float:
        return value * float(np.exp(rng.uniform(-1.0, 1.0) * math.log(factor)))

    loop = Loop(near(0.4, 1.5), near(1.0, 1.2))
    nominal = Contact()
    contact = Contact(
        inertia=near(nominal.inertia),
        half_gap=near(nominal.half_gap, 1.5),
        stiffness=near(nominal.stiffness),
        damping=near(nominal.damping),
        viscous=near(nominal.viscous),
        coulomb=near(nominal.coulomb),
        coulomb_velocity=nominal.coulomb_velocity,
    )
    return lambda inputs: _pushed(inputs, loop, contact)


def servo_angle(inputs: NDArray[np.floating], gap: float, counts_per_turn: int) -> Array:
    """The paper's experiment: velocity through G (wn = 62.5 rad/s, 8 ms), summed, behind a play.

    Velocities in degrees per second, shape (n,), to the encoder's angle before each input and
    after the last, shape (n + 1,), in degrees, rounded down to whole counts; `gap` in degrees.
    """
    step_s = SERVO_PERIOD_S / PLAY_SUBSTEPS
    model = Loop(natural_frequency_rad_s=SERVO_FREQUENCY_RAD_S).stepped(step_s)
    angle = _integrated_play(np.ascontiguousarray(inputs, np.float64), model, gap / 2, step_s)
    count = 360.0 / counts_per_turn
    return np.asarray(np.floor(angle / count) * count)


PLANTS: dict[str, Plant] = {
    "paper": paper,
    "paper_no_zero": paper_no_zero,
    "soft_play": soft_play,
    "output_lag": output_lag,
    "two_mass": two_mass,
}


def _one_play() -> Array:
    return np.array([PLAY_WIDTH / 2])


def _behind_plays(inputs: NDArray[np.floating], loop: Loop, halves: Array, lag_s: float) -> Array:
    step_s = PERIOD_S / PLAY_SUBSTEPS
    forget = math.exp(-step_s / lag_s) if lag_s else 0.0
    held = np.ascontiguousarray(inputs, np.float64)
    return np.asarray(_plays(held, loop.stepped(step_s), halves, forget))


def _pushed(inputs: NDArray[np.floating], loop: Loop, contact: Contact) -> Array:
    step_s = PERIOD_S / CONTACT_SUBSTEPS
    numbers = np.array(
        [
            contact.inertia,
            contact.half_gap,
            contact.stiffness,
            contact.damping,
            contact.viscous,
            contact.coulomb,
            contact.coulomb_velocity,
        ]
    )
    held = np.ascontiguousarray(inputs, np.float64)
    return np.asarray(_second_mass(held, loop.stepped(step_s), numbers, step_s))


@kernel
def _plays(inputs: Array, model: Array, halves: Array, forget: float) -> Array:
    outputs = np.empty(inputs.size)
    plays = np.zeros(halves.size)
    first, second, seen = 0.0, 0.0, 0.0
    for t in range(inputs.size):
        outputs[t] = seen
        for _ in range(PLAY_SUBSTEPS):
            moved = model[0, 0] * first + model[0, 1] * second + model[0, 2] * inputs[t]
            second = model[1, 0] * first + model[1, 1] * second + model[1, 2] * inputs[t]
            first = moved
            x = model[2, 0] * first + model[2, 1] * second
            mean = 0.0
            for i in range(halves.size):
                plays[i] = min(max(plays[i], x - halves[i]), x + halves[i])
                mean += plays[i] / halves.size
            seen = mean + forget * (seen - mean)
    return outputs


@kernel
def _second_mass(inputs: Array, model: Array, contact: Array, step_s: float) -> Array:
    """Velocity first, then angle (semi-implicit Euler), on steps of 1/400 of a period."""
    inertia, half_gap, stiffness, damping, viscous, coulomb, coulomb_velocity = contact
    outputs = np.empty(inputs.size)
    first, second, angle, velocity = 0.0, 0.0, 0.0, 0.0
    for t in range(inputs.size):
        outputs[t] = angle
        for _ in range(CONTACT_SUBSTEPS):
            moved = model[0, 0] * first + model[0, 1] * second + model[0, 2] * inputs[t]
            second = model[1, 0] * first + model[1, 1] * second + model[1, 2] * inputs[t]
            first = moved
            apart = model[2, 0] * first + model[2, 1] * second - angle
            side = 1.0 if apart > 0.0 else -1.0
            depth = side * apart - half_gap
            torque = 0.0
            if depth > 0.0:
                driven = model[3, 0] * first + model[3, 1] * second + model[3, 2] * inputs[t]
                closing = side * (driven - velocity)
                torque = side * max(0.0, stiffness * depth + damping * closing)
            braking = viscous * velocity + coulomb * math.tanh(velocity / coulomb_velocity)
            velocity += step_s * (torque - braking) / inertia
            angle += step_s * velocity
    return outputs


@kernel
def _integrated_play(inputs: Array, model: Array, half_gap: float, step_s: float) -> Array:
    """The angle is the trapezoidal sum of the velocity."""
    outputs = np.zeros(inputs.size + 1)
    first, second, angle, play, velocity = 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(inputs.size):
        for _ in range(PLAY_SUBSTEPS):
            moved = model[0, 0] * first + model[0, 1] * second + model[0, 2] * inputs[t]
            second = model[1, 0] * first + model[1, 1] * second + model[1, 2] * inputs[t]
            first = moved
            faster = model[2, 0] * first + model[2, 1] * second
            angle += step_s * (velocity + faster) / 2
            velocity = faster
            play = min(max(play, angle - half_gap), angle + half_gap)
        outputs[t + 1] = play
    return outputs


def _exponential(matrix: Array) -> Array:
    """The matrix exponential: Taylor's series of the matrix over 2^8, squared eight times."""
    term = whole = np.eye(len(matrix))
    for power in range(1, 16):
        term = term @ matrix / (256.0 * power)
        whole = whole + term
    for _ in range(8):
        whole = whole @ whole
    return whole


def _normal_quantile(share: float) -> float:
    low, high = -10.0, 10.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (
            (middle, high) if math.erf(middle / math.sqrt(2)) < 2 * share - 1 else (low, middle)
        )
    return (low + high) / 2
