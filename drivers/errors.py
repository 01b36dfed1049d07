"""What can go wrong on a wire.

    DriverError
    ├── SettingsError   the configuration asks for something this wire or drive cannot do
    ├── WireError       the bus, the cable, or a node on it does not answer
    │   └── SyncMissingError    the drive that is to produce SYNC does not
    ├── DriveError      the drive answered, and refused or faulted
    └── StopAskedError  who enters the axis wants it no more; nothing is wrong

A message says what happened, what was seen, what is allowed, and what to do next.
"""


class DriverError(Exception):
    """Anything the drivers raise on purpose."""


class SettingsError(DriverError):
    """The configuration asks for something this wire or drive cannot do."""


class WireError(DriverError):
    """The bus, the cable, or a node on it does not answer."""


class SyncMissingError(WireError):
    """The drive that is to produce SYNC does not: no command acts, SDO may still be heard."""


class DriveError(DriverError):
    """The drive answered, and refused or faulted."""


class StopAskedError(DriverError):
    """A stop was asked before the axis was entered."""

    def __init__(self) -> None:
        super().__init__("a stop was asked before the drive was ready: nothing was played.")
