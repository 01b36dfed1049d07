"""Every strength that can be hidden. Zero is off, exactly; then nothing else of the effect acts.

A limit and a stiffness are held as reciprocals. Fields that are no strength (orders, phases, time
constants) act only beside theirs. The equations stand in `drive`, `mechanics`, `transmission`,
and `sensors`, each where it acts; ranges and names in `catalogue`.
"""

from typing import NamedTuple


class Effects(NamedTuple):
    """What is wrong with the axis, in SI units; w: motor velocity, th, th_l: motor, load angle."""

    # drive: from telegram to current
    transport_delay_s: float = 0.0
    clock_skew: float = 0.0  # command k acts at t_k (1 + skew) of the recorder's clock
    missed_probability: float = 0.0  # per telegram: the one before is held
    command_jitter_s: float = 0.0
    command_resampling_s: float = 0.0
    command_deadband_rad_s: float = 0.0  # taken off the size of the command
    command_scale_error: float = 0.0
    command_offset_rad_s: float = 0.0
    command_slew_s2_per_rad: float = 0.0
    velocity_filter_s: float = 0.0
    velocity_hold_s: float = 0.0  # velocity is formed over, and then held for, this long
    proportional_gain_error: float = 0.0
    integral_gain_error: float = 0.0
    integrator_clamp_per_a: float = 0.0
    integrator_leak_per_s: float = 0.0
    anti_windup_per_s: float = 0.0
    friction_feedforward_a: float = 0.0
    notch_depth: float = 0.0
    notch_hz: float = 80.0
    current_limit_per_a: float = 0.0
    supply_sag_s_per_rad: float = 0.0
    current_lag_s: float = 0.0
    dead_time_v: float = 0.0
    # torque at the rotor
    torque_constant_error: float = 0.0
    torque_constant_droop_per_a2: float = 0.0
    torque_constant_drift: float = 0.0
    torque_constant_drift_s: float = 300.0
    torque_ripple: float = 0.0
    torque_ripple_order: float = 24.0
    torque_ripple_phase_rad: float = 0.0
    cogging_nm: float = 0.0
    cogging_order: float = 24.0
    cogging_phase_rad: float = 0.0
    gear_mesh_nm: float = 0.0
    gear_mesh_order: float = 17.37
    inertia_error: float = 0.0
    # friction at the rotor
    coulomb_nm: float = 0.0
    viscous_nm_s_per_rad: float = 0.0
    stribeck_nm: float = 0.0
    stribeck_velocity_rad_s: float = 0.5
    presliding_rad: float = 0.0  # deflection at break-away
    friction_asymmetry_nm: float = 0.0  # more forwards, less backwards
    friction_load_share: float = 0.0
    friction_swing_nm: float = 0.0
    friction_swing_phase_rad: float = 0.0
    friction_drift: float = 0.0
    friction_drift_s: float = 300.0
    air_drag_nm_s2_per_rad2: float = 0.0
    hysteresis_brake_nm: float = 0.0
    hysteresis_brake_rad: float = 0.3
    # from rotor to load
    backlash_error_rad: float = 0.0
    backlash_swing_rad: float = 0.0
    backlash_swing_phase_rad: float = 0.0
    backlash_warming: float = 0.0
    backlash_warming_s: float = 60.0
    contact_softness_rad15_per_nm: float = 0.0
    contact_damping_s_per_rad: float = 0.0
    coupling_compliance_rad_per_nm: float = 0.0  # between rotor and gap
    coupling_share: float = 0.3  # of the inertia, on the gap's side of it
    slip_per_nm: float = 0.0
    load_inertia_kg_m2: float = 0.0  # so much of the whole sits behind the gap
    load_friction_nm: float = 0.0
    load_torque_nm: float = 0.0
    gravity_nm: float = 0.0
    gravity_phase_rad: float = 0.0
    # load encoder
    creep_rad_per_nm: float = 0.0
    creep_s: float = 0.4
    eccentricity_rad: float = 0.0
    eccentricity_phase_rad: float = 0.0
    misalignment_rad: float = 0.0
    subdivision_rad: float = 0.0
    subdivision_lines: float = 512.0
    quantum_rad: float = 0.0
    vibration_rad: float = 0.0
    vibration_hz: float = 23.0
    bit_errors_per_s: float = 0.0


NONE = Effects()
