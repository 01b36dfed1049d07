"""An acceptance plan: what is played on which rig, and within which limits the result must lie.

name = "axis 3"
experiment = "experiments/demo.toml"
rig = "rigs/paper.toml"              # optional: the experiment's own

[limits]                             # figures of the analysis, as in its JSON
vaf_fresh_order3_percent = { least = 94.0 }
noise_deg_s = { most = 2.0 }
"run.missed_slots" = { most = 0 }

[fit]                                # numbers of the rig's model, fitted to the run
backlash_gap_deg = { least = 1.4, most = 1.6 }
"coulomb.torque_nm" = { most = 0.002 }

[verdict]
allowed = ["none"]                   # "none", "unknown", or names of effects
"""

import math
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, load_experiment
from servo_bench.files import Value, find, read_toml, validated
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig, load_rig
from servo_bench.units import to_si
from sim_rig.effects import catalogue

UNNAMED = ("none", "unknown")

EVENTS = "run.events."
"""What the figures that count a run's events are called."""


class Bounds(Value):
    """Where a figure must lie; both ends belong to it."""

    least: float | None = None
    """The least that is allowed, in the unit that ends the figure's name."""
    most: float | None = None
    """The most that is allowed, in the unit that ends the figure's name."""

    @model_validator(mode="after")
    def _is_a_range(self) -> "Bounds":
        if self.least is None and self.most is None:
            raise ValueError("give least, most, or both")
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(f"least = {self.least} is above most = {self.most}")
        return self

    def hold(self, value: float) -> bool:
        """Whether a value lies within; a NaN does not."""
        above = self.least is None or value >= self.least
        below = self.most is None or value <= self.most
        return above and below and not math.isnan(value)

    @property
    def text(self) -> str:
        """As people write it."""
        if self.least is None:
            return f"at most {self.most:g}"
        if self.most is None:
            return f"at least {self.least:g}"
        return f"{self.least:g} to {self.most:g}"


class AllowedVerdict(Value):
    """`[verdict]`: what the diagnosis may say: "none", "unknown", or the effects it may name."""

    allowed: tuple[str, ...] = Field(min_length=1)
    """The verdicts that pass: "none", "unknown", and names of effects."""

    @model_validator(mode="after")
    def _can_be_said(self) -> "AllowedVerdict":
        known = {*UNNAMED, *catalogue()}
        wrong = [name for name in self.allowed if name not in known]
        if wrong:
            near = get_close_matches(wrong[0], known, n=1)
            meant = f" Is {near[0]!r} meant?" if near else ""
            raise ValueError(
                f"no diagnosis says {wrong[0]!r}: allowed are 'none', 'unknown', and the effects "
                f"that servo-bench effects lists.{meant}"
            )
        return self


class Plan(Value):
    """The whole file."""

    name: str
    """What reports and messages call the plan."""
    experiment: str
    """The experiment file, beside this file too."""
    rig: str | None = None
    """The rig file, instead of the experiment's own."""
    time: Literal["virtual", "wall"] = "virtual"
    """How a software rig plays: in "virtual" time, or in "wall" time on a bus of its own."""
    limits: dict[str, Bounds] = Field(default_factory=dict)
    """Bounds on figures of the analysis, by their names in its JSON."""
    fit: dict[str, Bounds] = Field(default_factory=dict)
    """Bounds on numbers of the rig's model that `servo-bench fit` finds, by name."""
    verdict: AllowedVerdict | None = None
    """What the diagnosis may say; without it none is made."""

    @model_validator(mode="before")
    @classmethod
    def _in_si(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        tables = {key: _si_bounds(data[key]) for key in ("limits", "fit") if key in data}
        return {**data, **tables}

    @model_validator(mode="after")
    def _judges_something(self) -> "Plan":
        if not (self.limits or self.fit or self.verdict):
            raise ValueError("nothing would be judged: give [limits], [fit], or [verdict]")
        return self


def _si_bounds(table: Any) -> Any:
    """A table of bounds with every reader's unit turned into SI, by the name of the figure."""
    if not isinstance(table, Mapping):
        return table
    turned: dict[str, Any] = {}
    for name, bounds in table.items():
        if not isinstance(bounds, Mapping):
            turned[name] = bounds
            continue
        ends = {key: to_si({name: value}) for key, value in bounds.items()}
        si_name = next((next(iter(end)) for end in ends.values()), name)
        if si_name in turned:
            raise ValueError(f"{si_name} is given twice, once as {name}: give it once")
        turned[si_name] = {key: next(iter(end.values())) for key, end in ends.items()}
    return turned


def need_the_plans(recording: Recording, experiment: Experiment, rig: RigConfig) -> None:
    """Raise ConfigError where a recording is known to be another experiment's or another rig's."""
    played, on = recording.experiment, recording.rig
    if played is not None:
        commanded, wanted = (one.schedule().velocity_rad_s for one in (played, experiment))
        if not np.array_equal(commanded, wanted):
            raise ConfigError(
                f"the recording is one of the experiment {played.name!r}, which commands something "
                f"else than {experiment.name!r}, the plan's. Judge a recording of that, or let "
                "servo-bench check play it."
            )
    if on is not None and on.name != rig.name:
        raise ConfigError(
            f"the recording is of the rig {on.name!r}, and the plan is for {rig.name!r}. Judge a "
            "recording of that rig, or name the other one in the plan."
        )


def load_plan(name: str | Path) -> tuple[Plan, Experiment, RigConfig]:
    """The plan with its experiment and rig; ConfigError where one is missing or makes no sense.

    Experiment and rig are looked for beside the plan too.
    """
    path = find(name)
    plan = validated(Plan, read_toml(path), str(path))
    experiment = load_experiment(find(plan.experiment, path.parent))
    rig = load_rig(plan.rig or experiment.rig, beside=path.parent)
    return plan, experiment, rig


def known_figure(plan: Plan, figures: Mapping[str, Any], name: str) -> Any:
    """A figure that the plan limits. ConfigError where the analysis has none of that name."""
    if name not in figures and name.startswith(EVENTS):
        return 0  # what a run had none of has no figure
    if name not in figures:
        near = ", ".join(key for key, value in figures.items() if not isinstance(value, str | list))
        raise ConfigError(
            f"plan {plan.name!r} limits {name}, which is no figure. There are: {near}."
        )
    return figures[name]
