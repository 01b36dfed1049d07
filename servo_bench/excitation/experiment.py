"""An experiment: what is played, in which order, at which period. Frozen and serialisable.

Every experiment plays four phases, and all of it is known before the drive is enabled:

    standstill      zero velocity, for the noise of the sensors
    lead-in         the tail of the identification sequence, so that its period starts in the
                    periodic steady state
    identification  one or more whole periods
    validation      another sequence, that no fit sees

`Schedule` is the experiment laid out slot by slot.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, PositiveInt

from servo_bench.errors import ConfigError
from servo_bench.excitation.sequences import (
    MAX_CHIPS,
    Count,
    MSequence,
    Periodic,
    RandomBinary,
    Sequence,
)
from servo_bench.files import Value, find, read_toml, validated

__all__ = ["Experiment", "MSequence", "Phase", "RandomBinary", "Schedule", "Sequence"]


class Phase(IntEnum):
    """What a slot is for."""

    STANDSTILL = 0
    LEAD_IN = 1
    IDENTIFICATION = 2
    VALIDATION = 3


class Experiment(Value):
    """One run of the bench, as its TOML file describes it."""

    name: str
    """What messages and recordings call the experiment."""
    rig: str
    """The rig file to play on, where the command line names no other."""
    period_s: PositiveFloat
    """Period of the command, one slot, s."""
    memory: PositiveInt
    """The kernels' memory, in samples."""
    standstill_s: float = Field(default=2.0, ge=0.0)
    """How long the rig stands first, for the sensors' noise, s."""
    lead_in: Count = 256
    """How many chips are played before the identification, at least `memory`."""
    identification: Periodic
    """The sequence that the kernels are told from."""
    validation: Sequence
    """Another sequence, that no fit sees."""

    def schedule(self) -> "Schedule":
        """The experiment slot by slot; ConfigError where it cannot be played."""
        if self.lead_in < self.memory:
            raise ConfigError(
                f"lead_in = {self.lead_in} chips is shorter than the kernels' memory = "
                f"{self.memory}: the first samples would answer to chips that were never played. "
                f"Give lead_in at least {self.memory}."
            )
        standstill = round(min(self.standstill_s / self.period_s, MAX_CHIPS + 1))
        if standstill > MAX_CHIPS:
            raise ConfigError(
                f"standstill_s = {self.standstill_s:g} at period_s = {self.period_s:g} are more "
                f"than {MAX_CHIPS} periods. Shorten the standstill, or correct the period."
            )
        chips = self.identification.velocity_rad_s()
        validation = self.validation.velocity_rad_s()
        commands = [
            np.zeros(standstill),
            np.resize(chips[::-1], self.lead_in)[::-1],
            chips,
            validation,
        ]
        chip_index = [
            np.full(standstill, -1),
            np.arange(-self.lead_in, 0) % chips.size,
            np.arange(chips.size),
            np.arange(validation.size),
        ]
        return Schedule(
            period_s=self.period_s,
            velocity_rad_s=np.concatenate(commands),
            phase=np.repeat(np.array(list(Phase), np.uint32), [c.size for c in commands]),
            chip=np.concatenate(chip_index).astype(np.int64),
        )


@dataclass(frozen=True, slots=True)
class Schedule:
    """Velocity command, phase, and chip index of every slot; arrays of shape (slots,).

    `chip` counts within its phase (in the lead-in: the place in the identification period that
    is played), and is -1 at standstill.
    """

    period_s: float
    velocity_rad_s: NDArray[np.float64]
    phase: NDArray[np.uint32]
    chip: NDArray[np.int64]

    @property
    def slots(self) -> int:
        """How many periods are played."""
        return int(self.velocity_rad_s.size)

    @property
    def duration_s(self) -> float:
        """How long it plays."""
        return self.slots * self.period_s

    @property
    def peak_velocity_rad_s(self) -> float:
        """The largest speed that is commanded."""
        return float(np.abs(self.velocity_rad_s).max(initial=0.0))

    @property
    def peak_travel_rad(self) -> float:
        """How far an ideal axis gets from its start, to either side."""
        return float(np.abs(np.cumsum(self.velocity_rad_s) * self.period_s).max(initial=0.0))

    def slots_of(self, phase: Phase) -> slice:
        """The slots of one phase, as a slice."""
        found = np.flatnonzero(self.phase == phase)
        return slice(int(found[0]), int(found[-1]) + 1) if found.size else slice(0, 0)


def load_experiment(name: str | Path) -> Experiment:
    """Read an experiment file. Raises ConfigError where it is missing or makes no sense."""
    path = find(name)
    return validated(Experiment, read_toml(path), str(path))


def experiment_from_table(table: Mapping[str, Any], source: str) -> Experiment:
    """An experiment that came with a recording."""
    return validated(Experiment, dict(table), source)
