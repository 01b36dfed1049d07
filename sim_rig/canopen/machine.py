"""The one plant behind the nodes of a rig, on the bus's clock.

Time is the microseconds that the bus stamped on the frames: a slave process that stalls finds
the same physics when it comes back.
"""

from collections.abc import Callable

from sim_rig.plant import Plant, PlantOutputs

CLOCK_JUMP_US = 10_000_000


class Machine:
    """A plant that is brought to a time by whoever needs to look at it."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._time_us: int | None = None
        self._play: Callable[[int], None] = lambda us: plant.advance(None, us * 1e-6)

    def driven_by(self, play: Callable[[int], None]) -> None:
        """Have `play(duration_us)` advance the plant: the drive knows what is commanded."""
        self._play = play

    def advance_to(self, time_us: int) -> None:
        """Let time pass up to `time_us`; a time that is past already changes nothing.

        A jump of more than CLOCK_JUMP_US is the clock's, not the rig's, and is not played.
        """
        passed_us = 0 if self._time_us is None else time_us - self._time_us
        if 0 < passed_us <= CLOCK_JUMP_US:
            self._play(passed_us)
        if passed_us > 0 or passed_us < -CLOCK_JUMP_US or self._time_us is None:
            self._time_us = time_us

    @property
    def outputs(self) -> PlantOutputs:
        """The plant as it is now."""
        return self.plant.outputs()
