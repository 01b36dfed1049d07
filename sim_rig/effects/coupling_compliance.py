"""Coupling compliance: the shaft behind the motor twists, and what it turns is a second mass.

    tau = k (theta - theta_c + h (omega - omega_c)),   k = 1/c,   (J - J_c) | k, k h | J_c | gap

c    compliance_rad_per_nm   one over the coupling's stiffness; zero is rigid
h    damping_s               damping over stiffness
J_c  load_inertia_kg_m2      that share of the total inertia which lies behind the coupling

A held motor leaves J_c at f_antiresonance = sqrt(k / J_c) / 2 pi, a free one lets both ring at
f_resonance = sqrt(k (1/(J - J_c) + 1/J_c)) / 2 pi. The gap lies behind J_c, and the load's encoder
behind the gap: as c goes to zero this becomes the rig that it was, with all of J before the gap.
An inertia behind the gap is another cause (see contact), and both together are three bodies.
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
    port=Port.COUPLING,
    params=Params,
    law=law,
    sample={"compliance_rad_per_nm": 5e-3, "damping_s": 3e-4},
    shows="ringing at the resonance in the motor's velocity, and on either side of the gap",
    confused_with=("contact", "pre_sliding", "current_loop_lag", "backlash_width"),
    source="Leonhard, Control of Electrical Drives (2001), ch. 10; Ellis, Lorenz, IAS (2000)",
)
