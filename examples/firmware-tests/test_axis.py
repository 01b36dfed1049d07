"""Tests of an axis on the software rig: in virtual time, and once on its wire."""

import can
import pytest

from servo_bench.errors import WireError

RIG = "rigs/paper.toml"
EXPERIMENT = "experiments/demo.toml"


def test_the_axis_follows_as_it_should(sim_rig, bench):
    run = bench.run(EXPERIMENT, sim_rig(RIG))
    analysis = bench.analyse(run)
    assert analysis.numbers()["vaf_fresh_order3_percent"] > 94.0
    assert analysis.quality.missed_slots == 0


def test_a_gap_that_wears_by_five_percent_is_seen(sim_rig, bench):
    new = sim_rig(RIG, load_encoder_noise_rad=1e-4)
    worn = sim_rig(RIG, load_encoder_noise_rad=1e-4, backlash_gap_deg=1.575)
    found = bench.compare(bench.run(EXPERIMENT, new), bench.run(EXPERIMENT, worn))
    assert [change.symbol for change in found.parameters if found.is_change(change)] == ["gap"]


def test_a_drive_that_trips_stops_the_run_and_is_named(sim_rig, bench):
    rig = sim_rig(RIG, faults="emcy node=drive code=0x3220 at=120")
    with pytest.raises(WireError, match="DC link under-voltage"):
        bench.run(EXPERIMENT, rig)


def test_a_driver_of_your_own_finds_both_nodes(sim_rig):
    """On the wire: `rig.bus` is what your driver opens, on a free port."""
    rig = sim_rig(RIG, wire=True)
    with can.Bus(**rig.bus) as bus:
        bus.send(can.Message(arbitration_id=0x000, data=[0x81, 0], is_extended_id=False))
        booted = set()
        while len(booted) < 2:
            frame = bus.recv(5.0)
            assert frame is not None, f"only {booted} booted"
            if frame.arbitration_id in (0x701, 0x702):
                booted.add(frame.arbitration_id)
