"""When a cause may be named: thresholds, fixed before any campaign that judges them.

A contender passes when its advantage over the base is beyond chance in blocks of the recording,
seen and held out, when it takes a real share of the held-out cost, and when its size is worth a
name on this rig. Smaller ones are there, but no more than what every rig has beside its drawing:
they are absorbed into the base and told in a note.

What a simulation may miss and still be right is in `allowance`.
"""

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Errors, Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.contenders import Contender
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import HALF_PERIOD_S, MASS
from sim_rig.effects import find_effect
from sim_rig.model import Model

SEEN_Z, HELD_Z = 4.0, 3.0
HELD_GAIN, SECOND_GAIN, FURTHER_GAIN = 0.004, 0.04, 0.05
"""Of the held-out cost: of the first cause, of a second one, and where little is wrong any more."""
COASTING_GAIN = 0.008
"""Of both parts, beside a load that coasts."""
GIVES_Z = 8.5
"""What a spring stands beyond chance, seen and held out together, where all is right already: of a
rig with nothing wrong and a load that coasts one took 19 and 15 % at z of 5.2 and 5.1, together
7.3. Of five couplings the least sure stood at 10.5."""
FAR_OUT_Z = 15.0
"""Beyond chance on what was seen, of a spring that need not take much of the rest beside a load
that coasts. Of rigs with nothing wrong one stood at 5.2; a coupling of 0.012 rad/N m took 16 % at
24."""
COUPLING, CREEPS = "coupling_compliance", 0.5
"""A coupling, and the damping ratio of one that does not ring. Of five that were there it was 0.03
to 0.04, as in steel; rubber has a tenth. Beside a shaft that gives way before it slides one of 13
took 16 % of what was seen and held out."""
MOST_CAUSES = 3
MOST_OF_IT, MUCH = 0.5, 0.1
"""Who explains so much of what was seen need not be as sure on the rest."""
RIGHT, RIGHT_ALREADY = 1.1, 0.7
"""Largest misfit, in what a right simulation may miss, of a simulation that is called right; and
that below which one needs good reasons for a further cause."""
HALF, A_FIFTH = 0.5, 0.2
LINES = frozenset({"cogging", "torque_ripple"})
"""A line at an order of the shaft is like nothing else, so that their sizes are low: from little
more than what every rig of the trials has beside its drawing (0.13 mN m) to six times that, by the
rig's torque. Half of them is not enough."""
FRICTION, GAIN = "load_friction", "proportional_gain_error"
WITHIN = frozenset(
    {
        "coulomb",
        "viscous",
        "current_loop_lag",
        "velocity_filter_lag",
        "transport_delay",
        GAIN,
        FRICTION,
    }
)
"""What every rig has up to nearly such a size (a gain where the loop is stiff): half of it is no
cause, however much its shape may gain where little is wrong. So is a gap, but a little of that is
one (`gap`)."""

WARMS = frozenset({"thermal_torque_constant", "thermal_friction"})
"""What is held out comes last, and has most of it."""
WARM_MAGNETS, FORETOLD_Z = "thermal_torque_constant", 10.0
"""Of friction another speed would do the same as warmth."""


GIVE, NOTED = 0.1, 0.5
"""Every shaft and face gives way: worth a name where that takes so much of the held-out cost, and
where a simulation without it has so much of the misfit that a right one may have; a face with a
mass behind it, more (`RIGHT_ALREADY`): of rigs with nothing wrong and a motor that feels the load
two had 0.52 and 0.55. Where the motor feels nothing of it all must not be right: one had 0.71."""


FELT = 0.0075
"""Of the inertia, that a load must have to be a cause beside what it carries: the motor feels
nothing of a lighter one, which every rig has, and which coasts (`coasting`)."""


def is_material(model: Model, effect: str, scales: Scales, held_gain: float = 0.0) -> bool:
    """Whether an effect of that strength is worth a name on this rig.

    Half of it is enough where the effect takes a fifth of all that is wrong, and where half of it
    is more than what every fit has free.
    """
    sizes = material_sizes(scales)
    if effect == VEHICLE and beyond_belief(model, FRICTION, scales) >= sizes[FRICTION]:
        return is_felt(model)  # its mass is the cause, and what gives way is beside
    if effect in SPRINGS and held_gain < GIVE:
        return False
    size = sizes.get(effect, 0.0)
    within = LINES | WITHIN
    if effect == GAIN and HALF * size > HALF_PERIOD_S * scales.integral_per_s:
        within -= {GAIN}
    enough = HALF if held_gain > A_FIFTH and effect not in within else 1.0
    return beyond_belief(model, effect, scales) >= enough * size


def beyond_belief(model: Model, effect: str, scales: Scales) -> float:
    """How much of its first strength a model has beside what the rig's file has; of a wave, across
    their phases."""
    size, params = strength_of(model, effect), dict(scales.believed).get(effect)
    if params is None:
        return abs(size)
    believed = float(getattr(params, find_effect(effect).strengths[0]))
    turned = 0.0
    if "phase_rad" in params._fields and effect in model.effects:
        turned = float(model.effects[effect].phase_rad) - float(params.phase_rad)
    return float(abs(size * np.exp(1j * turned) - believed))


def is_felt(model: Model) -> bool:
    """Whether the motor feels the mass of the load behind its gap."""
    mass = float(getattr(model.effects.get(VEHICLE), MASS, 0.0))
    return mass > FELT * model.nominal.inertia_kg_m2


