/* A servo axis under velocity control, played from its first command to its last sample.
 *
 *   motor        J dw/dt = K_T i - F + T_cog - T_link
 *   its inertia  J, or J (1 + a cos(n th + phi)) with the torque ½ J a n sin(n th + phi) w^2
 *   torque       K_T (1 + r sin(n th + phi)) (1 + s sin(2 pi f t + phi))
 *   current      di/dt = (i_ref - i) / T_i
 *   cogging      T_cog = sum T sin(n th + phi)         of two orders
 *   friction     F = g z + d (w - |w| z) + B w         g = F_C + F_S exp(-(w / v_S)^2)
 *   bristle      z_b dz/dt = w - |w| z                 LuGre, z in units of its break-away z_b
 *   load         J_l dw_l/dt = T_link + T_l - G sin(th_l + phi) - F_l
 *   link         none: the load is the motor
 *                coupling: T_link = k (th - th_l) + c (w - w_l)
 *                faces: N = k (p / 0.1 mrad)^(e - 1) p (1 + c dp/dt), never below zero, at the
 *                penetration p of either face of a gap (Hunt and Crossley 1975)
 *   drive        once a tick: v = counts moved / tick, a low pass of it, the integral of the error,
 *                i_ref = K_P error + K_I integral, clamped
 *   disc         of the load's encoder: turns with the load up to an acceleration of a, and slips
 *                above it
 *
 * Sources: Canudas de Wit and others, "A new model for control of systems with friction", 1995;
 * Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact", 1975.
 *
 * Classical Runge-Kutta of fourth order for everything but the bristles, which are advanced by
 * their exact exponential half a step before and half a step after it (Strang 1968): they are far
 * stiffer than the rest. Angles between two steps are cubic Hermite. Angles in rad, torques in N m.
 */
#include <math.h>

enum { RIGID, COUPLING, FACES };

/* The same names in the same order as `plant.Axis`. */
typedef struct {
    double inertia_kg_m2;
    double torque_constant_nm_per_a;
    double current_lag_s;
    double coulomb_nm;
    double stribeck_nm;
    double stribeck_rad_s;
    double bristle_rad;
    double viscous_nm_s_per_rad;
    double detent_nm;
    double detent_order;
    double detent_phase_rad;
    double cogging_nm;
    double cogging_order;
    double cogging_phase_rad;
    double ripple_fraction;
    double ripple_order;
    double ripple_phase_rad;
    double inertia_wave_fraction;
    double inertia_wave_order;
    double inertia_wave_phase_rad;
    double supply_fraction;
    double supply_hz;
    double supply_phase_rad;
    long link;
    double load_inertia_kg_m2;
    double stiffness_nm_per_rad;
    double coupling_damping_nm_s_per_rad;
    double face_damping_s_per_rad;
    double face_exponent;
    double gap_rad;
    double load_friction_nm;
    double load_bristle_rad;
    double gravity_nm;
    double gravity_phase_rad;
    double load_torque_nm;
    double tick_s;
    long substeps;
    double proportional_gain_a_s_per_rad;
    double integral_gain_a_per_rad;
    double current_limit_a;
    double motor_count_rad;
    double filter_lag_s;
    double disc_slip_rad_s2;
    double motor_start_rad;
    double load_start_rad;
} Axis;

/* What Runge-Kutta advances; the three energies last. */
typedef struct {
    double motor_rad;
    double motor_rad_s;
    double load_rad;
    double load_rad_s;
    double current_a;
    double work_j;          /* that the motor and every outer torque have done */
    double friction_loss_j; /* a bristle's stored energy counts as lost */
    double link_loss_j;
} State;

#define STATE_SIZE (sizeof(State) / sizeof(double))

/* What stands still during a Runge-Kutta step. */
typedef struct {
    double time_s;
    double reference_a;
    double bristle;      /* the motor's, in break-away deflections */
    double load_bristle;
} Held;

/* What the drive remembers from tick to tick. */
typedef struct {
    double counts;
    double counted_rad_s;
    double filtered_rad_s;
    double integral_rad;
} Drive;

