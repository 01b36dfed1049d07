"""How large an effect is on a rig: the smallest size worth a name, and the sizes that are tried.

Sizes follow the rig and the excitation: tau, omega, i are rms torque, speed and current of the
nominal rig under this command; V the largest command and dV the rms of its jumps; W the gap; J the
inertia. What magnets and friction have of their own goes with what the motor is rated for instead,
whatever the excitation asks of it: tried sizes reach down to what is worth a name, and torques up
to the largest that a rig has of its own.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.unknowns import HALF_PERIOD_S, USUAL_RAD_S
from sim_rig.effects.effect import Effect

REACH = 0.3, 1.5
"""Of a trial's size: what its template tells of (see `screening`)."""
STEEP = frozenset({"contact", "coupling_compliance", "clock_skew"})
"""What is sought from trials at their own size (none has a phase)."""
OWN = frozenset(
    {
        *("coulomb", "stribeck", "pre_sliding", "asymmetric_friction", "thermal_friction"),
        *("load_friction", "load_torque"),
    }
)
"""Torques that a rig has of its own."""
OWN_MOST = 0.6
"""Of the rig's torque (a tenth of what it is rated for): friction of a dry seal or a worn gear."""
QUANTILES = (0.5, 0.66, 0.83)
"""Of a prior's range by its logarithm: sizes of an effect that says nothing else."""


def material_sizes(s: Scales) -> dict[str, float]:
    """The smallest strength of each effect that is worth a name on this rig, in SI."""
    tau, gap = s.rig_torque_nm, s.gap_rad
    return {
        "coulomb": 0.045 * tau,
        "viscous": 0.0055 * tau / USUAL_RAD_S,
        "stribeck": 0.03 * tau,
        "pre_sliding": 0.08 * tau,
        "asymmetric_friction": 0.01 * tau,
        "position_friction": 0.02 * tau,
        "thermal_friction": 0.02 * tau,
        "load_dependent_friction": 0.012,
        "cogging": 0.0075 * tau,
        "torque_ripple": 0.002,
        "torque_constant_error": 0.0125,
        "inertia_error": 0.0125,
        "proportional_gain_error": max(0.0125, 1.1 * HALF_PERIOD_S * s.integral_per_s),
        "integral_gain_error": 0.0125,
        "torque_constant_droop": 0.01 / s.strongest_a**2,
        "thermal_torque_constant": 0.025,
        "anti_windup": 3.0,
        "gravity_imbalance": 0.01 * tau,
        "load_torque": 0.01 * tau,
        "load_friction": 0.05 * tau,
        "inverter_dead_time": 0.01 * s.current_a * tau / s.torque_nm,
        "current_loop_lag": 1.1e-4,
        "velocity_filter_lag": 2.6e-4,
        "transport_delay": 1.4e-4,
        "command_scale": 1e-3,
        "command_offset": 0.003 * s.command_rad_s,
        "command_deadband": 0.008 * s.command_rad_s,
        "command_slew": 5e-4 / s.jump_rad_s,
        "clock_skew": 2e-6,
        "backlash_width": 1.05 * min(1e-3, 0.05 * gap),
        "position_backlash": 0.02 * gap,
        "encoder_eccentricity": 1.5e-4,
        "misalignment": 6e-3,
        "encoder_subdivision": 1e-5,
    }


def trial_sizes(effect: Effect, s: Scales) -> tuple[float, ...]:
    """What its first strength is tried at, in SI, signed where that is."""
    return tuple(_reaching(effect, _usual(effect, s), s))


