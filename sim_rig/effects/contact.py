"""Contact: the faces of the gap give way, and the load becomes a mass of its own.

    tau = k (p + h dp/dt) while p = |theta - theta_l| - W/2 > 0 and tau > 0,      k = 1 / c
    w' = w / (1 + e w) as a face is left with w

c    compliance_rad_per_nm   of the faces; zero is rigid, and then the load has no mass
h    damping_s               damping over stiffness
e    restitution_slope_s_per_rad   by which a blow's restitution falls with its speed
J_l  load_inertia_kg_m2      that share of the total inertia which lies behind the gap

Faces push and never pull. With coupling_compliance the two springs lie in series.

A spring and damper give back the same share of every blow; real faces give back nearly all of a
slow one and less of a fast one, 1 - alpha w (Goldsmith, Impact, 1960). Hunt and Crossley's damping,
which grows with the force, has alpha = 2/3 of theirs over the stiffness; a face that takes nothing
but e has 1/(1 + e w), which is that of small blows, and that of theirs within 3 % up to w = 1/e.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero compliance switches it off."""

    compliance_rad_per_nm: Annotated[float, LogUniform(2e-4, 0.1)] = 0.0
    damping_s: Annotated[float, LogUniform(1e-6, 1e-3)] = 1e-4
    load_inertia_kg_m2: Annotated[float, Known(1e-7, 1e-3)] = 5e-6
    restitution_slope_s_per_rad: Annotated[float, LogUniform(1e-2, 1.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """(compliance, compliance x damping time, load inertia, slope of the restitution)."""
    return (
        p.compliance_rad_per_nm,
        p.compliance_rad_per_nm * p.damping_s,
        p.load_inertia_kg_m2,
        p.restitution_slope_s_per_rad,
    )


EFFECT = Effect(
    port=Port.TRANSMISSION,
    params=Params,
    law=law,
    sample={"compliance_rad_per_nm": 2e-3, "damping_s": 5e-4},
    shows="bursts of 1 to 10 ms after each engagement",
    confused_with=("coupling_compliance", "backlash_width", "load_friction"),
    source="Nordin, Gutman, Automatica 38 (2002); Hunt, Crossley, J. Appl. Mech. 42 (1975)",
)
