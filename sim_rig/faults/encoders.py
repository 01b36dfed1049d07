"""Encoders that stick, jump, or rustle. `encoder` is motor, load, or second (0x60E4)."""

from sim_rig.faults.fault import Fault


class EncoderFault(Fault):
    """Distorts the counts of one encoder from SYNC `at` on."""

    def begin(self) -> None:
        """Put the distortion in."""
        self.targets.sensor(str(self.values["encoder"])).distortion = self.distorted

    def rearm(self) -> None:
        """Take the distortion out."""
        super().rearm()
        self.targets.sensor(str(self.values["encoder"])).distortion = None

    def distorted(self, counts: int) -> int:
        """What is read where `counts` would be right."""
        return counts


class Stuck(EncoderFault):
    """The count stays what it was."""

    def rearm(self) -> None:
        """Move again."""
        super().rearm()
        self._count: int | None = None

    def distorted(self, counts: int) -> int:
        """The first count, for ever."""
        if self._count is None:
            self._count = counts
        return self._count


class Jump(EncoderFault):
    """The count is off by `counts` from then on."""

    def distorted(self, counts: int) -> int:
        """Shifted."""
        return counts + int(self.values["counts"])


class Noise(EncoderFault):
    """White noise of standard deviation `counts` is on every reading."""

    def distorted(self, counts: int) -> int:
        """Shaken."""
        return counts + round(self.random.normal(0.0, float(self.values["counts"])))
