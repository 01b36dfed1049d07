"""Seeded fault scenarios, and what a bench that is right makes of each.

A scenario is one fault with drawn values and the answer that it must get: the run goes on (with
what it tells), or it ends with a named cause. Several causes are right where the fault shows in
several ways at once, and which one comes first is a matter of microseconds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

GOES_ON = "goes on"
STALL = "stall"


@dataclass(frozen=True, slots=True)
class Scenario:
    """A fault on a rig, and the kinds of event or error that name it rightly.

    `stall` is a fault of the bench itself: its loop sleeps too long.
    """

    seed: int
    fault: str
    right: tuple[str, ...]
    names: str = ""
    rig: str = "paper"

    @property
    def kind(self) -> str:
        """The fault's kind, and where."""
        return f"{self.rig}: {self.fault.split()[0]}"

    @property
    def seen_from_outside(self) -> bool:
        """Whether a stranger on the wire can see what the drive does after it."""
        return not self.fault.startswith("unplugged")

    @property
    def rig_faults(self) -> tuple[str, ...]:
        """What the rig is told."""
        return () if self.fault.startswith(STALL) else (self.fault,)

    @property
    def stall(self) -> tuple[int, float]:
        """In which wait the bench sleeps too long, and by how many seconds; -1 is never."""
        if not self.fault.startswith(STALL):
            return -1, 0.0
        values = dict(word.split("=") for word in self.fault.split()[1:])
        return int(values["at"]), float(values["for_ms"]) * 1e-3


Draw = np.random.Generator
Maker = Callable[[Draw], tuple[str, tuple[str, ...], str]]


def _at(draw: Draw) -> int:
    return int(draw.integers(3, 80))