typedef struct {
    double rad;
    double rad_s;
} Disc;

/* One row of `plant.COLUMNS`. */
typedef struct {
    double motor_rad;
    double motor_rad_s;
    double load_rad;
    double load_rad_s;
    double current_a;
    double counted_rad_s;
    double reference_a;
    double disc_rad;
} Sample;

/* One of `plant.Energy`. */
typedef struct {
    double work_j;
    double friction_loss_j;
    double link_loss_j;
    double stored_j;
} Energy;

static const double FACE_REFERENCE_RAD = 1e-4;
static const double STEP_OF_BRISTLES_S = 1e-4;
static const double BRISTLE_DAMPING = 0.02;
static const double LOAD_BRISTLE_DAMPING = 1.4; /* of 2: 0.7 of critical */

static double clipped(double value, double limit) {
    return fmin(fmax(value, -limit), limit);
}

static double sliding_friction_nm(const Axis *axis, double rad_s) {
    double torque_nm = axis->coulomb_nm;
    if (axis->stribeck_nm != 0.0) {
        double ratio = rad_s / axis->stribeck_rad_s;
        torque_nm += axis->stribeck_nm * exp(-ratio * ratio);
    }
    return fmax(torque_nm, 0.0);
}

/* A bristle after `step_s` at a constant velocity: it goes to the sign of that exponentially. */
static double bent(double bristle, double rad_s, double bristle_rad, double step_s) {
    double rate = fabs(rad_s) / bristle_rad;
    if (rate * step_s < 1e-9) {
        return bristle + rad_s / bristle_rad * step_s;
    }
    double end = copysign(1.0, rad_s);
    return end + (bristle - end) * exp(-rate * step_s);
}

static void bend_bristles(const Axis *axis, const State *state, double step_s, Held *held) {
    held->bristle = bent(held->bristle, state->motor_rad_s, axis->bristle_rad, step_s);
    if (axis->load_friction_nm > 0.0) {
        held->load_bristle =
            bent(held->load_bristle, state->load_rad_s, axis->load_bristle_rad, step_s);
    }
}

static double bristle_torque_nm(double sliding_nm, double damping, double rad_s, double bristle) {
    return sliding_nm * bristle + damping * (rad_s - fabs(rad_s) * bristle);
}

static double motor_friction_nm(const Axis *axis, const Held *held, double rad_s) {
    double sliding_nm = sliding_friction_nm(axis, rad_s);
    /* Critical, but no more than an explicit step can take. */
    double damping = fmin(
        sqrt(sliding_nm / axis->bristle_rad * axis->inertia_kg_m2),
        BRISTLE_DAMPING * axis->inertia_kg_m2 / STEP_OF_BRISTLES_S);
    return bristle_torque_nm(sliding_nm, damping, rad_s, held->bristle)
        + axis->viscous_nm_s_per_rad * rad_s;
}

static double load_friction_nm(const Axis *axis, const Held *held, double rad_s) {
    if (axis->load_friction_nm <= 0.0) {
        return 0.0;
    }
    double stiffness = axis->load_friction_nm / axis->load_bristle_rad;
    double damping = LOAD_BRISTLE_DAMPING * sqrt(stiffness * axis->load_inertia_kg_m2);
    return bristle_torque_nm(axis->load_friction_nm, damping, rad_s, held->load_bristle);
}

static double motor_torque_nm(const Axis *axis, const Held *held, const State *state) {
    double per_a = axis->torque_constant_nm_per_a;
    double angle = axis->ripple_order * state->motor_rad + axis->ripple_phase_rad;
    double phase = 2.0 * M_PI * axis->supply_hz * held->time_s + axis->supply_phase_rad;
    if (axis->ripple_fraction != 0.0) {
        per_a *= 1.0 + axis->ripple_fraction * sin(angle);
    }
    if (axis->supply_fraction != 0.0) {
        per_a *= 1.0 + axis->supply_fraction * sin(phase);
    }
    return per_a * state->current_a;
}

