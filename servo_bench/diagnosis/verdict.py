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
    """A fitted parameter; `ci95` is its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]
    standard_error: float = Field(ge=0.0)


class Cause(Value):
    """One physical cause, by its name in the catalogue of effects.

    `confidence` is the probability that the cause is right (its class: every name in
    `ambiguous_with` counts as the same). `evidence` is the z-score of its gain over blocks of
    the recording; `over_rival` the same against the best rival outside of the class.
    """

    effect: str
    parameters: dict[str, Quantity]
    confidence: float = Field(ge=0.0, le=1.0)
    ambiguous_with: tuple[str, ...] = ()
    splitting_experiment: str = ""
    evidence: float | None = None
    rival: str | None = None
    over_rival: float | None = None


class ErrorFigures(Value):
    """The simulation's error, rms over the first signal's noise floor or in its unit.

    `before`, `after`, `noise_floor` are in `unit`; `share_explained` is the share of the
    explainable error, (before^2 - after^2)/(before^2 - noise_floor^2), between 0 and 1.
    """

    before: float
    after: float
    noise_floor: float
    share_explained: float
    on: Literal["holdout"] = "holdout"
    signal: str
    unit: str


class Line(Value):
    """A line in a position spectrum: its order (periods a revolution) and share of the error."""

    shaft: Literal["motor", "load"]
    order: float
    share: float


class Signature(Value):
    """The error without any model of its cause: where it is locked to, and what kind it is.

    `shares` says how much of the error's variance its mean in each domain explains; `odd` and
    `even` are distortion levels relative to the linear response, where the excitation tells.
    """

    locked_to: Where
    shares: dict[str, float]
    lines: tuple[Line, ...] = ()
    block: str | None = None
    odd: float | None = None
    even: float | None = None
    words: str = ""


class Limit(Value):
    """How small a cause could have been seen here.

    `detectable` is the smallest size found nine times in ten at a false alarm of 1e-3,
    `cramer_rao` the least standard deviation any unbiased estimate can have at this floor, and
    `ratio` the standard error reached over it.
    """

    effect: str
    parameter: str
    unit: str
    detectable: float | None
    cramer_rao: float | None
    ratio: float | None


class Verdict(Value):
    """What a diagnosis says."""

    schema_version: Literal[1] = 1
    verdict: Kind
    sentence: str
    causes: tuple[Cause, ...] = ()
    error: ErrorFigures | None = None
    signature: Signature | None = None
    limit: tuple[Limit, ...] = ()
    undecided: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    next_run: str = ""
    nominal: dict[str, float] = Field(default_factory=dict)
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)
    nuisances: dict[str, float] = Field(default_factory=dict)
    seconds: float = 0.0

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
