"""One node seen from the master: its objects by SDO, its NMT state. Errors come in words."""

from canopen.objectdictionary import (
    ObjectDictionary,
    ObjectDictionaryError,
    ODArray,
    ODRecord,
    ODVariable,
)
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from drivers.canopen.line import Line
from drivers.errors import DriveError, WireError

NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL = 0x01, 0x02, 0x80
OPERATIONAL, PRE_OPERATIONAL = 0x05, 0x7F
_NO_RESPONSE = "no SDO response"
_SDO_BYTES = 8
SDO_REQUEST, SDO_RESPONSE, HEARTBEAT, EMERGENCY, SYNC = 0x600, 0x580, 0x700, 0x080, 0x080


class BusSdoClient(SdoClient):
    """canopen's SDO client, reading the bus itself instead of waiting for a notifier thread."""

    def __init__(self, node_id: int, dictionary: ObjectDictionary, line: Line, timeout_s: float):
        SdoClient.__init__(self, SDO_REQUEST + node_id, SDO_RESPONSE + node_id, dictionary)
        self.network = line.network
        self._line = line
        self._timeout_ns = round(timeout_s * 1e9)
        line.network.subscribe(self.tx_cobid, self.on_response)

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) == _SDO_BYTES:  # what is shorter is no SDO: canopen would fall over it
            SdoClient.on_response(self, can_id, data, timestamp)

    def read_response(self) -> bytes:
        deadline_ns = self._line.clock.now_ns() + self._timeout_ns
        if not self._line.receive_until(deadline_ns, lambda: not self.responses.empty()):
            raise SdoCommunicationError(_NO_RESPONSE)
        return bytes(SdoClient.read_response(self))


class Node:
    """A node on the line: `name` is what messages call it, `dictionary` comes from its EDS."""

    def __init__(
        self, name: str, node_id: int, dictionary: ObjectDictionary, line: Line, timeout_s: float
    ) -> None:
        self.name = f"{name} {node_id}"
        self.node_id = node_id
        self.dictionary = dictionary
        self.line = line
        self._timeout_s = timeout_s
        self._client = BusSdoClient(node_id, dictionary, line, timeout_s)

    def has(self, index: int, sub: int = 0) -> bool:
        """Whether the EDS knows the object."""
        return self._listed(index, sub) is not None

    def variable(self, index: int, sub: int = 0) -> ODVariable:
        """The object's entry in the EDS; DriveError where there is none."""
        variable = self._variable(index, sub)
        if variable is None:
            raise DriveError(
                f"{self.name}: the EDS has no object {_label(index, sub)}, which is needed. Use "
                "the EDS of this very device, or a device that has the object."
            )
        return variable

    def read(self, index: int, sub: int = 0) -> int:
        """An integer object by SDO. WireError without answer, DriveError on an abort."""
        variable = self.variable(index, sub)
        try:
            return int(variable.decode_raw(self._client.upload(index, sub)))
        except SdoError as error:
            raise self._refused(error, f"read {self._describe(variable)}") from error
        except (ObjectDictionaryError, ValueError) as error:
            raise DriveError(
                f"{self.name} answered {self._describe(variable)} in another type than the EDS "
                f"says: {error}. Use the EDS of this very device."
            ) from error

    def write(self, index: int, sub: int, value: int, advice: str = "") -> None:
        """Write an integer object by SDO. Errors as `read`; `advice` ends an abort's message."""
        variable = self.variable(index, sub)
        try:
            self._client.download(index, sub, variable.encode_raw(value))
        except SdoError as error:
            what = f"write {self._describe(variable)} = {_number(value)}"
            raise self._refused(error, what, advice) from error

    def configure(self, index: int, sub: int, value: int, advice: str = "") -> None:
        """Write and read back; DriveError where the device keeps another value."""
        self.write(index, sub, value, advice)
        kept = self.read(index, sub)
        if kept != value:
            raise DriveError(
                f"{self.name} took {self._describe(self.variable(index, sub))} = {_number(value)} "
                f"and keeps {_number(kept)}. {advice or 'The device does not support this value.'}"
            )

    def writable(self, index: int, sub: int = 0) -> bool:
        """Whether the EDS knows the object and lets it be written."""
        variable = self._listed(index, sub)
        return variable is not None and bool(variable.writable)

    def mappable(self, index: int, sub: int = 0) -> bool:
        """Whether the EDS knows the object and lets it into a PDO."""
        variable = self._listed(index, sub)
        return variable is not None and bool(variable.pdo_mappable)

    def nmt(self, command: int) -> None:
        """Send an NMT command to this node alone."""
        self.line.send(0x000, bytes((command, self.node_id)))

    def wait_for_state(self, state: int, timeout_s: float) -> int | None:
        """The NMT state in the last heartbeat that came; returns as soon as it is `state`."""
        seen: list[int] = []

        def on_heartbeat(_cob_id: int, data: bytearray, _timestamp: float) -> None:
            if data:
                seen.append(data[0] & 0x7F)

        self.line.network.subscribe(HEARTBEAT + self.node_id, on_heartbeat)
        deadline_ns = self.line.clock.now_ns() + round(timeout_s * 1e9)
        self.line.receive_until(deadline_ns, lambda: seen[-1:] == [state])
        self.line.network.unsubscribe(HEARTBEAT + self.node_id, on_heartbeat)
        return seen[-1] if seen else None

    def _variable(self, index: int, sub: int) -> ODVariable | None:
        return self.dictionary.get_variable(index, sub)

    def _listed(self, index: int, sub: int) -> ODVariable | None:
        """The object's entry where the EDS lists it: canopen invents the members an array lacks."""
        entry = self.dictionary.get(index)
        if isinstance(entry, ODRecord | ODArray) and sub not in entry.subindices:
            return None
        return self._variable(index, sub)

    def _describe(self, variable: ODVariable) -> str:
        return f"{_label(variable.index, variable.subindex)} ({variable.name})"

    def _refused(self, error: SdoError, what: str, advice: str = "") -> DriveError | WireError:
        if isinstance(error, SdoAbortedError):
            reason = SdoAbortedError.CODES.get(error.code, "the manufacturer's own code")
            return DriveError(
                f"{self.name} refuses to {what}: SDO abort 0x{error.code:08X}, {reason}. "
                f"{advice or 'See the manual of the device for what this object allows.'}"
            )
        if str(error) != _NO_RESPONSE:
            return WireError(
                f"{self.name} answered, but not to the question, to {what}: {error}. See whether "
                "another master talks to it."
            )
        heard = self.line.network.scanner.nodes
        if self.node_id in heard:
            return WireError(
                f"{self.name} is on the bus but did not answer an SDO within {self._timeout_s:g} "
                f"s, to {what}. Power-cycle it, or raise sdo_timeout_s."
            )
        others = ", ".join(str(node) for node in sorted(heard)) or "nobody at all"
        return WireError(
            f"{self.name} does not answer on {self.line.name} within {self._timeout_s:g} s, to "
            f"{what}; heard on this bus: {others}. Check node_id, bit rate, cable, and power."
        )


def _label(index: int, sub: int) -> str:
    return f"0x{index:04X}:{sub}" if sub else f"0x{index:04X}"


def _number(value: int) -> str:
    return str(value) if abs(value) < 1000 else f"0x{value:X}"
