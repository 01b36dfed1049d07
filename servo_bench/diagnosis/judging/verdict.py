"""The verdict: what a diagnosis says, as a public schema.

    verdict    "named"    at least one cause, each with its parameters and confidence
               "none"     the simulation is wrong by no more than its usual floor
               "unknown"  it is wrong, and nothing in the catalogue explains it; see `signature`

`servo-bench diagnose --schema` prints the JSON schema. Numbers are SI, in the unit beside them;
null where a number cannot be had. Keys are only ever added; `schema_version` counts changes of
meaning.
"""

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from servo_bench.files import Value

Kind = Literal["named", "none", "unknown"]
Where = Literal["standstill", "position", "velocity", "edge", "drift", "current", "scattered"]


class Quantity(Value):
    """A parameter, fitted or chosen."""

    value: float
    """The fitted value, in `unit`."""
    unit: str
    """Its SI unit."""
    ci95: tuple[float, float]
    """Its 95 % interval, in `unit`."""
    standard_error: float = Field(ge=0.0)
    """Its standard error, in `unit`; 0 where it was chosen or assumed, and not fitted."""

    @property
    def is_chosen(self) -> bool:
        """Whether no fit has freed it: the order of a line, the exponent of a law."""
        return self.standard_error == 0.0


class Cause(Value):
    """One physical cause; its class is it and all that is ambiguous with it."""

    effect: str
    """The effect's name in the catalogue."""
    parameters: dict[str, Quantity]
    """The effect's fitted parameters, by name."""
    confidence: float = Field(ge=0.0, le=1.0)
    """Probability that the cause is right, every name in `ambiguous_with` counting as the same."""
    ambiguous_with: tuple[str, ...] = ()
    """Effects that this recording cannot tell from it."""
    splitting_experiment: str = ""
    """What to run to tell them apart; empty where none are ambiguous."""
    evidence: float | None = None
    """z-score of its gain over blocks of the recording."""
    rival: str | None = None
    """The best other effect outside of the class."""
    over_rival: float | None = None
    """z-score of its lead over `rival`."""


class ErrorFigures(Value):
    """The simulation's error, rms over the first signal's noise floor or in its unit."""

    before: float
    """The nominal simulation's error, rms, in `unit`."""
    after: float
    """The error of the fitted model, rms, in `unit`."""
    without_causes: float | None = None
    """That of the best model without the causes, every rig's own numbers fitted; none where no
    cause is named."""
    noise_floor: float
    """What the sensors alone would leave, rms, in `unit`."""
    share_explained: float
    """(before² - after²)/(before² - noise_floor²), the share of the explainable error, 0 to 1."""
    on: Literal["holdout"] = "holdout"
    """Which data it is of: data that no fit saw."""
    signal: str
    """Which signal it is the error of."""
    unit: str
    """The unit of the figures."""


class Line(Value):
    """A line in a position spectrum."""

    shaft: Literal["motor", "load"]
    """Whose turns are counted."""
    order: float
    """Periods in one revolution of the shaft."""
    share: float
    """Share of the error's variance, 0 to 1."""


class Signature(Value):
    """The error without any model of its cause: where it is locked to, and what kind it is."""

    locked_to: Where
    """What the error goes with most."""
    shares: dict[str, float]
    """Share of the error's variance that its mean in each domain explains, 0 to 1, by domain."""
    lines: tuple[Line, ...] = ()
    """Lines in the error's position spectrum."""
    block: str | None = None
    """The block of the rig where the error arises, where the channels tell."""
    odd: float | None = None
    """Odd distortion relative to the linear response, where the excitation tells."""
    even: float | None = None
    """Even distortion relative to the linear response, where the excitation tells."""
    words: str = ""
    """The signature in sentences."""


class Limit(Value):
    """How small a cause could have been seen here."""

    effect: str
    """The effect."""
    parameter: str
    """The parameter that is its size."""
    unit: str
    """The parameter's unit."""
    detectable: float | None
    """Smallest size found nine times in ten at a false alarm of 1e-3, in `unit`."""
    cramer_rao: float | None
    """Least standard deviation that an estimate can have here which believes the same of every rig,
    were the errors that are left independent; in `unit`."""
    ratio: float | None
    """The standard error reached, over `cramer_rao`."""


class Verdict(Value):
    """What a diagnosis says."""

    schema_version: Literal[1] = 1
    """Counts changes of meaning; keys are only ever added."""
    verdict: Kind
    """Whether causes are named, none is needed, or none is known."""
    sentence: str
    """The verdict in words."""
    causes: tuple[Cause, ...] = ()
    """The causes; none unless the verdict is "named"."""
    error: ErrorFigures | None = None
    """How wrong the simulation is, before and after."""
    signature: Signature | None = None
    """The error without any model of its cause."""
    limit: tuple[Limit, ...] = ()
    """How small the causes could have been seen."""
    undecided: tuple[str, ...] = ()
    """What the recording cannot decide, in sentences."""
    notes: tuple[str, ...] = ()
    """What else the reader should know, in sentences."""
    next_run: str = ""
    """What to run next to decide more; empty for nothing."""
    nominal: dict[str, float] = Field(default_factory=dict)
    """The nominal values after the fit, SI, by the rig file's keys."""
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)
    """The model's effects after the fit, SI, as a rig file's `[effects.NAME]`."""
    nuisances: dict[str, float] = Field(default_factory=dict)
    """Other fitted numbers that are not of a named cause, SI, by name."""
    seconds: float = 0.0
    """How long the diagnosis took, s."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.verdict == "named") != bool(self.causes):
            raise ValueError(
                f"verdict {self.verdict!r} with {len(self.causes)} causes: only a verdict "
                "'named' has causes, and it has at least one"
            )
        return self

    def numbers(self) -> dict[str, Any]:
        """The verdict for JSON."""
        return self.model_dump(mode="json")

    @property
    def names(self) -> tuple[str, ...]:
        """The causes' names."""
        return tuple(cause.effect for cause in self.causes)
