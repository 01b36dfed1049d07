"""What a held-out recording says against a cause: that it is none there.

A cause was accepted by blocks of its own recordings that its fit did not see, under the same
excitation. A held-out one has another, and no fit has any part of it:

    gain = F(all that was found, but the cause) - F(all that was found),     F the cost of every
    block of the held-out recording, by what is left where everything was found

A cause that is there gains there, or is silent (a limit that is not reached). One that gains
nothing or less has fitted the excitation: of a supply that sags, a K_T that droops took 12 % of its
own validation at 24 deviations, and made the held-out recording 0.4 % worse.
"""

from servo_bench.diagnosis.comparing.evidence import Errors, evidence_of
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.finding import Finding
from sim_rig.errors import SimRigError

SILENT = 1e-3
"""Of the cost, that what acts at all changes at least."""


def unconfirmed(finding: Finding) -> frozenset[str]:
    """Effects among the named that act on the held-out recording and make it no better; none where
    there is no such recording."""
    if finding.held_out is None or not finding.named:
        return frozenset()
    model, sigma = finding.final.model, finding.final.sigma
    effects, models = [], [model]
    for effect in dict.fromkeys(n.effect for n in finding.named):
        try:
            models.append(model.without(effect))
        except SimRigError:  # the others need it
            continue
        effects.append(effect)
    judge = evidence_of([finding.held_out], model, block=finding.whole.fitted[0].block)
    parts = zip(judge.seen(models), judge.held_out(models), strict=True)
    found, *without = [_cost(parts_of_one, sigma) for parts_of_one in parts]
    gains = ((effect, cost - found) for effect, cost in zip(effects, without, strict=True))
    return frozenset(effect for effect, gain in gains if gain < -SILENT * found)


def _cost(parts: tuple[Errors, Errors], sigma: Array) -> float:
    return sum(part.cost(sigma) for part in parts)
