"""What can be played as one sequence: frozen values that say their velocity, slot by slot.

    m-sequence       +-A, period 2^n - 1
    random-binary    +-A, independent signs
    inverse-repeat   u, -u, u, ... of an M-sequence: period 2 (2^n - 1); even orders drop out of odd
    field            three levels (GF(3)) or five (GF(5)) up to +-A
    random-uniform   independent levels, uniform over +-A
    multi-amplitude  one M-sequence at several amplitudes in turn, each led in
    from-recording   the velocities themselves, slot by slot

Each may carry a bias, a constant velocity that is added: it moves the operating point, and shows
one-sided effects as even orders. `polynomial` is the characteristic polynomial in octal, highest
power first (fields: the coefficients).
"""

from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, NonNegativeInt, PositiveFloat, PositiveInt, Tag

from servo_bench.errors import ConfigError
from servo_bench.excitation.fields import field_sequence, first_primitive
from servo_bench.excitation.msequence import m_sequence
from servo_bench.files import Value

Array = NDArray[np.float64]

Chip = TypeVar("Chip", np.int8, np.float64)

MAX_CHIPS = 1 << 24
"""More than a day and a half at 8 ms, and what memory holds."""
Count = Annotated[int, Field(ge=1, le=MAX_CHIPS)]


class MSequence(Value):
    """A binary M-sequence of velocity, +-amplitude: u = 1 - 2 s (bit 0 -> +amplitude)."""

    kind: Literal["m-sequence"] = "m-sequence"
    """Which sequence it is."""
    polynomial: str
    """Characteristic polynomial in octal, highest power first; must be primitive."""
    amplitude_rad_s: PositiveFloat
    """The command's size, rad/s."""
    periods: PositiveInt = 1
    """How many whole periods are played, without `length`."""
    length: Count | None = None
    """How many chips are played: the period is cut or repeated; by default whole periods."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    def chips(self) -> NDArray[np.int8]:
        """The signs of one play, shape (n,), each +1 or -1. ConfigError if not primitive."""
        period = m_sequence(self.polynomial)
        if self.length is None:
            return _repeated(period, self.periods)
        return np.resize(period, self.length)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips().astype(np.float64)


class RandomBinary(Value):
    """Independent signs of velocity, +-amplitude, from a seed."""

    kind: Literal["random-binary"]
    """Which sequence it is."""
    seed: NonNegativeInt
    """Seed of the random numbers."""
    amplitude_rad_s: PositiveFloat
    """The command's size, rad/s."""
    length: Count
    """How many chips are played."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    def chips(self) -> NDArray[np.int8]:
        """The signs, shape (length,), each +1 or -1."""
        bits = np.random.default_rng(self.seed).integers(0, 2, self.length)
        return (1 - 2 * bits).astype(np.int8)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips().astype(np.float64)


class RandomUniform(Value):
    """Independent velocities, uniform over +-amplitude, from a seed: every level is visited."""

    kind: Literal["random-uniform"]
    """Which sequence it is."""
    seed: NonNegativeInt
    """Seed of the random numbers."""
    amplitude_rad_s: PositiveFloat
    """The largest size of the command, rad/s."""
    length: Count
    """How many chips are played."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    def chips(self) -> Array:
        """The levels within +-1, shape (length,)."""
        return np.random.default_rng(self.seed).uniform(-1.0, 1.0, self.length)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips()


class InverseRepeat(Value):
    """An M-sequence with every second chip reversed: antisymmetric, u(t + N) = -u(t), N odd."""

    kind: Literal["inverse-repeat"]
    """Which sequence it is."""
    polynomial: str
    """Characteristic polynomial in octal, highest power first; must be primitive."""
    amplitude_rad_s: PositiveFloat
    """The command's size, rad/s."""
    periods: PositiveInt = 1
    """How many whole periods of 2 N chips are played."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    def chips(self) -> NDArray[np.int8]:
        """The signs, shape (2 N periods,), each +1 or -1. ConfigError if not primitive."""
        return _repeated(inverse_repeat(self.polynomial), self.periods)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips().astype(np.float64)


class FieldSequence(Value):
    """Three levels (field 3) or five (field 5), the largest +-amplitude."""

    kind: Literal["field"]
    """Which sequence it is."""
    field: Literal[3, 5]
    """The number of levels."""
    degree: PositiveInt | None = None
    """Degree n: the first primitive polynomial of it is taken, without `polynomial`."""
    polynomial: str = ""
    """Coefficients of the characteristic polynomial, highest power first; must be primitive."""
    amplitude_rad_s: PositiveFloat
    """The largest size of the command, rad/s."""
    periods: PositiveInt = 1
    """How many whole periods are played."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    def chips(self) -> Array:
        """The levels within +-1, shape (n,). ConfigError where no primitive polynomial is named."""
        polynomial = self.polynomial or first_primitive(self.field, self.degree or 0)
        return _repeated(field_sequence(self.field, polynomial), self.periods)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips().astype(np.float64)


