"""The software rig's registers, and which CiA 402 object is behind each.

    0x0000  vendor                     const 0x5342     0x0100  controlword         0x6040
    0x0001  product                    const 402        0x0101  target velocity     0x60FF  (2)
    0x0010  communication timeout, ms  0 is off         0x0200  statusword          0x6041
    0x0011  reaction to it             0x6007           0x0201  time of sample, us  0x1013  (2)
    0x0012  motor counts per turn      0x608F:1 (2)     0x0203  motor position      0x6064  (2)
    0x0014  load counts per turn       const    (2)     0x0205  load position       0x60E4:1 (2)
    0x0016  rated torque, mN m         0x6076   (2)     0x0207  motor velocity      0x606C  (2)
    0x0018  rated current, mA          0x6075   (2)     0x0209  torque, per mille   0x6077
    0x001A  quick stop option          0x605A           0x020A  current, per mille  0x6078
    0x001C  quick stop deceleration    0x6085   (2)     0x020B  error code          0x603F
                                                        0x020C  temperature, 0.1 degrees
                                                        0x020D  spare, reads 0      (3)

(2) are two registers, high word first; both must be written in one request. Increments are counts
of the motor encoder. The same registers answer as holding and as input registers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from sim_rig.canopen.objects import Address


class Own(Enum):
    """What is no object of CiA 402."""

    VENDOR = "vendor"
    PRODUCT = "product"
    TIMEOUT = "communication timeout"
    LOAD_COUNTS = "load counts per revolution"
    TEMPERATURE = "drive temperature"
    SPARE = "spare"


@dataclass(frozen=True, slots=True)
class Entry:
    """One quantity: its first register, how many, and what is behind it."""

    address: int
    words: int
    behind: Address | Own
    writable: bool = False

    @property
    def end(self) -> int:
        """The register after its last."""
        return self.address + self.words


VENDOR, PRODUCT = 0x5342, 402

TABLE = (
    Entry(0x0000, 1, Own.VENDOR),
    Entry(0x0001, 1, Own.PRODUCT),
    Entry(0x0010, 1, Own.TIMEOUT, writable=True),
    Entry(0x0011, 1, (0x6007, 0), writable=True),
    Entry(0x0012, 2, (0x608F, 1)),
    Entry(0x0014, 2, Own.LOAD_COUNTS),
    Entry(0x0016, 2, (0x6076, 0)),
    Entry(0x0018, 2, (0x6075, 0)),
    Entry(0x001A, 1, (0x605A, 0), writable=True),
    Entry(0x001C, 2, (0x6085, 0), writable=True),
    Entry(0x0100, 1, (0x6040, 0), writable=True),
    Entry(0x0101, 2, (0x60FF, 0), writable=True),
    Entry(0x0200, 1, (0x6041, 0)),
    Entry(0x0201, 2, (0x1013, 0)),
    Entry(0x0203, 2, (0x6064, 0)),
    Entry(0x0205, 2, (0x60E4, 1)),
    Entry(0x0207, 2, (0x606C, 0)),
    Entry(0x0209, 1, (0x6077, 0)),
    Entry(0x020A, 1, (0x6078, 0)),
    Entry(0x020B, 1, (0x603F, 0)),
    Entry(0x020C, 1, Own.TEMPERATURE),
    Entry(0x020D, 3, Own.SPARE),
)
BY_REGISTER = {register: entry for entry in TABLE for register in range(entry.address, entry.end)}


def runs() -> Iterator[tuple[int, int]]:
    """Address and length of every unbroken run of registers."""
    first = last = TABLE[0].address
    for entry in TABLE:
        if entry.address > last:
            yield first, last - first
            first = entry.address
        last = entry.end
    yield first, last - first
