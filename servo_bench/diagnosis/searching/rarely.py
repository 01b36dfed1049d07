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
from sim_rig.errors import EffectError

SILENT = 0.02
"""Of the held-out cost: what changes no more of it, taken away alone, does not act there."""


def acts_again(quick: Evidence, played: Round) -> Contender | None:
    """The best contender that took much of what was fitted and does not act in what is held out,
    held against what came after the beginning instead: beyond chance there, and much of that."""
    for one in played.contenders:
        if one.seen_gain < MUCH or one.seen_z < HELD_Z:
            continue
        if one.held_gain < -MUCH or one.held_z < -HELD_Z:
            continue
        if not _is_silent(quick, played, one):
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


def _is_silent(quick: Evidence, played: Round, one: Contender) -> bool:
    """Whether it does nothing in what is held out. What it gains there would not tell: that is what
    the nuisances do that were fitted beside it."""
    model, base = one.found.model, played.base.model
    own = {one.effect, *(model.effects.keys() - base.effects.keys())}
    try:
        less = model.without(*own)
    except EffectError:  # nothing is left that makes a rig
        return False
    (alone,) = quick.held_out([less])
    here, there = one.held.cost(played.sigma), alone.cost(played.sigma)
    return abs(there - here) < SILENT * here
