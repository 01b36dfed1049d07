"""What acts a few times only, and never in what is held out: judged by what came after its fit.

A clamp that the integral reaches after a full reversal alone shows in the identification and not in
a validation of smaller jumps. Beside the base it then changes nothing there, and no gain on what is
held out can be asked of it. But candidates are tried on a recording's beginning: the rest of the
identification has seen none of them, and there it acts again.
"""

from dataclasses import replace

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.searching.contenders import Contender, Round
from servo_bench.diagnosis.searching.gate import HELD_Z, MUCH, passes

SILENT = 0.02
"""Of the held-out cost: who changes less does not act there. The nuisances that were fitted beside
it change so much."""


def acts_again(quick: Evidence, played: Round) -> Contender | None:
    """The best contender that took much of what was fitted and does not act in what is held out,
    held against what came after the beginning instead: beyond chance there, and much of that."""
    for one in played.contenders:
        if one.seen_gain < MUCH or one.seen_z < HELD_Z or abs(one.held_gain) > SILENT:
            continue
        base, found = quick.after([played.base.model, one.found.model])
        before, after = base.cost(played.sigma), found.cost(played.sigma)
        if not after < (1.0 - MUCH) * before:  # nor where nothing came after the beginning
            continue
        z = block_z(found.costs(played.sigma), base.costs(played.sigma))
        held = replace(one, held=found, held_gain=1.0 - after / before, held_z=z)
        if passes(held):
            return held
    return None