static double cogging_nm(const Axis *axis, double motor_rad) {
    double torque_nm = 0.0;
    if (axis->detent_nm != 0.0) {
        torque_nm +=
            axis->detent_nm * sin(axis->detent_order * motor_rad + axis->detent_phase_rad);
    }
    if (axis->cogging_nm != 0.0) {
        torque_nm +=
            axis->cogging_nm * sin(axis->cogging_order * motor_rad + axis->cogging_phase_rad);
    }
    return torque_nm;
}

static double outer_torque_nm(const Axis *axis, double load_rad) {
    double torque_nm = axis->load_torque_nm;
    if (axis->gravity_nm != 0.0) {
        torque_nm -= axis->gravity_nm * sin(load_rad + axis->gravity_phase_rad);
    }
    return torque_nm;
}

static double inertia_kg_m2(const Axis *axis, double motor_rad) {
    double angle = axis->inertia_wave_order * motor_rad + axis->inertia_wave_phase_rad;
    if (axis->inertia_wave_fraction == 0.0) {
        return axis->inertia_kg_m2;
    }
    return axis->inertia_kg_m2 * (1.0 + axis->inertia_wave_fraction * cos(angle));
}

/* -½ dJ/dth w^2, without which an inertia that goes with the angle makes energy. */
static double centrifugal_nm(const Axis *axis, const State *state) {
    double angle = axis->inertia_wave_order * state->motor_rad + axis->inertia_wave_phase_rad;
    if (axis->inertia_wave_fraction == 0.0) {
        return 0.0;
    }
    double size = axis->inertia_kg_m2 * axis->inertia_wave_fraction * axis->inertia_wave_order;
    return 0.5 * size * sin(angle) * state->motor_rad_s * state->motor_rad_s;
}

static double penetration_rad(const Axis *axis, double twist_rad) {
    return fmax(fabs(twist_rad) - 0.5 * axis->gap_rad, 0.0);
}

/* What springs alone bear. */
static double elastic_nm(const Axis *axis, double twist_rad) {
    if (axis->link == COUPLING) {
        return axis->stiffness_nm_per_rad * twist_rad;
    }
    double deep_rad = penetration_rad(axis, twist_rad);
    if (deep_rad == 0.0) {
        return 0.0;
    }
    double hardening = pow(deep_rad / FACE_REFERENCE_RAD, axis->face_exponent - 1.0);
    return copysign(axis->stiffness_nm_per_rad * hardening * deep_rad, twist_rad);
}

static double link_nm(const Axis *axis, double twist_rad, double twist_rad_s) {
    double elastic = elastic_nm(axis, twist_rad);
    if (axis->link == COUPLING) {
        return elastic + axis->coupling_damping_nm_s_per_rad * twist_rad_s;
    }
    double deeper_rad_s = copysign(1.0, twist_rad) * twist_rad_s;
    double share = 1.0 + axis->face_damping_s_per_rad * deeper_rad_s;
    return share > 0.0 ? elastic * share : 0.0;
}

static double stored_j(const Axis *axis, const State *state) {
    double motor_j = 0.5 * inertia_kg_m2(axis, state->motor_rad) * state->motor_rad_s
        * state->motor_rad_s;
    if (axis->link == RIGID) {
        return motor_j;
    }
    double twist_rad = state->motor_rad - state->load_rad;
    double load_j = 0.5 * axis->load_inertia_kg_m2 * state->load_rad_s * state->load_rad_s;
    double elastic = elastic_nm(axis, twist_rad);
    if (axis->link == COUPLING) {
        return motor_j + load_j + 0.5 * elastic * twist_rad;
    }
    double deep_rad = penetration_rad(axis, twist_rad);
    return motor_j + load_j + fabs(elastic) * deep_rad / (axis->face_exponent + 1.0);
}