class MultiAmplitude(Value):
    """One M-sequence at several amplitudes: at each the tail of a period, then whole periods.

    With k amplitudes k odd (and k even) orders can be told apart (Vandermonde in A).
    """

    kind: Literal["multi-amplitude"]
    """Which sequence it is."""
    polynomial: str
    """Characteristic polynomial in octal, highest power first; must be primitive."""
    amplitudes_rad_s: Annotated[tuple[PositiveFloat, ...], Field(min_length=2)]
    """The command's sizes in the order of play, rad/s."""
    periods: PositiveInt = 1
    """How many whole periods are played at each amplitude."""
    settling: Count = 256
    """How many chips lead in to each amplitude; no kernel is told from them."""
    bias_rad_s: float = 0.0
    """Constant velocity that is added, rad/s."""

    @property
    def amplitude_rad_s(self) -> float:
        """The largest."""
        return max(self.amplitudes_rad_s)

    def chips(self) -> Array:
        """Levels as shares of the largest amplitude, shape (n,). ConfigError if not primitive."""
        period = m_sequence(self.polynomial)
        whole = np.concatenate(
            [np.resize(period[::-1], self.settling)[::-1], _repeated(period, self.periods)]
        )
        return np.concatenate([a / self.amplitude_rad_s * whole for a in self.amplitudes_rad_s])

    def period_starts(self) -> tuple[int, ...]:
        """Where the first whole period of each amplitude begins in `chips`."""
        block = self.settling + m_sequence(self.polynomial).size * self.periods
        return tuple(i * block + self.settling for i in range(len(self.amplitudes_rad_s)))

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return self.bias_rad_s + self.amplitude_rad_s * self.chips().astype(np.float64)


class FromRecording(Value):
    """Velocities slot by slot, as somebody recorded them; no kernel can be told from them."""

    kind: Literal["from-recording"] = "from-recording"
    """Which sequence it is."""
    commands_rad_s: Annotated[tuple[float, ...], Field(min_length=1, max_length=MAX_CHIPS)]
    """The command in each slot, rad/s."""

    @property
    def polynomial(self) -> str:
        """None: empty."""
        return ""

    @property
    def amplitude_rad_s(self) -> float:
        """The largest speed."""
        return max(abs(command) for command in self.commands_rad_s)

    def velocity_rad_s(self) -> Array:
        """What is commanded, shape (n,)."""
        return np.array(self.commands_rad_s, np.float64)


def _repeated(period: NDArray[Chip], times: int) -> NDArray[Chip]:
    if period.size * times > MAX_CHIPS:
        raise ConfigError(
            f"periods = {times} of {period.size} chips: a sequence has at most {MAX_CHIPS} chips. "
            "Play fewer periods."
        )
    return np.tile(period, times)


def inverse_repeat(polynomial: str) -> NDArray[np.int8]:
    """(-1)^t u(t) over its period 2 N, shape (2 N,). ConfigError if not primitive."""
    twice = np.tile(m_sequence(polynomial), 2)
    twice[1::2] *= -1
    return twice


def _kind(value: object) -> str:
    """The member of a union that a table or a value means; a bare table is an M-sequence."""
    if isinstance(value, dict):
        return str(value.get("kind", "m-sequence"))
    return str(getattr(value, "kind", "m-sequence"))


Sequence = Annotated[
    Annotated[MSequence, Tag("m-sequence")]
    | Annotated[RandomBinary, Tag("random-binary")]
    | Annotated[RandomUniform, Tag("random-uniform")]
    | Annotated[InverseRepeat, Tag("inverse-repeat")]
    | Annotated[FieldSequence, Tag("field")]
    | Annotated[MultiAmplitude, Tag("multi-amplitude")]
    | Annotated[FromRecording, Tag("from-recording")],
    Discriminator(_kind),
]
"""Anything that can be played."""

Periodic = Annotated[
    Annotated[MSequence, Tag("m-sequence")]
    | Annotated[InverseRepeat, Tag("inverse-repeat")]
    | Annotated[FieldSequence, Tag("field")]
    | Annotated[MultiAmplitude, Tag("multi-amplitude")]
    | Annotated[FromRecording, Tag("from-recording")],
    Discriminator(_kind),
]
"""What a rig can be identified with: sequences that repeat and have a polynomial. Commands from a
recording stand here too, to be played again; they identify nothing."""
