"""How fast friction ends a crawl: what bounds an explicit step.

    |d tau / d omega| / J at standstill, 1/s

A smoothed sign change is steep there. An explicit step longer than two of its time constants does
not stop the mass, it throws it back, and the mass trembles about standstill by T h/J.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from sim_rig.effects import find_effect
from sim_rig.effects.effect import Effect, Port, Signals

if TYPE_CHECKING:
    from sim_rig.model.model import Model

CRAWL_RAD_S = 1e-6
STABLE, MOST_PARTS = 1.5, 64
"""Of the time constant, a step at most (its midpoint rule is stable up to 2); and into how many
parts the model's longest step is cut for that, at most."""


def unthrown_s(model: "Model") -> float:
    """The longest step that stops what friction holds; infinite without friction."""
    rate = max(_rates(model), default=0.0)
    shortest_s = model.longest_step_s / MOST_PARTS
    return max(STABLE / rate, shortest_s) if rate > 0.0 else float("inf")


def _rates(model: "Model") -> Iterator[float]:
    effects = {name: find_effect(name) for name in model.effects}
    on = {n: e for n, e in effects.items() if not e.is_off(model.effects[n])}
    inertia, behind = model.nominal.inertia_kg_m2, 0.0
    for name, effect in on.items():
        if effect.port is Port.INERTIA:
            inertia = float(effect.law(Signals(inertia_kg_m2=inertia), model.effects[name]))
        if effect.port is Port.TRANSMISSION:
            behind = float(effect.law(Signals(), model.effects[name])[2])
    for name, effect in on.items():
        if effect.memory is None and effect.port in (Port.MOTOR_TORQUE, Port.LOAD_TORQUE):
            mass = inertia - behind
            if effect.port is Port.LOAD_TORQUE and behind > 0.0:
                mass = behind
            yield _slope(effect, model.effects[name]) / mass


def _slope(effect: Effect, params: object) -> float:
    """By how much the torque changes in a crawl through standstill, N m s/rad."""
    torques = [
        float(effect.law(Signals(motor_velocity_rad_s=v, load_velocity_rad_s=v), params))
        for v in (-CRAWL_RAD_S, CRAWL_RAD_S)
    ]
    return abs(torques[1] - torques[0]) / (2.0 * CRAWL_RAD_S)