def is_noted(effect: str, misfit_before: Array, model: Model) -> bool:
    """Whether enough is wrong without an effect of a model: three free numbers of a spring fit
    anything, and a light load is behind every gap."""
    mass = RIGHT_ALREADY if is_felt(model) else RIGHT
    least = mass if effect == VEHICLE else NOTED
    return effect not in SPRINGS or float(misfit_before.max()) > least


def promises(contender: Contender) -> bool:
    """Whether a contender explains much of what no fit saw, whatever it does to what was seen."""
    return contender.held_gain > A_FIFTH and contender.held_z > HELD_Z


def passes_slowly(contender: Contender) -> bool:
    """Whether what takes longer than the recording is beyond chance: seen and held out together.

    It takes a small share of the cost, because the record shows but a part of it. What warms was
    fitted by its mean on what was seen, and shows on what came after that.
    """
    if contender.held_gain > HELD_GAIN and is_sure(contender):
        return True
    if contender.effect != WARM_MAGNETS:
        return False
    if contender.held_gain > HELD_GAIN and grows(contender.seen_z, contender.held_z):
        return True
    foretold = contender.held_z > FORETOLD_Z and contender.held_gain > FURTHER_GAIN
    return foretold and contender.seen_gain > HELD_GAIN


def grows(seen_z: float, held_z: float) -> bool:
    """Whether what warms is beyond chance: what was held out comes last, and says so.

    Of a number that is t of its deviations from nothing these are t/2: together they ask for 8. Two
    causes of 3.4 and 5.8 % stood at 1.9 and 2.3 seen, 3.6 and 4.0 held out. On 27 recordings of
    development seeds without one a single K_T that warms promised enough to be fitted, and stood at
    -0.9 and -1.3.
    """
    return seen_z > 0.5 * HELD_Z and held_z > HELD_Z and float(np.hypot(seen_z, held_z)) > SEEN_Z


def rings(model: Model) -> bool:
    """Whether the coupling of a model rings, where it has one; else its spring only stands beside a
    damper, which friction that was made too simple would fit."""
    coupling = model.effects.get(COUPLING)
    if coupling is None or not coupling.compliance_rad_per_nm > 0.0:
        return True
    behind = float(coupling.load_inertia_kg_m2)
    moved = behind * (1.0 - behind / model.nominal.inertia_kg_m2)
    per_s = 1.0 / np.sqrt(float(coupling.compliance_rad_per_nm) * moved)
    return bool(0.5 * float(coupling.damping_s) * per_s < CREEPS)


def passes_beside_coasting(contender: Contender, *, right: bool) -> bool:
    """Whether a contender is beyond chance beside a load that coasts, and nothing else.

    Where the load goes in its gap is most of the cost there, so that what stands far out in both
    parts need not take much of it. A spring must, which fits a part of whatever the load does, or
    stand far out; and so must what every rig has up to nearly a cause's size, of what was seen.
    """
    if contender.effect in SPRINGS:
        return passes(contender, right=right) or stands_far_out(contender)
    least_gain = min(contender.seen_gain, contender.held_gain)
    sure = contender.seen_z > SEEN_Z and contender.held_z > HELD_Z and least_gain > COASTING_GAIN
    if contender.effect in WITHIN:
        return passes(contender, right=right) or (sure and contender.seen_gain > MUCH)
    return sure


def stands_far_out(contender: Contender) -> bool:
    """Whether a spring takes much of what was seen and stands far out there, and is beyond chance
    in the rest as well."""
    seen = contender.seen_gain > GIVE and contender.seen_z > FAR_OUT_Z
    seen = seen and rings(contender.found.model)
    return seen and contender.held_gain > COASTING_GAIN and contender.held_z > HELD_Z


def is_sure(contender: Contender) -> bool:
    """Beyond chance on both together, where neither speaks against it."""
    least_z = min(contender.seen_z, contender.held_z)
    return bool(least_z > 0.5 * HELD_Z and together(contender) > np.hypot(SEEN_Z, HELD_Z))


def together(contender: Contender) -> float:
    """Beyond chance on what was seen and on what was held out."""
    return float(np.hypot(contender.seen_z, contender.held_z))


def passes(contender: Contender, *, named: int = 0, right: bool = False) -> bool:
    """Whether a contender is beyond chance; a coupling that does not ring is none.

    `named` causes are in the base already; `right`: it misses no more than it may.
    """
    if not rings(contender.found.model):
        return False
    if right and contender.effect in SPRINGS and together(contender) < GIVES_Z:
        return False
    least = FURTHER_GAIN if right else SECOND_GAIN if named else HELD_GAIN
    much = min(contender.seen_gain, contender.held_gain) > MUCH
    takes_most = contender.seen_gain > MOST_OF_IT or much
    if takes_most and contender.held_gain > FURTHER_GAIN and is_sure(contender):
        return True
    return (
        contender.seen_z > SEEN_Z
        and contender.held_z > HELD_Z
        and contender.held_gain > least
        and contender.seen_gain > HELD_GAIN
    )


def misfit(evidence: Evidence, errors: Errors, beside: Array | float = 0.0) -> Array:
    """Every signal's robust deviation over what a right simulation may miss, shape (signals,).

    `beside` is what this one may miss more, in the signals' units.
    """
    robust = errors.robust()
    return np.asarray(robust / np.hypot(evidence.allowed, beside))


def strength_of(model: Model, effect: str) -> float:
    """The first strength of an effect in a model."""
    params = model.effects.get(effect)
    return float(getattr(params, find_effect(effect).strengths[0])) if params is not None else 0.0
