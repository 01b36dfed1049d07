"""Nodes that restart, fault, or lie about their state."""

from sim_rig.faults.fault import Fault

_GENERIC = 0x01


class Reset(Fault):
    """The node loses its supply for an instant: boot-up frame, set-up forgotten, power off."""

    def begin(self) -> None:
        """Restart."""
        self.targets.node(str(self.values["node"])).power_cycle(self.now_us)


class Emergency(Fault):
    """The node sends the emergency `code`; a drive falls into fault with it."""

    def begin(self) -> None:
        """Trip."""
        code = int(self.values["code"])
        if self.values["node"] == "drive":
            self.targets.drive.trip(code)
        else:
            self.targets.encoder_node.emergency(code, _GENERIC)


class LyingStatusword(Fault):
    """The statusword is `value` from SYNC `at` on, whatever the drive does.

    With `power = off` its power stage lets go at the same time, and nothing says so.
    """

    def begin(self) -> None:
        """Lie."""
        value = int(self.values["value"])
        self.targets.drive.status_filter = lambda _true: value
        if self.values["power"] == "off":
            self.targets.drive.let_go()

    def rearm(self) -> None:
        """Tell the truth again."""
        super().rearm()
        self.targets.drive.status_filter = None