static void differentiate(const Axis *axis, const Held *held, const State *state, State *rate) {
    double friction_nm = motor_friction_nm(axis, held, state->motor_rad_s);
    double driving_nm = motor_torque_nm(axis, held, state) + cogging_nm(axis, state->motor_rad);
    double outer_nm = outer_torque_nm(axis, state->load_rad);
    double inertia = inertia_kg_m2(axis, state->motor_rad);
    double motor_nm = driving_nm - friction_nm + centrifugal_nm(axis, state);
    rate->motor_rad = state->motor_rad_s;
    rate->current_a = 0.0;
    if (axis->current_lag_s > 0.0) {
        rate->current_a = (held->reference_a - state->current_a) / axis->current_lag_s;
    }
    rate->work_j = driving_nm * state->motor_rad_s + outer_nm * state->load_rad_s;
    rate->friction_loss_j = friction_nm * state->motor_rad_s;
    rate->load_rad = state->load_rad_s;
    if (axis->link == RIGID) {
        rate->motor_rad_s = (motor_nm + outer_nm) / inertia;
        rate->load_rad_s = rate->motor_rad_s;
        rate->link_loss_j = 0.0;
        return;
    }
    double twist_rad = state->motor_rad - state->load_rad;
    double twist_rad_s = state->motor_rad_s - state->load_rad_s;
    double borne_nm = link_nm(axis, twist_rad, twist_rad_s);
    double load_friction = load_friction_nm(axis, held, state->load_rad_s);
    rate->motor_rad_s = (motor_nm - borne_nm) / inertia;
    rate->load_rad_s = (borne_nm + outer_nm - load_friction) / axis->load_inertia_kg_m2;
    rate->friction_loss_j += load_friction * state->load_rad_s;
    rate->link_loss_j = (borne_nm - elastic_nm(axis, twist_rad)) * twist_rad_s;
}

static void moved(const State *state, const State *rate, double step_s, State *out) {
    const double *from = (const double *)state;
    const double *slope = (const double *)rate;
    double *to = (double *)out;
    for (unsigned long k = 0; k < STATE_SIZE; k++) {
        to[k] = from[k] + step_s * slope[k];
    }
}

static void runge_kutta(const Axis *axis, Held *held, double step_s, State *state) {
    State first, second, third, fourth, trial;
    double begun_s = held->time_s;
    differentiate(axis, held, state, &first);
    held->time_s = begun_s + 0.5 * step_s;
    moved(state, &first, 0.5 * step_s, &trial);
    differentiate(axis, held, &trial, &second);
    moved(state, &second, 0.5 * step_s, &trial);
    differentiate(axis, held, &trial, &third);
    held->time_s = begun_s + step_s;
    moved(state, &third, step_s, &trial);
    differentiate(axis, held, &trial, &fourth);
    moved(state, &first, step_s / 6.0, state);
    moved(state, &second, step_s / 3.0, state);
    moved(state, &third, step_s / 3.0, state);
    moved(state, &fourth, step_s / 6.0, state);
}

/* The current that the drive asks for after this tick; whether it had to be clamped. */
static int ticked(const Axis *axis, double command_rad_s, double motor_rad, Drive *drive,
                  double *reference_a) {
    double counts = floor(motor_rad / axis->motor_count_rad);
    drive->counted_rad_s = (counts - drive->counts) * axis->motor_count_rad / axis->tick_s;
    drive->counts = counts;
    double share = 1.0;
    if (axis->filter_lag_s > 0.0) {
        share = 1.0 - exp(-axis->tick_s / axis->filter_lag_s);
    }
    drive->filtered_rad_s += share * (drive->counted_rad_s - drive->filtered_rad_s);
    double error_rad_s = command_rad_s - drive->filtered_rad_s;
    drive->integral_rad += error_rad_s * axis->tick_s;
    double wanted_a = axis->proportional_gain_a_s_per_rad * error_rad_s
        + axis->integral_gain_a_per_rad * drive->integral_rad;
    *reference_a = clipped(wanted_a, axis->current_limit_a);
    return *reference_a != wanted_a;
}

static void turn_disc(const Axis *axis, const State *state, double step_s, Disc *disc) {
    if (axis->disc_slip_rad_s2 <= 0.0) {
        disc->rad = state->load_rad;
        disc->rad_s = state->load_rad_s;
        return;
    }
    disc->rad_s += clipped(state->load_rad_s - disc->rad_s, axis->disc_slip_rad_s2 * step_s);
    disc->rad += disc->rad_s * step_s;
}

