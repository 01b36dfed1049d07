"""The load behind the gap as a second mass: relative motion over one step, exactly, with events.

    x'' = a - mu T,   T = side k max(0, p + d p') while p = side x - W/2 >= 0
    |x'| / (1 + e |x'|) where a face is left

x = theta - theta_l; a relative acceleration without the contact (constant over the step),
mu = 1/J_m + 1/J_l, k stiffness, d damping time, W gap, e slope of the restitution. Off the faces
x is a parabola, on one a damped oscillation about its own rest,

    x(t) = rest + c y + s (v + delta y),   c, s = exp(-delta t) (cos, sin / rate)(rate t)

whose c and s are the same for all steps alike and are made once (`swung`). The step is cut where
a face is met or let go. A face that is let go while still pressed in follows without force. A gap
of zero is a coupling: one face that pushes and pulls.
"""

from math import ceil, cos, exp, sin, sqrt

from sim_rig.model.lesser import greater, lesser

OUT_RAD = 1e-12
"""Where a face is left, but for rounding."""


def sprung(mu: float, k: float, d: float) -> tuple[float, float, float]:
    """(delta, square, soft) of a spring: its decay, its rate's square, which is negative where it
    creeps, and how far it gives way to a relative acceleration."""
    delta = 0.5 * mu * k * d
    return delta, mu * k - delta * delta, 1.0 / (mu * k)


def swung(delta: float, square: float, t: float) -> tuple[float, float]:
    """(c, s) after t of y'' + 2 delta y' + (square + delta^2) y = 0."""
    if square > 0.0:
        rate = sqrt(square)
        decay = exp(-delta * t)
        return decay * cos(rate * t), decay * sin(rate * t) / rate
    if square < 0.0:
        rate = sqrt(-square)
        slow, fast = exp((rate - delta) * t), exp(-(rate + delta) * t)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / rate
    c = exp(-delta * t)
    return c, c * t


def oscillate(  # noqa: PLR0917 - compiled, and compiled calls name nothing
    y: float, v: float, delta: float, square: float, c: float, s: float
) -> tuple[float, float]:
    """(y, y') after the time that c and s are of."""
    return y * c + (v + delta * y) * s, v * c - ((square + delta * delta) * y + delta * v) * s


def twisted(  # noqa: PLR0917
    x: float, v: float, a: float, delta: float, square: float, soft: float, c: float, s: float
) -> tuple[float, float]:
    """(x, x') of a spring that pushes and pulls, a coupling, after the time that c and s are of."""
    rest = a * soft
    y, w = oscillate(x - rest, v, delta, square, c, s)
    return y + rest, w


def upward(x: float, v: float, a: float, never: float) -> float:
    """When x + v t + a t^2 / 2 next crosses zero from below; `never` where it does not."""
    root = v * v - 2.0 * a * x
    if root < 0.0 or (v <= 0.0 and a <= 0.0):
        return never
    return greater(-2.0 * x / (v + sqrt(root)) if v > 0.0 else (sqrt(root) - v) / a, 0.0)


def left_at(v: float, slope: float) -> float:
    """Velocity with which a face is left that took nothing else."""
    return v / (1.0 + slope * abs(v))


def piece_of(soft: float, h: float) -> float:
    """How much of a step `meet` takes at once: equal parts, of an eighth of a period at most, so
    that no release hides within."""
    return h / ceil(h / (0.75 * sqrt(soft)))


def meet(  # noqa: PLR0912, PLR0915, PLR0917 - one event after another
    x: float,
    v: float,
    a: float,
    d: float,
    slope: float,
    delta: float,
    square: float,
    soft: float,
    gap: float,
    h: float,
    piece: float,
    c: float,
    s: float,
) -> tuple[float, float]:
    """(x, x') after h, with a damping time d and a restitution that falls by `slope` with a blow's
    speed; c and s are `swung`'s over `piece`, `piece_of`'s."""
    half = 0.5 * gap
    if half <= 0.0:
        all_c, all_s = swung(delta, square, h)
        return twisted(x, v, a, delta, square, soft, all_c, all_s)
    never = 2.0 * h + 1.0
    left, side = h, 1.0 if x >= 0.0 else -1.0
    p = side * x - half
    free = p < 0.0 or p + d * side * v < 0.0 or (p == 0.0 and side * v <= 0.0 >= side * a)
    if free and abs(x) + (abs(v) + 0.5 * abs(a) * h) * h < half:  # no face is within reach
        return x + v * h + 0.5 * a * h * h, v + a * h
    for _ in range(1000):
        if left <= 0.0:
            break
        if free:
            side = 1.0 if x >= 0.0 else -1.0
            p, w, b = side * x - half, side * v, side * a
            pressed = p > 0.0
            # Pressed in, it waits for its face's force or for the way out; else for a face.
            met = upward(p + d * w, w + d * b, b, never) if pressed else upward(p, w, b, never)
            other = upward(-p, -w, -b, never) if pressed else upward(-p - gap, -w, -b, never)
            t = lesser(lesser(met, other), left)
            x, v = x + v * t + 0.5 * a * t * t, v + a * t
            # Met a face; or left the one it was pressed into, for the gap; or met the other.
            if t == met:
                free = False
                x = x if pressed else side * half
            elif t == other:
                v = left_at(v, slope) if pressed else v
                free = pressed
                side = side if pressed else -side
                x = side * half
            left -= t
            continue
        rest = side * a * soft
        y0, v0 = side * x - half - rest, side * v
        t, over_c, over_s = piece, c, s
        if abs(left - piece) <= 1e-9 * piece:
            left = piece  # the last of equal parts, but for rounding
        elif left < piece:
            t = left
            over_c, over_s = swung(delta, square, t)
        y, w = oscillate(y0, v0, delta, square, over_c, over_s)
        if y + rest + d * w < 0.0:
            low, high = 0.0, t
            for _ in range(60):
                force = y + rest + d * w
                if abs(force) < 1e-15 or high - low < 1e-15:
                    break
                if force < 0.0:
                    high = t
                else:
                    low = t
                steep = w - d * (2.0 * delta * w + (square + delta * delta) * y)
                if steep < 0.0:
                    t -= force / steep
                if not low < t < high:
                    t = 0.5 * (low + high)
                over_c, over_s = swung(delta, square, t)
                y, w = oscillate(y0, v0, delta, square, over_c, over_s)
            free = True
        if free and y + rest <= OUT_RAD:  # without damping the force ends where the face is left
            y, w = -rest, left_at(w, slope)
        x, v = side * (y + rest + half), side * w
        left -= t
    return x, v
