"""The table of faults: kind, what it does, what it may be told, and with which values it starts.

A fault is written `kind name=value ...`, for instance

    lost frames=drive-state at=50 count=3
    emcy node=drive code=0x3220 at=120
    sdo-abort object=0x60C2 code=0x06090030

Every kind but sdo-abort and slow-slave begins at SYNC `at`, counted from 0 since the drive was
enabled; below 0 is from power-on.
"""

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from sim_rig.errors import RigSettingsError
from sim_rig.faults.bus_off import BusOff
from sim_rig.faults.encoders import Jump, Noise, Stuck
from sim_rig.faults.fault import Fault, Targets, Values
from sim_rig.faults.frames import NAMES, Duplicated, Jittered, Late, Lost, Reordered
from sim_rig.faults.nodes import Emergency, LyingStatusword, Reset
from sim_rig.faults.sdo_abort import SdoAbort

_FRAMES: Values = {"frames": "answers", "at": 50, "count": 1, "rate": 1.0}
_CHOICES = {
    "node": ("drive", "encoder"),
    "encoder": ("motor", "load", "second"),
    "access": ("read", "write", "any"),
    "power": ("on", "off"),
}
_RANGES: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("delay_ms", "most_ms", "for_ms"), (0.0, 1e6)),
    "count": (0, 1 << 31),
    "rate": (0.0, 1.0),
    "value": (0, 0xFFFF),
    "emcy code": (1, 0xFFFF),
    "sdo-abort code": (0, 0xFFFF_FFFF),
    "encoder-noise counts": (0.0, 1e9),
    "encoder-jump counts": (-(1 << 31), 1 << 31),
}
"""Of a value of that name, or of one kind's."""
_OBJECT, _SUB, _COB_ID = 0xFFFF, 0xFF, 0x7FF


@dataclass(frozen=True, slots=True)
class Kind:
    """One row: the sentence that describes it, its class, and its values where none is given."""

    text: str
    make: type[Fault]
    defaults: Values = field(default_factory=dict)


KINDS = MappingProxyType(
    {
        "lost": Kind("frames never arrive", Lost, _FRAMES),
        "late": Kind("frames arrive delay_ms later", Late, {**_FRAMES, "delay_ms": 5.0}),
        "duplicated": Kind("frames arrive twice", Duplicated, _FRAMES),
        "reordered": Kind("frames change places with the next one", Reordered, _FRAMES),
        "sync-jitter": Kind(
            "SYNC reaches the nodes late by up to most_ms",
            Jittered,
            {**_FRAMES, "frames": "sync", "count": 0, "most_ms": 0.5},
        ),
        "slow-slave": Kind(
            "all that a node says comes delay_ms late",
            Late,
            {"frames": "drive", "at": -1, "count": 0, "rate": 1.0, "delay_ms": 3.0},
        ),
        "bus-off": Kind("no frame gets through for for_ms", BusOff, {"at": 50, "for_ms": 500.0}),
        "reset": Kind("a node restarts", Reset, {"node": "drive", "at": 50}),
        "emcy": Kind(
            "a node sends an emergency; the drive faults with it",
            Emergency,
            {"node": "drive", "code": 0x3220, "at": 50},
        ),
        "sdo-abort": Kind(
            "a node refuses an object",
            SdoAbort,
            {
                "node": "drive",
                "object": "0x6060",
                "access": "write",
                "code": 0x06090030,
                "at": -1,
            },
        ),
        "stuck-encoder": Kind("an encoder's count stays", Stuck, {"encoder": "load", "at": 50}),
        "encoder-jump": Kind(
            "an encoder's count jumps", Jump, {"encoder": "load", "at": 50, "counts": 1000}
        ),
        "encoder-noise": Kind(
            "white noise on an encoder's counts",
            Noise,
            {"encoder": "load", "at": 50, "counts": 2.0},
        ),
        "lying-statusword": Kind(
            "the statusword is a fixed value; with power=off the motor is let go as well",
            LyingStatusword,
            {"value": 0x1237, "power": "off", "at": 50},
        ),
    }
)


def parse(line: str) -> tuple[Kind, Values]:
    """A fault's kind and its values, complete. Raises RigSettingsError in words."""
    words = line.split()
    kind = KINDS.get(words[0]) if words else None
    if kind is None:
        raise RigSettingsError(
            f"fault {line!r}: there is no such kind. Known are {', '.join(KINDS)}, each followed "
            "by name=value."
        )
    values = dict(kind.defaults)
    for word in words[1:]:
        name, equals, text = word.partition("=")
        if not equals or name not in values:
            raise RigSettingsError(
                f"fault {line!r}: {word!r} is not name=value with a name that {words[0]!r} knows: "
                f"{', '.join(values)}."
            )
        values[name] = _value(line, name, text, values[name])
    return kind, values


def _value(line: str, name: str, text: str, default: Any) -> int | float | str:
    try:
        if name == "object":
            index, _, sub = text.partition(":")
            _within(0, int(index, 16), _OBJECT)
            _within(0, int(sub or "0"), _SUB)
            return text
        if name == "frames":
            return text if text in NAMES else hex(int(_within(0, int(text, 16), _COB_ID)))
        if isinstance(default, str):
            if text not in _CHOICES[name]:
                raise ValueError(f"one of {', '.join(_CHOICES[name])}")
            return text
        number = int(text, 0) if isinstance(default, int) else float(text)
        anything = _RANGES.get(name, (-math.inf, math.inf))
        least, most = _RANGES.get(f"{line.split(maxsplit=1)[0]} {name}", anything)
        return _within(least, number, most)
    except ValueError as error:
        allowed = {
            "object": "an object, 0x60C2 or 0x60C2:1",
            "frames": f"one of {', '.join(NAMES)}, or a COB-ID such as 0x181",
        }.get(name, f"a value like {default}")
        raise RigSettingsError(
            f"fault {line!r}: {name} = {text!r} cannot be; it is {allowed} ({error})."
        ) from error


def _within(least: float, number: float, most: float) -> float:
    """The number; ValueError, saying what is allowed, where it is none that can be."""
    if math.isfinite(number) and least <= number <= most:
        return number
    raise ValueError(f"a finite number from {least:g} to {most:g}")


def make(line: str, targets: Targets, seed: int, place: int) -> Fault:
    """The fault that a line describes, the `place`-th of its rig."""
    kind, values = parse(line)
    return kind.make(values, targets, [seed, 0xFA, place])
