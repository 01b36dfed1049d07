"""What the counter of the software rig must be told; all of it values."""

from dataclasses import dataclass

from sim_rig.counter.framings import FRAMINGS
from sim_rig.errors import RigSettingsError


@dataclass(frozen=True, slots=True)
class CounterSettings:
    """A counter with `counts_per_revolution` on a line whose characters have `character_bits`.

    It counts modulo `modulus`, and begins at `preset`. Raises RigSettingsError where a value makes
    no sense.
    """

    framing: str
    counts_per_revolution: int
    baud_rate: int = 115200
    character_bits: int = 10
    turnaround_s: float = 0.0002
    modulus: int = 1 << 32
    preset: int = 0

    def __post_init__(self) -> None:
        if self.framing not in FRAMINGS:
            raise RigSettingsError(
                f"the software rig's counter speaks {', '.join(FRAMINGS)}, not {self.framing!r}: "
                "take encoder.profile = one of these for a run without the hardware."
            )
        if self.baud_rate < 300 or not 9 <= self.character_bits <= 12:
            raise RigSettingsError(
                f"baud_rate = {self.baud_rate}, character_bits = {self.character_bits}: a line has "
                "300 Bd or more and 9 to 12 bits to a character."
            )
        if not 1 <= self.counts_per_revolution <= 2**31 or not 2 <= self.modulus <= 2**32:
            raise RigSettingsError(
                f"counts_per_revolution = {self.counts_per_revolution}, modulus = {self.modulus}: "
                "1 to 2**31, and 2 to 2**32."
            )
        if not 0.0 <= self.turnaround_s <= 1.0:
            raise RigSettingsError(f"turnaround_s = {self.turnaround_s}: 0 to 1 s.")

    @property
    def character_s(self) -> float:
        """How long a character takes."""
        return self.character_bits / self.baud_rate
