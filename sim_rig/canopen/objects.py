"""A device's object dictionary with its values: what SDO reads and writes, and PDOs map.

The dictionary itself comes from an EDS file. Access, length, and limits are checked here, with
the abort codes of CiA 301 table 22; what only the device can judge, its hooks judge.
"""

from collections.abc import Callable
from importlib.resources import as_file, files

import canopen
from canopen.objectdictionary import INTEGER_TYPES, ODArray, ODRecord, ODVariable

Address = tuple[int, int]
"""Index and sub-index."""

Hook = Callable[[int], None]
"""Called with a value about to be stored; may act on it, or refuse by raising an abort."""


class Abort:
    """SDO abort codes of CiA 301, table 22."""

    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_TOO_LONG = 0x06040042
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    INVALID_VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    DEVICE_STATE = 0x08000022


def refuse(code: int) -> canopen.SdoAbortedError:
    """The abort to raise."""
    return canopen.SdoAbortedError(code)


def load_dictionary(eds: str, node_id: int) -> canopen.ObjectDictionary:
    """One of this package's own EDS files, for a node."""
    with as_file(files("sim_rig") / "eds" / eds) as path:
        return canopen.import_od(str(path), node_id)


class ObjectStore:
    """The values of one device. Duck-typed as the node that `canopen.sdo.SdoServer` serves.

    Integers are read and written by (index, sub-index) as by a dictionary, without any check:
    that is the device's own side. `get_data` and `set_data` are the master's side.
    """

    def __init__(self, dictionary: canopen.ObjectDictionary) -> None:
        self.object_dictionary = dictionary
        self._device_defaults: dict[Address, int] = {}
        self._values: dict[Address, int] = {}
        self._hooks: dict[Address, Hook] = {}
        self._variables: dict[Address, ODVariable] = {}

    def __getitem__(self, address: Address) -> int:
        value = self._values.get(address)
        if value is None:
            value = self._values[address] = self._default(address)  # asked for in every cycle
        return value

    def __setitem__(self, address: Address, value: int) -> None:
        self._values[address] = value

    def set_default(self, address: Address, value: int) -> None:
        """A default of this very device, where it differs from its EDS; from now on its value."""
        self._device_defaults[address] = value
        self._values.pop(address, None)

    def on_write(self, address: Address, hook: Hook) -> None:
        """Have `hook` called before the master's value is stored, one hook for an address."""
        self._hooks[address] = hook

    def restore(self, first: int = 0x1000, last: int = 0xFFFF) -> None:
        """Back to defaults from index `first` to `last`; no hook is called."""
        for address in [a for a in self._values if first <= a[0] <= last]:
            del self._values[address]

    def variable(self, index: int, subindex: int) -> ODVariable:
        """The entry of the dictionary. Aborts where there is none."""
        known = self._variables.get((index, subindex))
        if known is None:
            known = self._variables[index, subindex] = self._looked_up(index, subindex)
        return known

    def _looked_up(self, index: int, subindex: int) -> ODVariable:
        if index not in self.object_dictionary:
            raise refuse(Abort.NO_OBJECT)
        entry = self.object_dictionary[index]
        if isinstance(entry, ODRecord | ODArray):
            # not `in`: canopen invents the members an array lacks
            if subindex not in entry.subindices:
                raise refuse(Abort.NO_SUBINDEX)
            entry = entry.subindices[subindex]
            subindex = 0
        if subindex:
            raise refuse(Abort.NO_SUBINDEX)
        variable: ODVariable = entry
        return variable

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """The bytes of an object, as the wire has them."""
        variable = self.variable(index, subindex)
        if check_readable and not variable.readable:
            raise refuse(Abort.WRITE_ONLY)
        if variable.data_type in INTEGER_TYPES:
            return bytes(variable.encode_raw(self[index, subindex]))
        return bytes(variable.encode_raw(variable.default or ""))

    def set_data(
        self, index: int, subindex: int, data: bytes, check_writable: bool = False
    ) -> None:
        """Write the bytes of an object: access, length, the device's own rules, then limits."""
        variable = self.variable(index, subindex)
        if check_writable and not variable.writable:
            raise refuse(Abort.READ_ONLY)
        if 8 * len(data) != len(variable):
            raise refuse(Abort.TOO_LONG if 8 * len(data) > len(variable) else Abort.TOO_SHORT)
        value = int(variable.decode_raw(bytes(data)))
        hook = self._hooks.get((index, subindex))
        if hook is not None:
            hook(value)
        if variable.max is not None and value > variable.max:
            raise refuse(Abort.TOO_HIGH)
        if variable.min is not None and value < variable.min:
            raise refuse(Abort.TOO_LOW)
        self._values[index, subindex] = value

    def _default(self, address: Address) -> int:
        if address in self._device_defaults:
            return self._device_defaults[address]
        default = self.variable(*address).default
        return default if isinstance(default, int) else 0
