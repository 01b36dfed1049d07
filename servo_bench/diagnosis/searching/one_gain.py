"""Two gains that are wrong for one: where no current is known, the loop is two products.

    A = K_T K_P / J,   B = K_T K_I / J

From the command and the load's angle nothing else of the four numbers shows but what friction is of
the torque, and most rigs have little. A K_T that is 7 % too large with a K_P that is 6.5 % too
small is a K_I that is 7 % too large. Of one cause and two that do the same, one is told.
"""

from collections.abc import Sequence

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.contenders import faced
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.joint import Named, own_unknowns, share_of
from servo_bench.diagnosis.searching.runoff import put, sought_again, taken_out
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.unknowns import Unknown, merged, widened
from sim_rig.model import Model

TORQUE, INERTIA = "torque_constant_error", "inertia_error"
K_P, K_I = "proportional_gain_error", "integral_gain_error"
GAINS = frozenset({TORQUE, INERTIA, K_P, K_I})
ALIKE = 0.3
"""Of the larger change of the two products, that may be left of what one gain would leave alone:
the numbers of every rig's bands are in it."""
HARDLY = 0.05
"""Share of the cost that two may take more than one: searches among bounces end so far apart."""


def products(model: Model) -> tuple[float, float]:
    """(A, B) over those of the drawing."""
    torque, inertia, p, i = (
        1.0 + float(getattr(model.effects.get(effect), "error_fraction", 0.0))
        for effect in (TORQUE, INERTIA, K_P, K_I)
    )
    return torque * p / inertia, torque * i / inertia


def one_that_does(model: Model) -> tuple[str, float] | None:
    """The gain that would make both products alone, and its error; None where none would."""
    a, b = products(model)
    errors = {
        K_P: (abs(b - 1.0), a - 1.0),
        K_I: (abs(a - 1.0), b - 1.0),
        TORQUE: (abs(a - b), a - 1.0),
    }
    effect = min(errors, key=lambda name: errors[name][0])
    left, error = errors[effect]
    return (effect, error) if left < ALIKE * abs(error) else None


def as_one_gain(
    whole: Evidence,
    final: Found,
    named: Sequence[Named],
    candidates: Sequence[Hypothesis],
    band: Sequence[Unknown],
    *,
    believed: Model,
) -> tuple[Found, list[Named]]:
    """The fit and its causes with one gain for two, by the load's encoder alone, where that is
    hardly worse and the rig's file has none of these errors already."""
    two = [one for one in named if one.effect in GAINS]
    does = one_that_does(final.model)
    unchanged = final, list(named)
    if not whole.is_of_the_load_alone or len(two) != 2 or does is None:
        return unchanged
    if GAINS & believed.effects.keys():  # their products are no longer the drawing's
        return unchanged
    effect, error = does
    asked = next((h for h in candidates if h.effect == effect), None)
    if asked is None or effect in {one.effect for one in two}:
        return unchanged
    gone = {one.effect for one in two}
    less = taken_out(final, gone, gone, band)
    (free,) = widened(effect, asked.free, less.model, error)
    start = put(less, free.put(less.model, error), merged(less.unknowns, (free,)))
    found = sought_again(whole, start, {effect})
    if share_of(final, found) > HARDLY:
        return unchanged
    base = sought_again(whole, less, ())
    played = faced(whole, base, [(found, asked)], sigma=final.sigma)
    (contender,) = played.contenders
    kept = [one for one in named if one not in two]
    return found, [*kept, Named(effect, played, contender, own_unknowns(contender, effect))]
