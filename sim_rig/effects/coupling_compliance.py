"""Coupling compliance: the shaft between motor and load twists, and the load is a second mass.

    theta_twist = c tau,      f_antiresonance = sqrt(1 / (c J_l)) / 2 pi

c    compliance_rad_per_nm   one over the coupling's stiffness; zero is rigid
h    damping_s               damping over stiffness
J_l  load_inertia_kg_m2      that share of the total inertia which lies behind the coupling

In series with the gap, and with the compliance of the gap's faces (see contact), which differs
by a far lighter mass behind it and far more damping.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero compliance switches it off."""

    compliance_rad_per_nm: Annotated[float, LogUniform(5e-4, 0.05)] = 0.0
    damping_s: Annotated[float, LogUniform(1e-6, 1e-3)] = 2e-5
    load_inertia_kg_m2: Annotated[float, Known(1e-6, 1e-3)] = 5e-5


def law(s: Any, p: Params) -> Any:
    """(compliance, compliance x damping time, load inertia)."""
    return (
        p.compliance_rad_per_nm,
        p.compliance_rad_per_nm * p.damping_s,
        p.load_inertia_kg_m2,
    )


EFFECT = Effect(
    port=Port.TRANSMISSION,
    params=Params,
    law=law,
    sample={"compliance_rad_per_nm": 5e-3, "damping_s": 3e-4},
    shows="ringing at the resonance; with a gap its frequency depends on amplitude",
    confused_with=("contact", "pre_sliding", "current_loop_lag", "backlash_width"),
    source="Nordin, Gutman, Automatica 38 (2002)",
)
