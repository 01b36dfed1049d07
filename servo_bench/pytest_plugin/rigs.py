"""Software rigs for tests: in virtual time, or on a free port of their own."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from servo_bench.errors import ConfigError, gathered
from servo_bench.files import validated
from servo_bench.rig import RigConfig, SimulatedConfig, load_rig
from servo_bench.units import to_si
from sim_rig.process import spawn

PAPER = "rigs/paper.toml"
Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class SimRig:
    """A software rig.

    `config` is what it really is; `shown` what a recording says of it: the nominal rig, without
    the effects and faults that were hidden in it. `wire`: it is on a bus, `config.bus`.
    """

    config: RigConfig
    wire: bool = False

    @property
    def shown(self) -> RigConfig:
        """The rig as its data sheet has it."""
        return self.config.model_copy(update={"simulated": None})

    @property
    def bus(self) -> dict[str, str | int | float | bool]:
        """The options for `can.Bus`, for a driver of your own. ConfigError in virtual time."""
        if not self.wire:
            raise ConfigError("a rig in virtual time has no bus: make it with wire=True.")
        return dict(self.config.bus)


class Rigs:
    """What the fixture `sim_rig` is: called, it makes a rig; left, it ends them all."""

    def __init__(self, folder: Path) -> None:
        """`folder` is where relative rig files are looked for."""
        self._folder = folder
        self._started = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with gathered():
            self._started.__exit__(kind, error, trace)

    def __call__(
        self,
        rig: str | RigConfig = PAPER,
        *,
        effects: Effects | None = None,
        faults: Sequence[str] | str = (),
        seed: int | None = None,
        wire: bool = False,
        **simulated: Any,
    ) -> SimRig:
        """A rig from a file (or a value), with hidden effects and faults.

        `effects` as in `[effects.NAME]` (`servo-bench effects` lists them), `faults` as lines
        (`servo-bench rig --list-faults`), `simulated` any other key of `[simulated]`, such as
        `load_encoder_noise_rad` or `backlash_gap_rad`. `wire=True` starts it on a free port, in
        processes of its own and in wall time. ConfigError for what cannot be, RigError where it
        does not start.
        """
        config = rig if isinstance(rig, RigConfig) else load_rig(rig, beside=self._folder)
        lines = (faults,) if isinstance(faults, str) else tuple(faults)
        table = (config.simulated or SimulatedConfig()).model_dump()
        table |= _si(simulated)
        table["effects"] = {**table["effects"], **(effects or {})}
        table["faults"] = (*table["faults"], *lines)
        table["seed"] = table["seed"] if seed is None else seed
        config = _with_simulated(config, table)
        settings = config.on_a_free_port().simulation_settings()
        if not wire:
            with gathered():
                config.model_copy(update={"effects": settings.effects}).model()  # names and values
            return SimRig(config.as_simulated())
        with gathered():
            started = self._started.enter_context(spawn(settings))
        return SimRig(config.as_simulated(**started.bus), wire=True)


def _si(table: Mapping[str, Any]) -> dict[str, Any]:
    try:
        return to_si(table)
    except ValueError as error:
        raise ConfigError(f"sim_rig(...): {error}.") from error


def _with_simulated(config: RigConfig, table: Mapping[str, Any]) -> RigConfig:
    """The rig with another `[simulated]`, checked as a file's."""
    made = validated(SimulatedConfig, dict(table), "sim_rig(...)")
    return config.model_copy(update={"simulated": made})
