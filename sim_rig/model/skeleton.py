"""The rig, step after step, without any effect: what the compiled page is made from.

Every line `# port NAME` is where the effects of that port are written in (see `page`); where that
is more than once, `# keep NAME` is where they take what they remember on. As it stands this is the
ideal rig, and runs.

Time stepping. The ideal loop is linear and is propagated exactly (see `propagator`). What effects
change is a deviation from it: an acceleration and an integrator rate, taken at the middle of the
step as the ideal loop and the deviations of the steps before predict it (an exponential midpoint
rule, second order, one evaluation a step). Without effects the deviations are exactly zero.

    deviation a = (tau - tau_contact) / J_true - K_T i_ideal / J,   q = dz/dt - (r - omega)

What the drive makes of a, and q, are smooth between jumps of the command, and are carried on as
straight lines: a limited current falls behind the ideal one at a constant rate. Where a face is
about to be met, or a limit to let go, steps are FINER times as fine for IMPACT_S.

Transmission. With no compliance the play is rigid: y <- min(max(y, theta - W/2), theta + W/2),
after every step and where the motor turned around within it; torques on the load reach the motor
while it pushes against them. With compliance the load is a mass behind the gap (see `contact`), and
what brakes it is found where it stops (see `holding`).

Slots are cut where a delayed command comes into force. Each piece has three parts: a look under
the command that now holds, the steps, and a look at the end.
"""

from math import (  # noqa: F401 - what laws may call in the page
    atan,
    atan2,
    ceil,
    copysign,
    cos,
    exp,
    expm1,
    floor,
    hypot,
    log,
    sin,
    sqrt,
    tan,
)

import numpy as np
from numpy.typing import NDArray

from sim_rig.model.contact import meet, piece_of, sprung, swung, twisted
from sim_rig.model.holding import ATTEMPTS, HELD, nearer
from sim_rig.model.lesser import greater, lesser
from sim_rig.model.play import reach, share_pushed
from sim_rig.model.propagator import propagator

CLOSED, MECHANICS, MOTION = 0, 1, 2
QUEUE = 64
HEAD = 16
IMPACT_S, FINER = 1e-4, 8
"""An impact's steps are so many times finer, for so long (two whole steps at least)."""
MEMORY = HEAD + 2 * QUEUE


