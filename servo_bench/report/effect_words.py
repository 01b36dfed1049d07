"""An effect's parameters and port in words: units from the endings of names, ranges, and places."""

import inspect

from sim_rig.effects import catalogue
from sim_rig.effects.effect import Effect, Parameter, Port, Prior

UNITS: tuple[tuple[str, str], ...] = (
    ("_nm_s2_per_rad2", "N m s²/rad²"),
    ("_nm_s_per_rad", "N m s/rad"),
    ("_nm_per_rad", "N m/rad"),
    ("_rad_per_nm", "rad/(N m)"),
    ("_a_s_per_rad", "A s/rad"),
    ("_s2_per_rad", "s²/rad"),
    ("_s_per_rad", "s/rad"),
    ("_s_per_m", "s/m"),
    ("_per_a2", "1/A²"),
    ("_per_rad", "1/rad"),
    ("_per_nm", "1/(N m)"),
    ("_per_a", "1/A"),
    ("_per_s", "1/s"),
    ("_per_k", "1/K"),
    ("_kg_m2", "kg m²"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_nm", "N m"),
    ("_hz", "Hz"),
    ("_a", "A"),
    ("_v", "V"),
    ("_k", "K"),
    ("_m", "m"),
    ("_s", "s"),
)
"""Ending of a parameter's name, and its SI unit; the first that fits. Pure numbers have none."""

BLOCKS = {
    Port.INERTIA: "mechanics",
    Port.TRANSMISSION: "transmission",
    Port.COUPLING: "transmission",
    Port.BACKLASH_GAP: "transmission",
    Port.LOAD_TORQUE: "transmission",
    Port.ELECTRIC_TORQUE: "mechanics",
    Port.MOTOR_TORQUE: "mechanics",
    Port.MOTOR_SENSOR: "sensor",
    Port.CURRENT_SENSOR: "sensor",
    Port.LOAD_SENSOR: "sensor",
}
"""The block that a port lies in; every other port is the controller's."""


def unit_of(name: str) -> str:
    """The SI unit that a parameter's name ends in, or nothing."""
    return next((unit for ending, unit in UNITS if name.endswith(ending)), "")


def with_unit(value: float, name: str) -> str:
    """A value with the unit of its name."""
    return f"{value:.4g} {unit_of(name)}".rstrip()


def range_of(parameter: Parameter) -> str:
    """From where to where it usually lies, with its unit: "0.0001 to 0.1 N m"."""
    prior = parameter.prior
    return f"{prior.low:.4g} to {prior.high:.4g} {unit_of(parameter.name)}".rstrip()


def kind_of(prior: Prior) -> str:
    """Whether it is a magnitude, signed, or not fitted."""
    if prior.least == 0.0:
        return "magnitude"
    return "signed" if prior.above == float("-inf") else "known"


def place_of(effect: Effect) -> str:
    """Block, signal, and whether it is added or takes the signal's place."""
    how = "adds to" if effect.port.is_sum else "changes"
    return f"{BLOCKS.get(effect.port, 'controller')}: {how} {effect.port.value}"


def one_line(effect: Effect) -> str:
    """The first line of its equation."""
    return effect.equation.strip().partition("\n")[0].strip()


def docstring(effect: Effect) -> str:
    """What stands at the head of the effect's file."""
    return inspect.cleandoc(effect.law.__globals__["__doc__"])


def sample_words(effect: Effect) -> str:
    """The case that is drawn: `torque_nm = 0.01 N m`, and what it is shown beside."""
    own = ", ".join(f"{name} = {with_unit(v, name)}" for name, v in effect.sample.items())
    beside = "; ".join(
        f"beside {other}: "
        + ", ".join(f"{name} = {with_unit(v, name)}" for name, v in table.items())
        for other, table in effect.beside.items()
    )
    return f"{own}; {beside}" if beside else own


def overview() -> str:
    """The whole catalogue as a table in Markdown: `docs/effects.md`."""
    rows = [
        (
            f"`{effect.name}`",
            place_of(effect),
            f"`{one_line(effect)}`".replace("|", "\\|"),
            f"`{effect.parameters[0].name}` {range_of(effect.parameters[0])}",
            effect.shows,
            ", ".join(f"`{name}`" for name in effect.confused_with),
        )
        for effect in catalogue().values()
    ]
    lines = [" | ".join(row) for row in (_HEADINGS, ("---",) * len(_HEADINGS), *rows)]
    table = "\n".join(f"| {line} |" for line in lines)
    return f"{_HEAD}\n{table}\n"


_HEADINGS = ("effect", "where it enters", "law", "main parameter", "shows", "confused with")
_HEAD = """# Effects

What can be wrong with the model of the rig, one file each in `sim_rig/effects`, where a note says
how to add one. Written by `servo-bench effects --markdown`; a test keeps it so. All about one, with
its signature and its confusions computed: `servo-bench effects show cogging --out cogging.html`.
"""
