"""The rounds; and once more from another beginning, where they leave the simulation wrong.

Who is accepted first decides what can be found beside. Where two explain about as much and change
something else, which of them comes first is a matter of chance: friction of the load, which stood
in for a load that coasts, was ahead of friction of the motor by nothing, and no cause found beside
it left the simulation right; beside the other one the load coasted, and what was hidden was found.
"""

from collections.abc import Sequence

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.searching.accepting import Accepted, one_way
from servo_bench.diagnosis.searching.coasting import with_coasting
from servo_bench.diagnosis.searching.contenders import LIKE, RIVAL_Z, Contender, Round, all_costs
from servo_bench.diagnosis.searching.gate import RIGHT, misfit, passes
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found


def rounds_of(
    quick: Evidence,
    base: Found,
    candidates: Sequence[Hypothesis],
    scales: Scales,
    report: Told,
) -> Accepted:
    """The better of two ways, where the first one leaves the simulation wrong and there is another;
    judged beside a load that coasts, where it does."""
    first = one_way(quick, base, candidates, scales, report)
    other = fork_of(first.rounds[0]) if first.named else None
    if other is None:
        return first
    here = with_coasting(quick, first.now)
    if float(misfit(quick, here.errors).max()) <= RIGHT:
        return first
    report(f"{other.effect} first")
    second = one_way(quick, base, candidates, scales, report, begun=(first.rounds[0], other))
    there = with_coasting(quick, second.now)
    return second if _cost(quick, there, here) < _cost(quick, here, here) else first


def fork_of(played: Round) -> Contender | None:
    """Who is no further behind the best one than chance, and changes something else."""
    best, *others = played.contenders
    unlike = (c for c in others if played.likeness(best, c) < LIKE and passes(c))
    return next((c for c in unlike if block_z(best.costs, c.costs) < RIVAL_Z), None)


def _cost(quick: Evidence, end: Found, weighed: Found) -> float:
    """Seen and held out, weighed by what one of them leaves."""
    held = quick.held_out([end.model])[0]
    return float(all_costs(end.errors, held, weighed.sigma).sum())
