"""A load that goes on in its gap when the motor turns back: what no drawing tells of a light one.

The rigid play lets the load stand until a face comes. A real one coasts, slowed by its own
friction, w^2/(2 a) far at speed w, with a = friction/inertia: most of a gap at 5 rad/s. It reaches
the motor by next to nothing, so friction and inertia themselves are not told apart; a cause of
these names is one that the motor feels, and found before this is asked.
"""

import numpy as np

from servo_bench.diagnosis.evidence import Evidence
from servo_bench.diagnosis.gate import misfit
from servo_bench.diagnosis.hypotheses import yielding
from servo_bench.diagnosis.seeking import Found, seek
from servo_bench.diagnosis.unknowns import Unknown
from sim_rig.errors import EffectError
from sim_rig.model import Model

WRONG, RIGHT = 0.7, 1.0
"""Misfit of the twist from which on coasting is asked, and of the rest up to which."""
LIGHT = 0.003
"""Of the inertia: a load of which the motor feels next to nothing."""
SLOWED_RAD_S2 = (100.0, 170.0, 280.0, 460.0, 760.0, 1250.0, 2100.0, 3500.0)
FACE_RAD_PER_NM, FACE_S = 5e-3, 1e-4
"""A stiff face that takes most of a blow."""
WORTH_IT = 0.1
"""Least share of the cost that coasting takes, or it is not what is wrong."""
OTHERWISE = frozenset({"contact", "load_friction", "load_torque", "gravity_imbalance"})
"""Effects that give the load a motion of its own already."""


def with_coasting(whole: Evidence, final: Found) -> Found:
    """The same search with a coasting load beside, where only the twist is wrong; or as it was."""
    if not _twist_is_wrong(whole, final) or OTHERWISE & set(final.model.effects):
        return final
    models = []
    for slowed in SLOWED_RAD_S2:
        try:
            models.append(coasting(final.model, slowed))
        except EffectError:
            return final
    costs = [errors.cost(final.sigma) for errors in whole.seen(models)]
    start = models[int(np.argmin(costs))]
    unknowns = (*final.unknowns, *_own(start))
    found = seek(whole, start, unknowns, final.sigma, iterations=4, first=1)
    rested = whole.seen([final.model])[0].cost(final.sigma)
    better = found.errors.cost(final.sigma) < (1.0 - WORTH_IT) * rested
    return found if better else final


def coasting(model: Model, slowed_rad_s2: float) -> Model:
    """The model with a light load that is slowed so much in its gap."""
    inertia = LIGHT * model.nominal.inertia_kg_m2
    model = model.with_effect(
        "contact",
        compliance_rad_per_nm=FACE_RAD_PER_NM * yielding(model.nominal.inertia_kg_m2),
        load_inertia_kg_m2=inertia,
        damping_s=FACE_S,
    )
    return model.with_effect("load_friction", torque_nm=slowed_rad_s2 * inertia)


def is_coasting(model: Model) -> bool:
    """Whether a model has a load that coasts as a nuisance."""
    contact = model.effects.get("contact")
    light = LIGHT * model.nominal.inertia_kg_m2
    return contact is not None and contact.load_inertia_kg_m2 == light


def slowing_rad_s2(model: Model) -> float:
    """How fast the load is slowed in its gap."""
    inertia = model.effects["contact"].load_inertia_kg_m2
    return float(model.effects["load_friction"].torque_nm) / float(inertia)


def _own(model: Model) -> tuple[Unknown, ...]:
    friction = float(model.effects["load_friction"].torque_nm)
    most = 10.0 * max(SLOWED_RAD_S2) * LIGHT * model.nominal.inertia_kg_m2
    face = FACE_RAD_PER_NM * yielding(model.nominal.inertia_kg_m2)
    return (
        Unknown("load_friction", "torque_nm", 0.0, most, step=0.3 * friction),
        Unknown("contact", "compliance_rad_per_nm", 0.02 * face, 10.0 * face, step=0.4 * face),
        Unknown("contact", "damping_s", 0.0, 2e-3, step=FACE_S),
    )


def _twist_is_wrong(whole: Evidence, final: Found) -> bool:
    """Whether the twist is, and nothing else."""
    missed = misfit(whole, final.errors)
    twist = np.array([name.startswith("twist") for name in whole.names])
    if not twist.any():
        return False
    return bool(missed[twist].max() > WRONG and missed[~twist].max(initial=0.0) < RIGHT)
