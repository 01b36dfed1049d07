"""The rounds; and once more from another beginning, where they leave the simulation wrong.

Who is accepted first decides what can be found beside. Where two explain about as much and do not
change the same, which of them comes first is a matter of chance: friction of the load, which stood
in for a load that coasts, was ahead of friction of the motor by nothing, and no cause found beside
it left the simulation right; beside the other one the load coasted, and what was hidden was found.
"""

from collections.abc import Sequence

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.accepting import Accepted, one_way
from servo_bench.diagnosis.searching.coasting import with_coasting
from servo_bench.diagnosis.searching.contenders import ALIKE, RIVAL_Z, Contender, Round, all_costs
from servo_bench.diagnosis.searching.gate import RIGHT, misfit, passes
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE, Hypothesis
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
    one = one_way(quick, base, candidates, scales, report)
    fork = fork_of(one.rounds[0], one.first) if one.first is not None else None
    if fork is None:
        return one
    here = with_coasting(quick, one.now)
    if float(misfit(quick, here.errors).max()) <= RIGHT:
        return one
    report(f"{fork.effect} first")
    other = one_way(quick, base, candidates, scales, report, begun=(one.rounds[0], fork))
    there = with_coasting(quick, other.now)
    lower = _cost(quick, there, here.sigma) < _cost(quick, here, here.sigma)
    return other if other.named and lower else one


def fork_of(played: Round, accepted: Contender) -> Contender | None:
    """Who is no further behind what was accepted than chance, and does not change the same; but for
    a coupling, whose three numbers fit a part of anything. Friction of the load changes much of
    what the motor's does (0.86 of it), and a Stribeck curve fits beside the right one only."""
    able = (c for c in played.contenders if c is not accepted and passes(c))
    unlike = (c for c in able if played.likeness(accepted, c) < ALIKE)
    firm = (c for c in unlike if c.effect not in SPRINGS - {VEHICLE})
    return next((c for c in firm if block_z(accepted.costs, c.costs) < RIVAL_Z), None)


def _cost(quick: Evidence, end: Found, sigma: Array) -> float:
    """Seen and held out."""
    held = quick.held_out([end.model])[0]
    return float(all_costs(end.errors, held, sigma).sum())
