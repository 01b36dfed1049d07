"""Watching the nodes while the axis runs: emergencies, reboots, heartbeats, statusword, strangers.

Called with every frame that is no answer, and once per period. Keeps what happened until `drain`.
What ends the trust in the axis is told once per run, kind and node, but for emergencies, which are
told each; of what may come in every slot (answers lost, or not asked for) the first eight are told,
and how many there were at the end; of frames that are nobody's the first eight COB-IDs.
"""

import struct

from drivers.axis import WireEvent
from drivers.canopen import cia402
from drivers.canopen.node import OPERATIONAL

_EMERGENCY = struct.Struct("<HB5s")
_BOOT_UP = 0x00
_ERROR_BUS_OFF = 0x40
_ERROR_CLASSES = (
    (0x01, "TX timeout"),
    (0x02, "lost arbitration"),
    (0x04, "controller"),
    (0x08, "protocol violation"),
    (0x10, "transceiver"),
    (0x20, "no acknowledgement"),
    (0x80, "bus error"),
    (0x100, "controller restarted"),
)
_TOLD = 8
_ENABLED_MASK, _ENABLED = 0x6F, 0x27


class Watch:
    """What happens beside the samples.

    `statusword_mask`/`statusword_value` describe a good statusword, `first_fatal` is what ended the
    trust in the axis.
    """

    def __init__(self, heartbeat_timeout_s: float, *, csv: bool) -> None:
        follows = cia402.FOLLOWS_COMMAND if csv else 0
        self.statusword_mask = _ENABLED_MASK | follows
        self.statusword_value = _ENABLED | follows
        self.lost_node = False
        self.first_fatal: WireEvent | None = None
        self._counts: dict[tuple[str, str], int] = {}
        self._timeout_ns = round(heartbeat_timeout_s * 1e9)
        self._last_heartbeat_ns: dict[str, int] = {}
        self._guarded: set[str] = set()
        self._events: list[WireEvent] = []
        self._told: set[tuple[str, str]] = set()
        self._strangers: set[int] = set()

    def expect_heartbeat(self, name: str, now_ns: int, *, guarded: bool = False) -> None:
        """From now on this node must be heard within the timeout, by itself or when asked."""
        self._last_heartbeat_ns[name] = now_ns
        if guarded:
            self._guarded.add(name)

    def tell(
        self, now_ns: int, kind: str, text: str, *, fatal: bool = False, key: str | None = None
    ) -> None:
        """Add an event; with a `key`, only the first of its kind and key."""
        if key is not None:
            if (kind, key) in self._told:
                return
            self._told.add((kind, key))
        event = WireEvent(now_ns, kind, text, fatal)
        self._events.append(event)
        if fatal and self.first_fatal is None:
            self.first_fatal = event

    def _tell_some(self, now_ns: int, kind: str, text: str, *, name: str) -> None:
        """Add an event of what may come in every slot: the session could not take them all."""
        count = self._counts.get((kind, name), 0) + 1
        self._counts[kind, name] = count
        if count <= _TOLD:
            more = " Further ones are counted, not told." if count == _TOLD else ""
            self.tell(now_ns, kind, text + more)

    def tell_totals(self, now_ns: int) -> None:
        """Tell how many there were of what was counted only at last."""
        for (kind, name), count in self._counts.items():
            if count > _TOLD:
                text = f"{name}: {count} in all, of which the first {_TOLD} were told."
                self.tell(now_ns, kind, text)

    def drain(self) -> list[WireEvent]:
        """Everything since the last call."""
        events, self._events = self._events, []
        return events

    def forget(self) -> None:
        """Tell what was told once more when it comes again."""
        self._told.clear()
        self._counts.clear()
        self._strangers.clear()

    def on_heartbeat(self, name: str, data: bytearray, now_ns: int) -> None:
        """A heartbeat or boot-up frame of a node."""
        self._last_heartbeat_ns[name] = now_ns
        state = data[0] & 0x7F if data else OPERATIONAL
        if state == OPERATIONAL:
            return
        self.lost_node = True
        if state == _BOOT_UP:
            text = (
                f"{name} has restarted by itself (boot-up frame): it has forgotten its set-up and "
                "its power stage is off. Check its supply, then run again."
            )
            self.tell(now_ns, "node restarted", text, fatal=True, key=name)
        else:
            text = (
                f"{name} has left NMT operational (state 0x{state:02X}): it no longer answers "
                "SYNC. See who else is master on this bus."
            )
            self.tell(now_ns, "node not operational", text, fatal=True, key=name)

    def on_emergency(self, name: str, data: bytearray, now_ns: int) -> None:
        """An emergency frame of a node; code 0x00xx tells that an error has gone."""
        if len(data) != _EMERGENCY.size:
            self.tell(now_ns, "malformed emergency", f"{name} sent {data.hex(' ')}.", fatal=True)
            return
        code, register, own = _EMERGENCY.unpack(data)
        if code >> 8 == 0:
            gone = f"{name} reports that its error has gone."
            self._tell_some(now_ns, "emergency over", gone, name=name)
            return
        text = (
            f"{name} sent the emergency {cia402.describe_error_code(code)}, error register "
            f"0x{register:02X}, manufacturer's bytes {own.hex(' ')}: {cia402.remedy(code)}."
        )
        self.tell(now_ns, "emergency", text, fatal=True)

    def on_statusword(self, name: str, statusword: int, now_ns: int) -> None:
        """A statusword that is not a good one, while the drive should be enabled."""
        if statusword & _ENABLED_MASK != _ENABLED:
            text = f"{name} has left operation enabled: {cia402.describe_statusword(statusword)}."
            self.tell(now_ns, "drive not enabled", text, fatal=True, key=name)
        else:
            text = (
                f"{name} does not follow the velocity command (statusword 0x{statusword:04X}, bit "
                "12 is 0). Check the drive's mode (0x6061), limits, and the SYNC period."
            )
            self.tell(now_ns, "velocity not followed", text, fatal=True, key=name)

    def on_duplicate(self, name: str, now_ns: int) -> None:
        """An answer that nobody asked for."""
        text = f"{name} sent an answer that no SYNC had asked for; it was dropped."
        self._tell_some(now_ns, "duplicate answer", text, name=name)

    def on_lost(self, name: str, slot: int, now_ns: int) -> None:
        """An answer that never came."""
        text = f"{name} did not answer the SYNC of slot {slot}."
        self._tell_some(now_ns, "answer lost", text, name=name)

    def on_silence(self, name: str, timeout_s: float, now_ns: int) -> None:
        """No answer at all, for longer than the answer timeout."""
        text = f"{name} has not answered SYNC for {timeout_s:g} s. Check its cable and its supply."
        self.tell(now_ns, "node silent", text, fatal=True, key=name)

    def on_sync_silence(self, name: str, timeout_s: float, now_ns: int) -> str:
        """No SYNC from the drive that is to produce it; returns the sentence."""
        text = (
            f"no SYNC of {name} for {timeout_s:g} s, which is to produce it (drive.sync): the "
            "drive has restarted, the cable is open, or its supply is gone. Check these."
        )
        self.tell(now_ns, "bus silent", text, fatal=True, key="bus")
        return text

    def on_bus_silence(self, names: list[str], timeout_s: float, now_ns: int) -> None:
        """Nobody answers: this is the bus, not a node."""
        text = (
            f"nobody on the bus has answered SYNC for {timeout_s:g} s ({', '.join(names)}): the "
            "adapter is bus-off, the cable is open, or the supply of all is gone. Check cable, "
            "termination, and bit rate."
        )
        self.tell(now_ns, "bus silent", text, fatal=True, key="bus")

    def on_error_frame(self, classes: int, data: bytearray, now_ns: int) -> None:
        """An error frame of the adapter (Linux: linux/can/error.h). Bus-off is fatal."""
        if classes & _ERROR_BUS_OFF:
            text = (
                "the adapter has gone bus-off: too many errors on the wire. Check cable, "
                "termination, and bit rate; `ip link set <channel> type can restart-ms 100` lets "
                "it come back."
            )
            self.tell(now_ns, "bus-off", text, fatal=True, key="bus")
            return
        names = [name for bit, name in _ERROR_CLASSES if classes & bit]
        text = (
            f"the adapter reports errors on the wire: {', '.join(names) or hex(classes)} "
            f"({bytes(data).hex(' ')}). Check cable, termination, and bit rate."
        )
        self.tell(now_ns, "bus errors", text, key=str(classes))

    def on_malformed(self, name: str, cob_id: int, length: int, wanted: int, now_ns: int) -> None:
        """A PDO of the wrong length: somebody has changed the mapping."""
        text = (
            f"{name} sent PDO 0x{cob_id:03X} with {length} bytes, its mapping has {wanted}. See "
            "who else configures this node."
        )
        self.tell(now_ns, "malformed answer", text, fatal=True, key=name)

    def on_stranger(self, cob_id: int, now_ns: int) -> None:
        """A frame that belongs to no node of this axis."""
        if len(self._strangers) < _TOLD and cob_id not in self._strangers:
            text = f"a frame with COB-ID 0x{cob_id:03X} belongs to no node of this axis."
            self.tell(now_ns, "foreign frame", text)
            self._strangers.add(cob_id)

    def overdue(self, now_ns: int) -> bool:
        """Whether some heartbeat seems late; before judging, take what has arrived."""
        for last_ns in self._last_heartbeat_ns.values():
            if now_ns - last_ns > self._timeout_ns:
                return True
        return False

    def judge_heartbeats(self, now_ns: int) -> None:
        """Tell which heartbeats are late; to be called when nothing unread has arrived."""
        for name, last_ns in self._last_heartbeat_ns.items():
            if now_ns - last_ns > self._timeout_ns:
                guarded = name in self._guarded
                what = "has not answered node guarding" if guarded else "has sent no heartbeat"
                text = (
                    f"{name} {what} for {(now_ns - last_ns) * 1e-9:.2f} s, allowed "
                    f"{self._timeout_ns * 1e-9:g} s. Check its cable and its supply."
                )
                kind = "guarding unanswered" if guarded else "heartbeat missing"
                self.tell(now_ns, kind, text, fatal=True, key=name)
