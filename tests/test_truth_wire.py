"""The grown truth plant behind the wire: found by its name, fast enough for real time."""

import struct

import pytest

from tests.truth.hidden import wire_nothing
from tests.wire import DRIVE, NOMINAL, PlainMaster, spawned

pytestmark = pytest.mark.wire


def position(master: PlainMaster) -> int:
    """The motor's, in counts."""
    raw = struct.pack("<I", master.sdo(DRIVE, 0x6064))
    return int(struct.unpack("<i", raw)[0])


@pytest.mark.parametrize(
    "plant",
    [
        "tests.truth.plant:make",
        "tests.truth.hidden:wire_one",
        pytest.param("tests.truth.hidden:wire_outside", marks=pytest.mark.long),
    ],
)
def test_the_truth_can_stand_behind_the_wire(plant: str) -> None:
    wire_nothing(NOMINAL, 1)  # compiled here, so that the rig's process finds it in the cache
    with spawned(plant=plant, seed=3) as rig, PlainMaster(rig.bus) as master:
        master.enable()
        for _ in range(10_000):
            master.cycle(0x0F, 40_000)
            if position(master) > 2000:
                break
        assert position(master) > 2000
        master.cycle_until(0x02, 0x40)