def run(  # noqa: PLR0912, PLR0915, PLR0917 - one page to be read from top to bottom
    rig: NDArray[np.float64],
    parameters: NDArray[np.float64],  # noqa: ARG001 - for laws
    state: NDArray[np.float64],
    slot_commands_rad_s: NDArray[np.float64],
    slot_durations_s: NDArray[np.float64],
    given: NDArray[np.float64],
    mode: int,
    longest_step_s: float,
    rows: NDArray[np.float64],
) -> bool:
    """Play slots from `state`, which is left at the end; False if the command queue overflowed.

    rig: K_T, J, K_P, K_I, W. A command that is NaN means: power stage off. given, shape (slots, 4):
    current and its slope (mode MECHANICS), or angle, velocity, acceleration, and its slope (mode
    MOTION) of the motor at and after each slot's start. rows, shape (slots, 8): what is recorded
    at each slot's end.
    """
    # parameters
    # memory
    torque_constant_nm_per_a, nominal_inertia_kg_m2 = rig[0], rig[1]
    proportional_gain_a_s_per_rad, integral_gain_a_per_rad = rig[2], rig[3]
    nominal_gap_rad = rig[4]
    theta, omega, z, load, load_rate = state[0], state[1], state[2], state[3], state[4]
    drive, clock, slot, contact_torque_nm = state[5], state[6], state[7], state[8]
    waiting, hub, hub_rate = floor(state[9]), state[10], state[11]
    measured_motor_angle_rad, measured_current_a, measured_load_angle_rad = 0.0, 0.0, 0.0
    load_velocity_rad_s = load_rate
    complete = True

    inertia_kg_m2 = nominal_inertia_kg_m2
    # port inertia_kg_m2
    compliance, damping, load_inertia, slope = 0.0, 0.0, 0.0, 0.0  # damping: time x compliance
    # port transmission
    shaft_compliance, shaft_damping, hub_inertia = 0.0, 0.0, 0.0
    # port coupling
    two_masses, coupled = compliance > 0.0, shaft_compliance > 0.0
    damping_s = damping / compliance if two_masses else 0.0
    shaft_s = shaft_damping / shaft_compliance if coupled else 0.0
    shaft = 1.0 / shaft_compliance if coupled else 0.0
    face = 1.0 / compliance if two_masses else 0.0
    per_load = 1.0 / load_inertia if two_masses else 0.0
    motor_inertia = inertia_kg_m2
    motor_inertia -= load_inertia if two_masses else 0.0
    motor_inertia -= hub_inertia if coupled else 0.0
    per_motor, per_hub = 1.0 / motor_inertia, 1.0 / hub_inertia if coupled else 0.0
    per_twist = per_hub if mode == MOTION else per_hub + per_motor
    per_driver = per_hub if coupled else 0.0 if mode == MOTION else per_motor
    per_mass = per_load + per_driver
    moved_kg_m2 = 1.0 / per_mass if two_masses else 0.0
    wound_kg_m2 = 1.0 / per_twist if coupled else 0.0
    face_delta, face_square, face_soft = 0.0, 0.0, 0.0
    if two_masses:
        face_delta, face_square, face_soft = sprung(per_mass, face, damping_s)
    shaft_delta, shaft_square, shaft_soft = 0.0, 0.0, 0.0
    if coupled:
        shaft_delta, shaft_square, shaft_soft = sprung(per_twist, shaft, shaft_s)
    # what a spring does in half a step and in a whole one: c, s (see `contact`)
    bent_s, bent_c, bent_sine, pressed_s, pressed_c, pressed_sine = 0.0, 1.0, 0.0, 0.0, 1.0, 0.0
    half_c, half_sine, whole_c, whole_sine = 1.0, 0.0, 1.0, 0.0
    if not coupled:
        hub, hub_rate = theta, omega
    nominal_per_motor = 1.0 / nominal_inertia_kg_m2
    gap = state[12]
    acceleration, rate, apart = 0.0, 0.0, 0.0
    driven, jerk, change, wound, cut_before_a = 0.0, 0.0, 0.0, 0.0, 0.0

    for k in range(slot_commands_rad_s.size):
        slot_command_rad_s, slot_duration_s = slot_commands_rad_s[k], slot_durations_s[k]
        # port slot_duration_s
        command_delay_s = 0.0
        on = slot_command_rad_s == slot_command_rad_s  # noqa: PLR0124 - NaN is off
        if on:
            step_s, since_s, time_s = 0.0, slot_duration_s, clock
            # port slot_command_rad_s
            # port command_delay_s
        last_rad_s = state[HEAD + 2 * waiting - 1] if waiting > 0 else drive
        if not on or (command_delay_s <= 0.0 and waiting == 0):
            drive, waiting = slot_command_rad_s, 0
        elif slot_command_rad_s == last_rad_s:
            pass  # it comes no sooner than the same one before it
        elif waiting < QUEUE:
            due = greater(command_delay_s, 0.0)
            if waiting > 0:
                due = greater(due, state[HEAD + 2 * waiting - 2])
            state[HEAD + 2 * waiting], state[HEAD + 2 * waiting + 1] = due, slot_command_rad_s
            waiting += 1
        else:
            complete = False
        if mode == MOTION:
            theta, omega = given[k, 0], given[k, 1]
            if not coupled:
                hub, hub_rate = theta, omega
        elapsed = 0.0
        while True:
            while waiting > 0 and state[HEAD] <= elapsed:
                drive = state[HEAD + 1]
                waiting -= 1
                for j in range(2 * waiting):
                    state[HEAD + j] = state[HEAD + j + 2]
            until = lesser(slot_duration_s, state[HEAD]) if waiting > 0 else slot_duration_s
            piece = until - elapsed
            powered = drive == drive  # noqa: PLR0124 - NaN is off
            r = drive if powered and mode == CLOSED else 0.0
            sent = drive if powered else 0.0
            if not powered:
                z = 0.0
            loop_p, loop_i = 0.0, 0.0
            if powered and mode == CLOSED:
                loop_p, loop_i = proportional_gain_a_s_per_rad, integral_gain_a_per_rad
            per_a = torque_constant_nm_per_a * nominal_per_motor
            steps = ceil(piece / longest_step_s - 1e-9)
            h = piece / steps if steps > 0 else 0.0
            part, whole, fine, before_s, soon = 0, steps, 0, 0.0, False
            while part <= 2:
                # 0 look under this command, 1 steps, alike ones in a row, 2 look at the end
                if part == 1 and whole == 0 and fine == 0:
                    part = 2
                if part == 1 and soon and fine == 0:
                    held = ceil(IMPACT_S / lesser(h, 0.5 * IMPACT_S) - 1e-9)
                    held = held if held < whole else whole
                    whole, fine = whole - held, held * FINER
                step_s = 0.0 if part != 1 else h if fine == 0 else h / FINER
                since_s = 0.0 if part == 0 else 0.5 * (before_s + step_s)
                per_since = 1.0 / since_s if since_s > 0.0 else 0.0
                per_step = 1.0 / step_s if step_s > 0.0 else 0.0
                count = 1 if part != 1 or before_s != step_s else whole if fine == 0 else fine
                half_s = 0.5 * step_s
                lead_s, cube = 0.5 * before_s + 0.25 * step_s, step_s * step_s * step_s / 12.0
                before_s = step_s
                a11, a12, a21, a22, b11, b12, b21, b22, c11, c12 = propagator(
                    per_a * loop_p, per_a * loop_i, half_s
                )
                e11, e12, e21, e22, s11, s12, s21, s22, d11, d12 = propagator(
                    per_a * loop_p, per_a * loop_i, step_s
                )
                if two_masses and step_s > 0.0:
                    bent_s, pressed_s = piece_of(face_soft, half_s), piece_of(face_soft, step_s)
                    bent_c, bent_sine = swung(face_delta, face_square, bent_s)
                    pressed_c, pressed_sine = swung(face_delta, face_square, pressed_s)
                if coupled:
                    half_c, half_sine = swung(shaft_delta, shaft_square, half_s)
                    whole_c, whole_sine = swung(shaft_delta, shaft_square, step_s)
                done = 0
                while done < count:
                    done += 1
                    # the middle of the step
                    error = omega - r
                    lately, pulled = rate + lead_s * change, acceleration + lead_s * jerk
                    time_s = clock + elapsed + half_s  # noqa: F841 - for laws
                    motor_angle_rad = (
                        theta + (r * half_s + b11 * error + b12 * z) + (c11 * pulled + c12 * lately)
                    )
                    motor_velocity_rad_s = (
                        r + (a11 * error + a12 * z) + (b11 * pulled + b12 * lately)
                    )
                    integral_rad = (a21 * error + a22 * z) + (b21 * pulled + b22 * lately)
                    # what drives the gap: the motor, or what its coupling turns
                    driver, driver_rate, shaft_nm = motor_angle_rad, motor_velocity_rad_s, 0.0
                    if coupled:
                        x, v = theta - hub, omega - hub_rate
                        twist, twist_rate = twisted(
                            *(x, v, wound, shaft_delta, shaft_square, shaft_soft),
                            *(half_c, half_sine),
                        )
                        if mode != MOTION:
                            share = per_motor * wound_kg_m2
                            moment = share * (x + (v + 0.5 * wound * half_s) * half_s - twist)
                            motor_angle_rad -= moment
                            integral_rad += moment
                            motor_velocity_rad_s -= share * (v + wound * half_s - twist_rate)
                        driver, driver_rate = (
                            motor_angle_rad - twist,
                            motor_velocity_rad_s - twist_rate,
                        )
                        shaft_nm = shaft * (twist + shaft_s * twist_rate)
                    if two_masses:
                        load_angle_rad, load_velocity_rad_s = load, load_rate
                        if step_s > 0.0:
                            x, v = hub - load, hub_rate - load_rate
                            ahead, closing = meet(
                                *(x, v, apart, damping_s, slope),
                                *(face_delta, face_square, face_soft),
                                *(gap, half_s, bent_s, bent_c, bent_sine),
                            )
                            if mode != MOTION and not coupled:
                                share = per_motor * moved_kg_m2
                                moment = share * (x + (v + 0.5 * apart * half_s) * half_s - ahead)
                                motor_angle_rad -= moment
                                integral_rad += moment
                                motor_velocity_rad_s -= share * (v + apart * half_s - closing)
                                driver, driver_rate = motor_angle_rad, motor_velocity_rad_s
                            load_angle_rad, load_velocity_rad_s = (
                                driver - ahead,
                                driver_rate - closing,
                            )
                    else:
                        lowest, highest = driver - 0.5 * gap, driver + 0.5 * gap
                        load_angle_rad = lesser(greater(load, lowest), highest)
                        # pushed at the step's end, if not yet: its torque counts by its share
                        ahead = 2.0 * driver - hub - load
                        met = 0.5 * gap - 1e-12
                        pushed = (driver_rate > 0.0 and ahead >= met) or (
                            driver_rate < 0.0 and ahead <= -met
                        )
                        load_velocity_rad_s = driver_rate if pushed else 0.0
                    ideal_current = loop_p * (r - motor_velocity_rad_s) + loop_i * integral_rad
                    backlash_gap_rad = nominal_gap_rad
                    # port backlash_gap_rad
                    gap = backlash_gap_rad

                    # controller
                    command_rad_s = sent
                    # port command_rad_s
                    measured_velocity_rad_s = motor_velocity_rad_s
                    # port measured_velocity_rad_s
                    # port integral_rad
                    velocity_error_rad_s = command_rad_s - measured_velocity_rad_s
                    current_demand_a = (
                        proportional_gain_a_s_per_rad * velocity_error_rad_s
                        + integral_gain_a_per_rad * integral_rad
                    )
                    # port current_demand_a
                    if not powered:
                        current_demand_a = 0.0
                    current_command_a = current_demand_a
                    # port current_command_a
                    cut_a = current_demand_a - current_command_a
                    integral_rate_rad_s = velocity_error_rad_s
                    # port integral_rate_rad_s
                    current_a = current_command_a
                    # port current_a
                    if mode == MECHANICS:
                        current_a = given[k, 0] + given[k, 1] * (elapsed + half_s)

                    # mechanics
                    electric_torque_nm = torque_constant_nm_per_a * current_a
                    # port electric_torque_nm
                    motor_torque_nm = 0.0
                    # port motor_torque_nm
                    load_torque_nm = 0.0
                    # port load_torque_nm
                    torque = electric_torque_nm + motor_torque_nm

                    # transmission: what the load takes from the motor
                    if mode == MOTION:
                        acceleration = given[k, 2] + given[k, 3] * (elapsed + half_s)
                    else:
                        jerk = -driven
                        driven = (
                            electric_torque_nm * per_motor
                            - torque_constant_nm_per_a * ideal_current * nominal_per_motor
                        )
                        jerk = (jerk + driven) * per_since
                        acceleration = driven + motor_torque_nm * per_motor
                    pull, late, late_rad = acceleration, 0.0, 0.0
                    spun_nm, late_spun = 0.0, 0.0
                    free = acceleration if mode == MOTION else torque * per_motor
                    if two_masses:
                        outer = shaft_nm * per_hub if coupled else free
                        apart = outer - load_torque_nm * per_load
                        if step_s > 0.0:
                            x, v = hub - load, hub_rate - load_rate
                            low_nm, low_by, high_nm, high_by, kept = 0.0, 0.0, 0.0, 0.0, 0.0
                            found = False
                            for attempt in range(ATTEMPTS):
                                apart = outer - load_torque_nm * per_load
                                ahead, closing = meet(
                                    *(x, v, apart, damping_s, slope),
                                    *(face_delta, face_square, face_soft),
                                    *(gap, step_s, pressed_s, pressed_c, pressed_sine),
                                )
                                impulse = (v + apart * step_s - closing) * moved_kg_m2
                                ended = load_rate + (impulse + load_torque_nm * step_s) * per_load
                                if found or (attempt == 0 and load_velocity_rad_s * ended > 0.0):
                                    break
                                # it turned: would what brakes it then turn it back? (see `holding`)
                                tried_nm, load_velocity_rad_s = load_torque_nm, ended
                                load_torque_nm = 0.0
                                # port load_torque_nm
                                by = load_torque_nm - tried_nm
                                if attempt == 0:
                                    low_nm, low_by, found = tried_nm, by, by == 0.0
                                elif attempt == 1 and low_by * by >= 0.0:
                                    found = True
                                    load_torque_nm = tried_nm if load_rate * ended > 0.0 else low_nm
                                else:
                                    low_nm, low_by, high_nm, high_by, kept, next_nm = nearer(
                                        low_nm, low_by, high_nm, high_by, kept, tried_nm, by
                                    )
                                    near = abs(by) <= HELD * abs(high_nm - low_nm)
                                    found = near or attempt == ATTEMPTS - 2
                                    load_torque_nm = tried_nm if near else next_nm
                            contact_torque_nm = impulse * per_step
                            late = (x + (v + apart * half_s) * step_s - ahead) * moved_kg_m2
                            late -= impulse * half_s
                            if mode != MOTION and not coupled:
                                pull = acceleration - contact_torque_nm * per_motor
                                late_rad = late * per_motor
                    else:
                        contact_torque_nm = 0.0
                        if load_torque_nm != 0.0:
                            share = share_pushed(
                                hub - load, hub_rate, driver_rate, step_s, load_torque_nm, gap
                            )
                            contact_torque_nm = -share * load_torque_nm
                            if mode != MOTION and not coupled:
                                acceleration -= contact_torque_nm * per_motor
                                pull = acceleration
                    # keep load_torque_nm
                    if coupled:
                        wound = free + contact_torque_nm * per_hub
                        if step_s > 0.0:
                            x, v = theta - hub, omega - hub_rate
                            twist, twist_rate = twisted(
                                *(x, v, wound, shaft_delta, shaft_square, shaft_soft),
                                *(whole_c, whole_sine),
                            )
                            impulse = (v + wound * step_s - twist_rate) * wound_kg_m2
                            spun_nm = impulse * per_step
                            late_spun = (x + (v + wound * half_s) * step_s - twist) * wound_kg_m2
                            late_spun -= impulse * half_s
                            if mode != MOTION:
                                pull = acceleration - spun_nm * per_motor
                                late_rad = late_spun * per_motor
                    change = -rate
                    rate = integral_rate_rad_s - (r - motor_velocity_rad_s)
                    change = (change + rate) * per_since

                    if step_s > 0.0:
                        theta_end = (
                            theta + (r * step_s + s11 * error + s12 * z) + (d11 * pull + d12 * rate)
                        )
                        omega_end = r + (e11 * error + e12 * z) + (s11 * pull + s12 * rate)
                        integral_rad = (e21 * error + e22 * z) + (s21 * pull + s22 * rate)
                        late_rad += jerk * cube
                        theta_end -= late_rad
                        omega_end += per_a * (loop_p * late_rad - loop_i * change * cube)
                        integral_rad += late_rad
                        hub_end, hub_rate_end = theta_end, omega_end
                        if coupled:
                            pushed_by = (spun_nm - contact_torque_nm) * per_hub
                            hub_end = hub + (hub_rate + pushed_by * half_s) * step_s
                            hub_end += (late_spun - late) * per_hub
                            hub_rate_end = hub_rate + pushed_by * step_s
                        if two_masses:
                            pushed_by = (contact_torque_nm + load_torque_nm) * per_load
                            load += (load_rate + pushed_by * half_s) * step_s + late * per_load
                            load_rate += pushed_by * step_s
                        else:
                            if hub_rate * hub_rate_end < 0.0:
                                turned = hub + step_s * reach(hub_rate, driver_rate, hub_rate_end)
                                lowest, highest = turned - 0.5 * gap, turned + 0.5 * gap
                                load = lesser(greater(load, lowest), highest)
                            lowest, highest = hub_end - 0.5 * gap, hub_end + 0.5 * gap
                            load = lesser(greater(load, lowest), highest)
                        hub, hub_rate = hub_end, hub_rate_end
                        # port integral_rad
                        z = integral_rad if powered else 0.0
                        theta, omega = theta_end, omega_end
                        elapsed += step_s
                    else:
                        measured_motor_angle_rad = motor_angle_rad
                        # port measured_motor_angle_rad
                        measured_current_a = current_a
                        # port measured_current_a
                        measured_load_angle_rad = load_angle_rad
                        # port measured_load_angle_rad
                    soon = False
                    if two_masses:
                        # a face is met within the next step
                        closing = hub_rate - load_rate
                        ahead = hub - load if closing > 0.0 else load - hub
                        room = 0.5 * gap - ahead
                        soon = gap > 0.0 and 0.0 < room < 1.5 * h * abs(closing)
                    if cut_a != 0.0 and since_s > 0.0:
                        # a limit lets go within the next two
                        then_a = cut_a + 2.0 * h * per_since * (cut_a - cut_before_a)
                        soon = soon or cut_a * then_a < 0.0
                    cut_before_a = cut_a
                    if soon and fine == 0:
                        break
                if part != 1:
                    part += 1
                elif fine == 0:
                    whole -= done
                else:
                    fine -= done
            elapsed = until  # the very number the next command is due at, not one ulp before
            if elapsed >= slot_duration_s:
                break
        clock += slot_duration_s
        slot += 1.0
        for j in range(waiting):
            state[HEAD + 2 * j] -= slot_duration_s
        rows[k, 0], rows[k, 1], rows[k, 2] = measured_motor_angle_rad, omega, measured_current_a
        rows[k, 3], rows[k, 4], rows[k, 5] = measured_load_angle_rad, load, load_velocity_rad_s
        rows[k, 6], rows[k, 7] = contact_torque_nm, z

    state[0], state[1], state[2], state[3], state[4] = theta, omega, z, load, load_rate
    state[5], state[6], state[7], state[8] = drive, clock, slot, contact_torque_nm
    state[9], state[10], state[11], state[12] = waiting, hub, hub_rate, gap
    # pack
    return complete
