"""Frames that are lost, late, doubled, or swapped with the next.

`frames` says which: a COB-ID, or one of sync, command, drive-state, drive-motion, load, answers
(all three), drive, encoder (whatever the node says), all. Of them, from `at` on, each is chosen
with the probability `rate`, `count` times at most (0 is without end).
"""

from collections.abc import Callable

from sim_rig.faults.fault import Fault, Frame, Targets, Values

SYNC = 0x080
_ANSWERS = (0x180, 0x280, 0x380, 0x480)
_OF_NODE = (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)

NAMES = (
    "sync",
    "command",
    "drive-state",
    "drive-motion",
    "load",
    "answers",
    "drive",
    "encoder",
    "all",
)


def chooser(name: str, targets: Targets) -> Callable[[int], bool]:
    """Whether a COB-ID is one of the frames called `name`."""
    drive, encoder = targets.drive_node.node_id, targets.encoder_node.node_id
    of_drive = {base + drive for base in _OF_NODE}
    of_encoder = {base + encoder for base in _OF_NODE}
    answers = {base + node for base in _ANSWERS for node in (drive, encoder)}
    groups = {
        "sync": {SYNC},
        "command": {0x200 + drive},
        "drive-state": {0x180 + drive},
        "drive-motion": {0x280 + drive},
        "load": {0x280 + encoder},
        "answers": answers,
        "drive": of_drive,
        "encoder": of_encoder,
        "all": {SYNC, 0x200 + drive} | of_drive | of_encoder,
    }
    chosen = groups.get(name) or {int(name, 16)}
    return lambda can_id: can_id in chosen


class FrameFault(Fault):
    """Acts on chosen frames, in either direction."""

    def __init__(self, values: Values, targets: Targets, seed: list[int]) -> None:
        self._chosen = chooser(str(values["frames"]), targets)
        super().__init__(values, targets, seed)

    def rearm(self) -> None:
        """Count anew."""
        super().rearm()
        self._left = int(self.values["count"]) or -1

    def incoming(self, frame: Frame) -> list[Frame]:
        """As `outgoing`."""
        return self._filtered(frame)

    def outgoing(self, frame: Frame) -> list[Frame]:
        """The frame, or what has become of it."""
        return self._filtered(frame)

    def _filtered(self, frame: Frame) -> list[Frame]:
        if not (self.active and self._left and self._chosen(frame.can_id)):
            return self.pass_by(frame)
        if self.random.random() >= float(self.values["rate"]):
            return self.pass_by(frame)
        self._left -= 1
        return self.happen(frame)

    def pass_by(self, frame: Frame) -> list[Frame]:
        """A frame that is not chosen."""
        return [frame]

    def happen(self, frame: Frame) -> list[Frame]:
        """A chosen frame."""
        return [frame]


class Lost(FrameFault):
    """The frame never arrives."""

    def happen(self, _frame: Frame) -> list[Frame]:
        """Nothing is left of it."""
        return []


class Late(FrameFault):
    """The frame arrives `delay_ms` later."""

    def happen(self, frame: Frame) -> list[Frame]:
        """Held up."""
        return [frame.later(round(float(self.values["delay_ms"]) * 1000))]


class Jittered(FrameFault):
    """The frame arrives later by a time between 0 and `most_ms`, drawn evenly."""

    def happen(self, frame: Frame) -> list[Frame]:
        """Held up by chance."""
        return [frame.later(round(self.random.uniform(0.0, float(self.values["most_ms"])) * 1000))]


class Duplicated(FrameFault):
    """The frame arrives twice."""

    def happen(self, frame: Frame) -> list[Frame]:
        """Twice."""
        return [frame, frame]


class Reordered(FrameFault):
    """The frame changes places with the next one on its way."""

    def rearm(self) -> None:
        """Hold nothing."""
        super().rearm()
        self._held: list[Frame] = []

    def pass_by(self, frame: Frame) -> list[Frame]:
        """Let the held frame follow this one."""
        held, self._held = self._held, []
        return [frame, *held]

    def happen(self, frame: Frame) -> list[Frame]:
        """Hold it until the next."""
        if self._held:
            return self.pass_by(frame)
        self._held = [frame]
        return []
