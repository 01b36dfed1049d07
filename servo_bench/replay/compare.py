"""Has the rig changed between two recordings: by how much, where, and could it be chance?

    compare(load("march.mcap"), load("april.mcap")).sentences()

Three looks, each with its own standard errors: the Volterra kernels (any change of the response),
the noise at standstill (the sensors), and the rig's physical numbers (what and where). Over all
tests together the chance to cry change on two runs of an unchanged rig is at most ALPHA.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from servo_bench.errors import BenchError, FitError
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.recording import Recording
from servo_bench.replay.change import ALPHA, Change, finite
from servo_bench.replay.kernel_change import KernelChange, OrderChange, kernel_change
from servo_bench.replay.noise_change import noise_changes
from servo_bench.replay.parameter_change import parameter_changes

Result = TypeVar("Result")

FIGURES = (
    *("vaf_fresh_order1_percent", "vaf_fresh_order3_percent", "noise_rad_s"),
    *("noise_ceiling_percent", "energy_order1_percent", "energy_order2_percent"),
    *("energy_order3_percent", "delay_periods"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two runs side by side.

    `parameters` and `noise` are numbers before and after; `kernels` is None where the runs did
    not play the same. `figures` holds the main figures of both analyses, by name. `notes` say
    what could not be compared, and why, and what else differs.
    """

    kernels: KernelChange | None
    parameters: tuple[Change, ...]
    noise: tuple[Change, ...]
    figures: dict[str, tuple[Any, Any]]
    notes: tuple[str, ...]

    @property
    def tests(self) -> int:
        """How many p-values there are; each is held against ALPHA over this."""
        kernels = len(self.kernels.orders) if self.kernels else 0
        return kernels + len(self.parameters) + len(self.noise)

    def is_change(self, one: Change | OrderChange) -> bool:
        """Whether chance does not explain it."""
        return one.p_value < ALPHA / max(self.tests, 1)

    @property
    def changed(self) -> bool:
        """Whether anything has changed that chance does not explain."""
        orders = self.kernels.orders if self.kernels else ()
        tested: list[Change | OrderChange] = [*orders, *self.parameters, *self.noise]
        return self._delayed or any(self.is_change(one) for one in tested)

    @property
    def _delayed(self) -> bool:
        return self.kernels is not None and self.kernels.delay_a != self.kernels.delay_b

    def sentences(self) -> list[str]:
        """What has changed, by how much, and where; the notes after it."""
        told = [*self._kernel_sentences()]
        for change in (*self.parameters, *self.noise):
            if self.is_change(change):
                told.append(_sentence(change))
        if not self.changed:
            told.append(self._unchanged())
        return [*told, *self.notes]

    def _kernel_sentences(self) -> Iterator[str]:
        if self.kernels is None:
            return
        if self._delayed:
            yield (
                f"The first answer to a command comes {self.kernels.delay_b} periods after it, and "
                f"came {self.kernels.delay_a} after it before."
            )
        for order in self.kernels.orders:
            if self.is_change(order):
                lags_s = [lag * self.kernels.period_s for lag in order.peak_lag]
                places = ", ".join(f"{1e3 * lag:g}" for lag in lags_s)
                yield (
                    f"The response has changed in order {order.order} by {100 * order.share:.2g} % "
                    f"of the linear response, most at lags of {places} ms."
                )

    def _unchanged(self) -> str:
        limits = [_known_to(change) for change in self.parameters]
        seen = f" Differences are known to, at 95 %: {', '.join(limits)}." if limits else ""
        return f"Nothing has changed that chance does not explain.{seen}"

    def numbers(self) -> dict[str, Any]:
        """Everything as plain values, ready for JSON; None for what is not known."""
        kernels = self.kernels
        return {
            "changed": self.changed,
            "sentences": self.sentences(),
            "alpha": ALPHA,
            "tests": self.tests,
            "kernels": None
            if kernels is None
            else {
                "lags_s": kernels.lags_s.tolist(),
                "c1_a_rad_s": kernels.c1_a.tolist(),
                "c1_b_rad_s": kernels.c1_b.tolist(),
                "c1_difference_rad_s": kernels.c1_difference.tolist(),
                "standard_error_rad_s": finite(kernels.standard_error),
                "delay_periods_a": kernels.delay_a,
                "delay_periods_b": kernels.delay_b,
                "orders": [order.numbers(self.is_change(order)) for order in kernels.orders],
            },
            "parameters": [change.numbers(self.is_change(change)) for change in self.parameters],
            "noise": [change.numbers(self.is_change(change)) for change in self.noise],
            "figures": {name: {"a": a, "b": b} for name, (a, b) in self.figures.items()},
            "notes": list(self.notes),
        }


def compare(a: Recording, b: Recording) -> Comparison:
    """Compare two recordings. FitError where there is nothing at all that both can tell."""
    notes = [*_settings_notes(a, b)]
    kernels = _tried("The kernels", lambda: kernel_change(a, b), notes)
    parameters = _tried("The rig's numbers", lambda: parameter_changes(a, b), notes)
    noise = tuple(noise_changes(a, b))
    if kernels is None and parameters is None and not noise:
        raise FitError(" ".join(["the two recordings have nothing to compare.", *notes]))
    figures = _tried("The analyses", lambda: _figures(a, b), notes)
    return Comparison(
        kernels=kernels,
        parameters=parameters or (),
        noise=noise,
        figures=figures or {},
        notes=tuple(notes),
    )


def _tried(what: str, look: Callable[[], Result], notes: list[str]) -> Result | None:
    """A look, or a note that says why it cannot be taken."""
    try:
        return look()
    except BenchError as error:
        notes.append(f"{what} could not be compared: {str(error).rstrip('.')}.")
        return None


def _figures(a: Recording, b: Recording) -> dict[str, tuple[Any, Any]]:
    before, after = analyse(a).numbers(), analyse(b).numbers()
    return {name: (before[name], after[name]) for name in FIGURES}


def _settings_notes(a: Recording, b: Recording) -> Iterator[str]:
    """What differs in what was written down before the runs."""
    if a.rig is not None and b.rig is not None:
        before = {**_flat(a.rig.nominal.model_dump()), **_flat(a.rig.effects)}
        after = {**_flat(b.rig.nominal.model_dump()), **_flat(b.rig.effects)}
        other = sorted(k for k in before.keys() | after.keys() if before.get(k) != after.get(k))
        if a.rig.name != b.rig.name:
            yield f"The rigs are called {a.rig.name!r} and {b.rig.name!r}."
        if other:
            yield f"The two rig files differ in {', '.join(other)}."
    for recording, which in ((a, "first"), (b, "second")):
        if recording.cut:
            yield f"The {which} recording was cut before its run ended."


def _flat(table: Any, prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, dict)
        flat |= _flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return flat


def _sentence(change: Change) -> str:
    factor, unit = change.shown
    low, high = (factor * end for end in change.interval())
    share = f" ({change.share:+.2%})" if change.is_known else ""
    return (
        f"{change.label} ({change.where}) has changed from {factor * change.a:.6g} to "
        f"{factor * change.b:.6g} {unit}{share}; 95 % of the difference: {low:+.3g} to {high:+.3g}."
    )


def _known_to(change: Change) -> str:
    factor, unit = change.shown
    half = 1.96 * change.standard_error
    share = f" ({half / abs(change.a):.2%})" if change.is_known else ""
    return f"{change.label} {factor * half:.2g} {unit}{share}"
