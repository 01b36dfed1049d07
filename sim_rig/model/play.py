"""The rigid play within one step: where the motor turned around, and when it pushes the load.

    y <- min(max(y, theta - W/2), theta + W/2)

A load without mass stays where it is left. What acts on it reaches the motor only while the motor
pushes against it; a load that is pulled ahead is held by its own friction.
"""

from math import sqrt

from sim_rig.model.lesser import greater, lesser


def reach(start: float, middle: float, end: float) -> float:
    """How far the motor goes in a unit step until it turns around (rad/s times the step).

    The velocity is the parabola through its three values; start and end differ in sign.
    """
    b = 4.0 * middle - 3.0 * start - end
    c = 2.0 * (start + end) - 4.0 * middle
    root = sqrt(greater(b * b - 4.0 * start * c, 0.0))
    below = b + (root if end > start else -root)
    t = lesser(greater(-2.0 * start / below, 0.0), 1.0) if below != 0.0 else 0.0
    return t * (start + t * (0.5 * b + t * c / 3.0))


def share_pushed(  # noqa: PLR0917 - compiled, and compiled calls name nothing
    ahead: float, start: float, middle: float, step_s: float, load_torque: float, gap: float
) -> float:
    """The share of a step in which the motor feels the load's torque.

    ahead = theta - y at its start; the velocity is a straight line from `start` through `middle`,
    or, in a look, stays as it is. After the motor turns around it has the gap before it.
    """
    if gap <= 0.0:
        return 1.0
    end = 2.0 * middle - start
    turn = start / (start - end) if start * end < 0.0 else 1.0
    leading = start if start != 0.0 else end
    side = 1.0 if leading > 0.0 else -1.0
    if leading == 0.0 or side * load_torque > 0.0:
        return 0.0
    room = 0.5 * gap - side * ahead
    if room <= 1e-12:
        return turn
    travel = side * (start + 0.5 * (end - start) * turn) * turn * step_s
    return turn * (travel - room) / travel if travel > room else 0.0
