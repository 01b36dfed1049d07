"""Have the rig's physical numbers changed? Each run is fitted alone; the values are subtracted.

Standard errors come from each fit's own residuals (`servo_bench.diagnosis.fitting.uncertainty`):
what the model cannot explain widens them, and is alike in both runs, so the difference is known
rather better than they say.
"""

import math
from collections.abc import Sequence

from servo_bench.diagnosis.fitting.fit import Fit, fit
from servo_bench.errors import BenchError, FitError, gathered
from servo_bench.recording.recording import Recording
from servo_bench.replay.change import Change, two_sided
from sim_rig.model import Model

FREE: tuple[tuple[str, ...], ...] = (
    ("J", "K_P", "K_I", "gap", "coulomb.torque_nm", "viscous.damping_nm_s_per_rad"),
    ("J", "K_P", "K_I", "gap"),
    ("J", "gap"),
    ("gap",),
)
"""Tried in this order: the first set that both recordings can tell."""
WHERE = {
    "inertia_kg_m2": "mechanics",
    "proportional_gain_a_s_per_rad": "controller",
    "integral_gain_a_per_rad": "controller",
    "backlash_gap_rad": "transmission",
    "coulomb.torque_nm": "mechanics",
    "viscous.damping_nm_s_per_rad": "mechanics",
}


def parameter_changes(a: Recording, b: Recording) -> tuple[Change, ...]:
    """What has changed. FitError where no set of numbers can be told from both recordings."""
    model = _model(a, b)
    reason = ""
    for free in FREE:
        try:
            with gathered():
                fits = (_fitted(a, model, free), _fitted(b, model, free))
        except BenchError as error:
            reason = str(error)
            continue
        return changes_between(*fits)
    raise FitError(f"no number of the rig can be told from both recordings: {reason}")


def _model(a: Recording, b: Recording) -> Model:
    """Where both fits start: the rig of the first recording that names one."""
    for recording in (a, b):
        if recording.rig is not None:
            return recording.rig.model()
    raise FitError("neither recording says what its rig is")


def _fitted(recording: Recording, model: Model, free: Sequence[str]) -> Fit:
    found = fit(recording, model, free)
    if not found.converged:
        raise FitError(found.reason)
    return found


def changes_between(before: Fit, after: Fit) -> tuple[Change, ...]:
    """What two fits of the same numbers say has changed."""
    changes = []
    for one, other in zip(before.estimates, after.estimates, strict=True):
        error = math.hypot(one.standard_error, other.standard_error)
        changes.append(
            Change(
                name=one.name,
                symbol=one.symbol,
                unit=one.unit,
                where=WHERE.get(one.name, "rig"),
                a=one.value,
                b=other.value,
                standard_error=error,
                p_value=two_sided(other.value - one.value, error),
            )
        )
    return tuple(changes)