def _usual(effect: Effect, s: Scales) -> tuple[float, ...]:
    tau, gap = s.torque_nm, s.gap_rad
    table: dict[str, tuple[float, ...]] = {
        "coulomb": (0.1 * tau, 0.3 * tau, 0.8 * tau),
        "viscous": tuple(k * tau / s.speed_rad_s for k in (0.01, 0.05, 0.2)),
        "stribeck": (0.05 * tau, 0.2 * tau),
        "pre_sliding": (0.1 * tau, 0.4 * tau),
        "asymmetric_friction": (-0.05 * tau, 0.05 * tau),
        "position_friction": (0.05 * tau, 0.2 * tau),
        "thermal_friction": (0.1 * tau, 0.3 * tau),
        "load_dependent_friction": (0.03, 0.1),
        "cogging": (0.05 * tau, 0.3 * tau),
        "torque_ripple": (0.03,),
        "torque_constant_error": (-0.08, -0.03, 0.03, 0.08),
        "inertia_error": (-0.2, -0.06, 0.06, 0.2),
        "torque_constant_droop": tuple(k / s.strongest_a**2 for k in (0.05, 0.2)),
        "thermal_torque_constant": (0.05,),
        "current_limit": tuple(1.0 / current for current in (*s.peaks_a, *s.currents_a)),
        "proportional_gain_error": (-0.1, -0.03, 0.03, 0.1),
        "integral_gain_error": (-0.15, -0.04, 0.04, 0.15),
        "integrator_clamp": (
            *(k / s.integral_a[2] for k in (0.35, 0.5, 0.8, 1.3, 2.4, 4.0)),
            *(k / s.integral_peak_a for k in (1.05, 1.12, 1.25) if s.integral_peak_a > 0.0),
        ),
        "anti_windup": (30.0, 300.0),
        "current_loop_lag": (2e-4, 8e-4),
        "velocity_filter_lag": (4e-4, 1.5e-3),
        "inverter_dead_time": (0.03 * s.current_a, 0.15 * s.current_a),
        "transport_delay": (3e-4, 1.5e-3, 5e-3),
        "command_slew": tuple(duration / s.jump_rad_s for duration in (1e-3, 3e-3, 8e-3)),
        "command_deadband": tuple(k * s.command_rad_s for k in (0.03, 0.1, 0.25)),
        "command_scale": (-0.005, 0.005),
        "command_offset": tuple(k * s.command_rad_s for k in (-0.1, -0.02, 0.02, 0.1)),
        "clock_skew": (-5e-5, -1e-5, 1e-5, 5e-5),
        "backlash_width": (-0.2 * gap, -0.06 * gap, 0.06 * gap, 0.2 * gap),
        "position_backlash": (0.1 * gap, 0.3 * gap),
        "contact": tuple(c * s.yielding for c in (2e-3, 2e-2, 0.1)),
        "coupling_compliance": tuple((s.yielding * np.geomspace(1e-3, 6e-2, 24)).tolist()),
        "load_friction": (0.05 * tau, 0.25 * tau),
        "load_torque": (-0.25 * tau, -0.05 * tau, 0.05 * tau, 0.25 * tau),
        "gravity_imbalance": (0.1 * tau, 0.4 * tau),
        "encoder_eccentricity": (1e-3,),
        "misalignment": (0.03,),
        "encoder_subdivision": (1e-4,),
    }
    if effect.name in table:
        return table[effect.name]
    prior = effect.parameters[0].prior
    if prior.least == 0.0 < prior.low:
        ratio = prior.high / prior.low
        return tuple(prior.low * ratio**q for q in QUANTILES)
    return 0.3 * prior.low, 0.3 * prior.high


def _reaching(effect: Effect, usual: Sequence[float], s: Scales) -> Iterator[float]:
    """The usual sizes, and smaller and larger ones where an effect may be so and they do not tell.

    What has a phase is taken whole by its templates, at any size; but a weight on a load with a
    mass of its own, which saturates as others do, and has to be as large as its usual sizes there.
    """
    yield from usual
    if effect.name in STEEP or "phase_rad" in effect.params._fields:
        return
    (low, high), signs = REACH, {1.0 if size > 0.0 else -1.0 for size in usual}
    smallest, largest = min(map(abs, usual)), max(map(abs, usual))
    least = material_sizes(s).get(effect.name, low * smallest)
    while low * smallest > least:
        smallest *= low / high
        yield from (sign * smallest for sign in signs)
    while effect.name in OWN and high * largest < OWN_MOST * s.rig_torque_nm:
        largest *= high / low
        yield from (sign * largest for sign in signs)
