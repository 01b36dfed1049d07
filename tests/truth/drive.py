"""The digital drive: telegram and counts in, current out, once per loop period T.

    r     deadband, scale, offset, slew of the telegram's velocity
    w~    (n_k - n_(k-1)) q / T, n: counts of the motor encoder; formed over velocity_hold_s where
          that is longer, then filtered
    x     += T (K_I (r - w~) - back-calculation of what the limit cut off), leaking, clamped
    i*    K_P (r - w~) + x + feedforward, notch, supply sag, limit
    i     first-order lag behind i*, less what the inverter's dead time takes

Dead time is a voltage against the current's sign; of it the current loop lets through a pulse at
each change of sign, RIPPLE_A_PER_V high and ELECTRICAL_S long (L/R of the winding).
"""

import math
from typing import NamedTuple

from tests.truth.compiling import law
from tests.truth.effects import Effects
from tests.truth.nuisances import Nuisances

ELECTRICAL_S = 1.25e-3
RIPPLE_A_PER_V = 0.12
CROSSOVER_A = 0.05
"""The current over which parasitic capacitance smears the change of sign."""

NOTCH_QUALITY = 1.0


class Rig(NamedTuple):
    """The nominal values, as the drive was tuned to them."""

    torque_constant_nm_per_a: float
    inertia_kg_m2: float
    proportional_gain_a_s_per_rad: float
    integral_gain_a_per_rad: float
    backlash_gap_rad: float


class Drive(NamedTuple):
    """What the loop remembers from one period to the next."""

    telegram_rad_s: float  # NaN: power stage off
    next_pick_s: float
    command_rad_s: float
    counts: float
    window_s: float
    measured_rad_s: float
    filtered_rad_s: float
    integral_a: float
    cut_off_a: float
    notch_low_a: float
    notch_band_a: float
    reference_a: float


AT_REST = Drive(math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@law
def shaped_command(nuisances: Nuisances, effects: Effects, before: float, telegram: float) -> float:
    """What the loop makes of a telegram; `before`: what it made of the last."""
    size = max(0.0, abs(telegram) - effects.command_deadband_rad_s)
    command = math.copysign(size, telegram) * (1.0 + effects.command_scale_error)
    command += effects.command_offset_rad_s
    if effects.command_slew_s2_per_rad > 0.0:
        step = nuisances.loop_period_s / effects.command_slew_s2_per_rad
        command = before + min(max(command - before, -step), step)
    return command


@law
def taken_up(drive: Drive, telegram_rad_s: float, next_pick_s: float) -> Drive:
    """The drive with its latest telegram."""
    return Drive(
        telegram_rad_s,
        next_pick_s,
        drive.command_rad_s,
        drive.counts,
        drive.window_s,
        drive.measured_rad_s,
        drive.filtered_rad_s,
        drive.integral_a,
        drive.cut_off_a,
        drive.notch_low_a,
        drive.notch_band_a,
        drive.reference_a,
    )


@law
def measured(
    nuisances: Nuisances, effects: Effects, drive: Drive, motor_rad: float
) -> tuple[float, float, float, float]:
    """Count, age of the velocity's window, velocity from counts, filtered velocity."""
    period = nuisances.loop_period_s
    quantum = math.tau / nuisances.motor_counts_per_revolution
    count = float(math.floor(motor_rad / quantum))
    window = drive.window_s + period
    velocity = drive.measured_rad_s
    if window > effects.velocity_hold_s - 0.5 * period:
        velocity = (count - drive.counts) * quantum / window
        window = 0.0
    else:
        count = drive.counts
    filtered = velocity
    if effects.velocity_filter_s > 0.0:
        share = 1.0 - math.exp(-period / effects.velocity_filter_s)
        filtered = drive.filtered_rad_s + share * (velocity - drive.filtered_rad_s)
    return count, window, velocity, filtered


@law
def integrated(rig: Rig, effects: Effects, drive: Drive, error: float, period: float) -> float:
    """The integrator after a period."""
    integral = drive.integral_a + period * (
        rig.integral_gain_a_per_rad * (1.0 + effects.integral_gain_error) * error
        - effects.anti_windup_per_s * drive.cut_off_a
        - effects.integrator_leak_per_s * drive.integral_a
    )
    if effects.integrator_clamp_per_a > 0.0:
        bound = 1.0 / effects.integrator_clamp_per_a
        integral = min(max(integral, -bound), bound)
    return integral


@law
def notched(
    effects: Effects, drive: Drive, wanted: float, period: float
) -> tuple[float, float, float]:
    """What the notch leaves, and its memory: a state-variable filter by the trapezoidal rule."""
    if effects.notch_depth == 0.0:
        return wanted, 0.0, 0.0
    g = math.tan(math.pi * effects.notch_hz * period)
    gain = 1.0 / (1.0 + g * (g + 1.0 / NOTCH_QUALITY))
    passed = gain * (drive.notch_band_a + g * (wanted - drive.notch_low_a))
    settled = drive.notch_low_a + g * passed
    left = wanted - effects.notch_depth * passed / NOTCH_QUALITY
    return left, 2.0 * settled - drive.notch_low_a, 2.0 * passed - drive.notch_band_a


@law
def limited(effects: Effects, wanted: float, w: float) -> float:
    """What the power stage can give of it."""
    reference = wanted * max(0.0, 1.0 - effects.supply_sag_s_per_rad * abs(w))
    if effects.current_limit_per_a > 0.0:
        bound = 1.0 / effects.current_limit_per_a
        reference = min(max(reference, -bound), bound)
    return reference


@law
def control(
    rig: Rig, nuisances: Nuisances, effects: Effects, drive: Drive, motor_rad: float, w: float
) -> Drive:
    """One period of the loop; with the power stage off it only counts."""
    period = nuisances.loop_period_s
    telegram, pick = drive.telegram_rad_s, drive.next_pick_s
    count, window, velocity, filtered = measured(nuisances, effects, drive, motor_rad)
    if math.isnan(telegram):
        return Drive(
            telegram, pick, 0.0, count, window, velocity, filtered, 0.0, 0.0, 0.0, 0.0, 0.0
        )
    command = shaped_command(nuisances, effects, drive.command_rad_s, telegram)
    error = command - filtered
    integral = integrated(rig, effects, drive, error, period)
    proportional = rig.proportional_gain_a_s_per_rad * (1.0 + effects.proportional_gain_error)
    wanted = proportional * error + integral
    if effects.friction_feedforward_a > 0.0 and command != 0.0:
        wanted += math.copysign(effects.friction_feedforward_a, command)
    wanted, low, band = notched(effects, drive, wanted, period)
    reference = limited(effects, wanted, w)
    return Drive(
        telegram,
        pick,
        command,
        count,
        window,
        velocity,
        filtered,
        integral,
        wanted - reference,
        low,
        band,
        reference,
    )


@law
def dead_time(effects: Effects, current: float, followed: float, h: float) -> tuple[float, float]:
    """What dead time adds to the current's reference, and the voltage the loop has learnt."""
    if effects.dead_time_v == 0.0:
        return 0.0, 0.0
    taken = effects.dead_time_v * min(max(current / CROSSOVER_A, -1.0), 1.0)
    followed += (1.0 - math.exp(-h / ELECTRICAL_S)) * (taken - followed)
    return -RIPPLE_A_PER_V * (taken - followed), followed
