"""A node that refuses an object: the request is answered by an abort and never reaches it."""

import struct

from sim_rig.faults.fault import Fault, Frame, Targets, Values

_SDO_REQUEST, _SDO_ANSWER = 0x600, 0x580
_HEAD = struct.Struct("<BHB")
_READ, _WRITE = 2, 1
"""Client command specifiers: initiate upload, initiate download (CiA 301, 7.2.4.3)."""
_ACCESS = {"read": (_READ,), "write": (_WRITE,), "any": (_READ, _WRITE)}


class SdoAbort(Fault):
    """Aborts `access` to `object` (index, or index:sub; a bare index is each of its members)."""

    def __init__(self, values: Values, targets: Targets, seed: list[int]) -> None:
        self._node = targets.node(str(values["node"])).node_id
        index, _, sub = str(values["object"]).partition(":")
        self._index, self._sub = int(index, 16), int(sub) if sub else None
        self._specifiers = _ACCESS[str(values["access"])]
        self._answers: list[Frame] = []
        super().__init__(values, targets, seed)

    def take_answer(self) -> Frame | None:
        """The abort to be sent instead of the node's answer."""
        return self._answers.pop() if self._answers else None

    def incoming(self, frame: Frame) -> list[Frame]:
        """Everything but the refused request."""
        if frame.can_id != _SDO_REQUEST + self._node or len(frame.data) < _HEAD.size:
            return [frame]
        command, index, sub = _HEAD.unpack_from(frame.data)
        wanted = index == self._index and self._sub in (None, sub)
        if not (self.active and wanted and command >> 5 in self._specifiers):
            return [frame]
        code = int(self.values["code"])
        self._answers.append(
            Frame(_SDO_ANSWER + self._node, struct.pack("<BHBI", 0x80, index, sub, code))
        )
        return []