/* A cubic between two angles with their velocities, at the share `u` of a step. */
static double between_rad(double from, double to, double from_s, double to_s, double u,
                          double step_s) {
    double square = u * u;
    double cube = square * u;
    return (2.0 * cube - 3.0 * square + 1.0) * from + (cube - 2.0 * square + u) * step_s * from_s
        + (3.0 * square - 2.0 * cube) * to + (cube - square) * step_s * to_s;
}

static void sample(const Axis *axis, const State *before, const State *now, const Disc *disc,
                   double u, double step_s, Sample *out) {
    out->motor_rad = between_rad(before->motor_rad, now->motor_rad, before->motor_rad_s,
                                 now->motor_rad_s, u, step_s);
    out->motor_rad_s = before->motor_rad_s + u * (now->motor_rad_s - before->motor_rad_s);
    out->load_rad = between_rad(before->load_rad, now->load_rad, before->load_rad_s,
                                now->load_rad_s, u, step_s);
    out->load_rad_s = before->load_rad_s + u * (now->load_rad_s - before->load_rad_s);
    out->current_a = before->current_a + u * (now->current_a - before->current_a);
    out->disc_rad = out->load_rad;
    if (axis->disc_slip_rad_s2 > 0.0) {
        out->disc_rad = disc->rad - (1.0 - u) * step_s * disc->rad_s;
    }
}

/* Plays from time zero to the last sample; returns how many ticks were clamped.
 *
 * `arrival_s[k]` is when the drive has command k, `sample_s[k]` when row k is taken, both ascending
 * and of `count` entries.
 */
long play(const Axis *axis, long count, const double *arrival_s, const double *command_rad_s,
          const double *sample_s, Sample *samples, Energy *energy) {
    State state = {axis->motor_start_rad, 0.0, axis->load_start_rad, 0.0, 0.0, 0.0, 0.0, 0.0};
    if (axis->link == RIGID) {
        state.load_rad = state.motor_rad;
    }
    Held held = {0.0, 0.0, 0.0, 0.0};
    Drive drive = {floor(state.motor_rad / axis->motor_count_rad), 0.0, 0.0, 0.0};
    Disc disc = {state.load_rad, 0.0};
    double step_s = axis->tick_s / axis->substeps;
    double begun_j = stored_j(axis, &state);
    double command = 0.0;
    long arrived = 0;
    long taken = 0;
    long clamped = 0;
    for (long tick = 0; taken < count; tick++) {
        double tick_s = tick * axis->tick_s;
        while (arrived < count && arrival_s[arrived] <= tick_s) {
            command = command_rad_s[arrived];
            arrived++;
        }
        clamped += ticked(axis, command, state.motor_rad, &drive, &held.reference_a);
        if (axis->current_lag_s <= 0.0) {
            state.current_a = held.reference_a;
        }
        for (long part = 0; part < axis->substeps; part++) {
            State before = state;
            held.time_s = tick_s + part * step_s;
            bend_bristles(axis, &state, 0.5 * step_s, &held);
            runge_kutta(axis, &held, step_s, &state);
            bend_bristles(axis, &state, 0.5 * step_s, &held);
            turn_disc(axis, &state, step_s, &disc);
            while (taken < count && sample_s[taken] <= held.time_s) {
                double u = fmax(1.0 - (held.time_s - sample_s[taken]) / step_s, 0.0);
                Sample *out = samples + taken;
                sample(axis, &before, &state, &disc, u, step_s, out);
                out->counted_rad_s = drive.counted_rad_s;
                out->reference_a = held.reference_a;
                taken++;
            }
        }
    }
    energy->work_j = state.work_j;
    energy->friction_loss_j = state.friction_loss_j;
    energy->link_loss_j = state.link_loss_j;
    energy->stored_j = stored_j(axis, &state) - begun_j;
    return clamped;
}