def _lost_now_and_then(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    frames = draw.choice(["answers", "drive-state", "drive-motion", "load", "sync"])
    some = f"count={draw.integers(1, 15)}"
    if draw.random() < 0.5:  # of a hundred frames at least one, or there is nothing to name
        some = f"count=0 rate={draw.uniform(0.1, 0.2):.3f}"
    return f"lost frames={frames} at={_at(draw)} {some}", (GOES_ON,), "answer lost"


def _lost_for_good(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    frames, right, names = _FOR_GOOD[draw.integers(len(_FOR_GOOD))]
    return f"lost frames={frames} at={_at(draw)} count=0", right, names


_FOR_GOOD: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("drive", ("node silent", "heartbeat missing"), "drive 1"),
    ("drive-state", ("node silent",), "drive 1"),
    ("drive-motion", ("node silent",), "drive 1"),
    ("encoder", ("node silent", "heartbeat missing"), "encoder 2"),
    ("load", ("node silent",), "encoder 2"),
    ("sync", ("bus silent",), ""),
    ("all", ("bus silent", "heartbeat missing"), ""),
    ("command", ("motor does not follow", "motor does not move"), "drive 1"),
)


def _late(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    frames = draw.choice(["answers", "drive-state", "load", "sync", "drive", "encoder"])
    text = f"late frames={frames} at={_at(draw)} delay_ms={draw.uniform(0.2, 60):.2f}"
    return f"{text} count={draw.integers(1, 20)}", (GOES_ON,), ""


def _duplicated(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    frames = draw.choice(["answers", "drive-state", "drive-motion", "load", "sync"])
    text = f"duplicated frames={frames} at={_at(draw)} count={draw.integers(1, 20)}"
    return text, (GOES_ON,), "duplicate answer"


def _reordered(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    frames = draw.choice(["answers", "drive", "encoder"])
    text = f"reordered frames={frames} at={_at(draw)} count={draw.integers(1, 20)}"
    return text, (GOES_ON,), ""


def _jitter(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"sync-jitter at={_at(draw)} most_ms={draw.uniform(0.1, 3):.2f}", (GOES_ON,), ""


def _slow(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    node = draw.choice(["drive", "encoder"])
    name = "drive 1" if node == "drive" else "encoder 2"
    which = draw.random()
    if which < 0.4:
        return f"slow-slave frames={node} delay_ms={draw.uniform(0.5, 6.5):.2f}", (GOES_ON,), ""
    if which < 0.7:
        text = f"slow-slave frames={node} delay_ms={draw.uniform(9, 200):.2f}"
        return text, ("WireError",), f"{name} answers SYNC after"
    text = f"slow-slave frames={node} delay_ms={draw.uniform(300, 450):.1f}"
    return text, ("node silent", "heartbeat missing"), name


def _bus_off(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    if draw.random() < 0.4:
        text = f"bus-off at={_at(draw)} for_ms={draw.uniform(20, 90):.1f}"
        return text, (GOES_ON,), "answer lost"
    text = f"bus-off at={_at(draw)} for_ms={draw.uniform(400, 3000):.1f}"
    return text, ("bus silent", "heartbeat missing", "emergency"), ""


def _reset(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    node = draw.choice(["drive", "encoder"])
    name = "drive 1" if node == "drive" else "encoder 2"
    return f"reset node={node} at={_at(draw)}", ("node restarted",), name


def _emergency(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    node = draw.choice(["drive", "encoder"])
    code = int(draw.choice([0x2310, 0x3210, 0x3220, 0x4210, 0x4310, 0x7305, 0x8611, 0xFF01]))
    return f"emcy node={node} code=0x{code:04X} at={_at(draw)}", ("emergency",), f"0x{code:04X}"


_REFUSED = (
    *(("drive", it, "write") for it in ("0x6060", "0x60C2:1", "0x1017", "0x1016", "0x6007")),
    *(("drive", it, "write") for it in ("0x605A", "0x1400:1", "0x1600:0", "0x1800:2", "0x1A00:1")),
    *(("drive", it, "read") for it in ("0x1018:1", "0x608F:1", "0x6076", "0x6041", "0x6061")),
    *(("encoder", it, "write") for it in ("0x1017", "0x1801:1", "0x1A01:0")),
    *(("encoder", it, "read") for it in ("0x1018:2", "0x6001", "0x6002")),
)
_CODES = (0x05040001, 0x06010000, 0x06010002, 0x06020000, 0x06090030, 0x08000022, 0x0F00FFC0)


def _abort(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    node, item, access = _REFUSED[draw.integers(len(_REFUSED))]
    code = _CODES[draw.integers(len(_CODES))]
    text = f"sdo-abort node={node} object={item} access={access} code=0x{code:08X}"
    return text, ("DriveError",), f"abort 0x{code:08X}"


def _stuck(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    if draw.random() < 0.5:
        return f"stuck-encoder encoder=load at={_at(draw)}", ("load does not move",), "load"
    right = ("motor does not move", "motor encoder stuck")
    return f"stuck-encoder encoder=motor at={_at(draw)}", right, "drive 1"


def _jump(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    encoder = draw.choice(["motor", "load"])
    counts = int(draw.integers(1500, 30000)) * int(draw.choice([-1, 1]))
    text = f"encoder-jump encoder={encoder} at={_at(draw)} counts={counts}"
    return text, ("LimitError",), f"the {encoder}'s"


def _noise(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    encoder = draw.choice(["motor", "load"])
    if draw.random() < 0.5:
        text = f"encoder-noise encoder={encoder} at={_at(draw)} counts={draw.uniform(0.5, 15):.2f}"
        return text, (GOES_ON,), ""
    text = f"encoder-noise encoder={encoder} at={_at(draw)} counts={draw.uniform(2e3, 9e3):.0f}"
    return text, ("LimitError",), f"the {encoder}'s"


def _lie(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    which = draw.integers(3)
    if which == 0:
        text = f"lying-statusword at={_at(draw)} power=off value=0x1237"
        return text, ("motor does not move", "motor does not follow"), "drive 1"
    if which == 1:
        value = int(draw.choice([0x0250, 0x0231, 0x0233, 0x0217, 0x0218, 0x0240]))
        text = f"lying-statusword at={_at(draw)} power=on value=0x{value:04X}"
        return text, ("drive not enabled",), "drive 1"
    text = f"lying-statusword at={_at(draw)} power=on value=0x0237"
    return text, ("velocity not followed",), "drive 1"


def _stall(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    if draw.random() < 0.5:
        text = f"{STALL} at={_at(draw)} for_ms={draw.uniform(10, 185):.1f}"
        return text, (GOES_ON,), "slot skipped"
    text = f"{STALL} at={_at(draw)} for_ms={draw.uniform(260, 2000):.1f}"
    return text, ("LimitError",), "slots in a row were missed"


_ON_CANOPEN: tuple[Maker, ...] = (
    _lost_now_and_then,
    _lost_for_good,
    _late,
    _duplicated,
    _reordered,
    _jitter,
    _slow,
    _bus_off,
    _reset,
    _emergency,
    _abort,
    _stuck,
    _jump,
    _noise,
    _lie,
    _stall,
)


def _unanswered(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    kind = draw.choice(["lost", "damaged", "late"])
    if draw.random() < 0.5:
        text = f"{kind} at={_at(draw)} count={draw.integers(1, 4)}"
        return text, (GOES_ON,), "answer lost"
    return f"{kind} at={_at(draw)} count=100000", ("drive silent",), "no answer"


def _twice(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"duplicated at={_at(draw)} count={draw.integers(1, 20)}", (GOES_ON,), ""


def _exception(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    code = int(draw.choice([1, 2, 3, 4, 6, 8, 10, 11, 0x29]))
    if draw.random() < 0.5:
        text = f"exception at={_at(draw)} count={draw.integers(1, 20)} code={code}"
        return text, (GOES_ON,), "exception reply"
    text = f"exception at={_at(draw)} count=100000 code={code}"
    return text, ("drive silent",), f"exception 0x{code:02X}"


def _unplugged_network(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"unplugged at={_at(draw)}", ("drive silent",), "drive 1"


def _unplugged_line(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"unplugged at={_at(draw)}", ("WireError",), "is gone"


_ON_MODBUS: tuple[Maker, ...] = (_unanswered, _twice, _exception, _stall)


def _no_count(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    kind = draw.choice(["counter-lost", "counter-damaged", "counter-fault"])
    if draw.random() < 0.5:
        text = f"{kind} at={_at(draw)} count={draw.integers(1, 20)}"
        return text, (GOES_ON,), "load sample lost"
    return f"{kind} at={_at(draw)} count=0", ("load encoder silent",), "the counter on"


def _late_count(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    text = f"counter-late at={_at(draw)} delay_ms={draw.uniform(0.2, 40):.2f}"
    return f"{text} count={draw.integers(1, 10)}", (GOES_ON,), ""


def _stuck_count(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"counter-stuck at={_at(draw)}", ("load does not move",), "load's encoder"


def _counts_jump(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    counts = int(draw.integers(1500, 30000)) * int(draw.choice([-1, 1]))
    return f"counter-jump at={_at(draw)} counts={counts}", ("LimitError",), "the load's"


def _counter_unplugged(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    return f"counter-unplugged at={_at(draw)}", ("WireError",), "the counter on"


def _drive_emergency(draw: Draw) -> tuple[str, tuple[str, ...], str]:
    code = int(draw.choice([0x2310, 0x3210, 0x7305]))
    return f"emcy node=drive code=0x{code:04X} at={_at(draw)}", ("emergency",), f"0x{code:04X}"


_ON_COUNTER: tuple[Maker, ...] = (
    _no_count,
    _late_count,
    _stuck_count,
    _counts_jump,
    _counter_unplugged,
    _drive_emergency,
)

MAKERS: tuple[tuple[str, Maker], ...] = (
    *(("paper", maker) for maker in _ON_CANOPEN),
    *(("modbus-tcp", maker) for maker in (*_ON_MODBUS, _unplugged_network)),
    *(("modbus-rtu", maker) for maker in (*_ON_MODBUS, _unplugged_line)),
    *(("serial-counter", maker) for maker in _ON_COUNTER),
)


def scenario(seed: int, number: int) -> Scenario:
    """The `number`-th scenario of a campaign: every kind in turn, its values drawn."""
    draw = np.random.default_rng([seed, number])
    rig, maker = MAKERS[number % len(MAKERS)]
    fault, right, names = maker(draw)
    return Scenario(int(draw.integers(1 << 30)), fault, right, names, rig)
