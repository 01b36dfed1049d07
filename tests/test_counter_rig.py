"""The software rig's counter: index, line, faults; and when a recording says its samples were."""

import json
import os
import select
import time
import tty
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.axis import Sample
from drivers.counter.profile import load_profile
from servo_bench.daemon.live import _current_a
from servo_bench.kernels.quality import run_quality
from servo_bench.recording.alignment import alignment
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE
from servo_bench.rig import load_rig
from servo_bench.run.rows import read_sample, write_answer
from servo_bench.run.table import SlotTable
from sim_rig.counter.box import CounterBox
from sim_rig.counter.framings import FRAMINGS
from sim_rig.counter.line import in_a_thread
from sim_rig.counter.orders import KINDS, parse
from sim_rig.counter.settings import CounterSettings
from sim_rig.errors import RigSettingsError
from sim_rig.process import settings_from_json
from tests.played_rig import Rig as PlayedRig
from tests.played_rig import experiment as played_experiment
from tests.test_supervisor import watched

PER_REVOLUTION = 4096


def box(*faults: str, modulus: int = 1 << 32, seed: int = 1, enabled: bool = True) -> CounterBox:
    made = CounterSettings("generic-binary", PER_REVOLUTION, modulus=modulus)
    orders = [parse(line) for line in faults]
    return CounterBox(made, lambda time_us: time_us, lambda: enabled, orders, seed)


def read(counter: CounterBox, counts: int) -> dict[str, int] | None:
    """Ask when the encoder stands at `counts`."""
    return load_profile("generic-binary").answers.decode(counter.answer(7, counts).data)


@given(st.lists(st.integers(-9000, 9000), min_size=2, max_size=20))
def test_the_index_is_the_last_whole_turn_that_was_passed(steps: list[int]) -> None:
    counter, place, passed, index = box(), 0, 0, 0
    read(counter, 0)
    for step in steps:
        walk = range(place, place + step, 1 if step > 0 else -1)
        for at in walk:  # one count at a time, by hand
            after = at + (1 if step > 0 else -1)
            if after // PER_REVOLUTION != at // PER_REVOLUTION:
                passed, index = passed + 1, max(at, after) // PER_REVOLUTION * PER_REVOLUTION
        place += step
        told = read(counter, place)
        assert told is not None
        assert (told["index_number"], told["index"]) == (passed % 256, index % (1 << 32))
        assert told["position"] == place % (1 << 32)


@pytest.mark.parametrize(
    ("fault", "hit"),
    [
        ("counter-lost at=3 count=2", {3, 4}),
        ("counter-damaged at=3 count=2", {3, 4}),
        ("counter-stuck at=3 count=2", {4}),
        ("counter-jump at=3 count=2 counts=50", {3, 4}),
        ("counter-fault at=3 count=2", {3, 4}),
    ],
)
def test_a_fault_hits_the_requests_that_it_names_and_no_other(fault: str, hit: set[int]) -> None:
    faulty, good = box(fault), box()
    told = [(read(faulty, 10 * n), read(good, 10 * n)) for n in range(8)]
    assert {n for n, (one, other) in enumerate(told) if one != other} == hit


def test_faults_at_random_repeat_with_the_seed_and_wait_for_the_drive() -> None:
    def lost(seed: int, *, enabled: bool = True) -> list[int]:
        counter = box("counter-lost at=0 count=0 rate=0.3", seed=seed, enabled=enabled)
        return [n for n in range(200) if not counter.answer(1, n).data]

    assert lost(1) == lost(1) != lost(2)
    assert 30 < len(lost(1)) < 90
    assert lost(1, enabled=False) == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("counter-asleep", "there is no 'counter-asleep'"),
        ("counter-lost counts=3", "has no 'counts'; it has at, count, rate"),
        ("counter-late delay_ms=x", "is no number"),
        ("counter-late delay_ms=-1", "0 to 10000"),
        ("counter-lost rate=2", "rate is 0 to 1"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_in_words(line: str, words: str) -> None:
    with pytest.raises(RigSettingsError, match=words):
        parse(line)


def test_every_kind_can_be_ordered_on_a_rig_with_a_counter_and_on_no_other() -> None:
    rig = load_rig("rigs/serial-counter.toml").with_faults(*KINDS)
    made = rig.simulation_settings()
    assert made.counter_faults == tuple(KINDS)
    assert made.wire_faults == ()
    with pytest.raises(Exception, match="this rig has no serial counter"):
        load_rig("rigs/paper.toml").with_faults("counter-lost").simulation_settings()


def test_settings_survive_the_way_into_the_rigs_process() -> None:
    made = load_rig("rigs/serial-counter.toml").simulation_settings()
    again = settings_from_json(json.dumps({**asdict(made), "bus": dict(made.bus)}))
    assert again == made
    assert again.counter is not None


@pytest.mark.parametrize("framing", sorted(FRAMINGS))
def test_bytes_take_their_time_and_a_line_that_is_cut_is_gone(framing: str) -> None:
    made = CounterSettings(framing, PER_REVOLUTION, baud_rate=19200, turnaround_s=0.001)
    profile = load_profile(framing)
    counter = CounterBox(made, lambda us: 5, lambda: True, [parse("counter-unplugged at=2")])

    def ask(number: int, near: int) -> tuple[float, bytes]:
        begun_s, got = time.monotonic(), b""
        os.write(near, profile.asks.encode({"sequence": number}))
        while len(got) < profile.answers.size:
            assert select.select([near], [], [], 10.0)[0], "the counter does not answer"
            data = os.read(near, 256)
            if not data:
                raise EOFError("hung up")
            got += data
        return time.monotonic() - begun_s, got

    with in_a_thread(counter, made) as device:
        near = os.open(device, os.O_RDWR | os.O_NOCTTY)
        try:
            tty.setraw(near)
            bytes_s = (profile.asks.size + profile.answers.size) * 10 / 19200
            for number in range(2):
                took_s, got = ask(number, near)
                assert took_s >= bytes_s + 0.001, "no answer before its last byte could come"
                assert (profile.answers.decode(got) or {})["position"] == 5
            with pytest.raises((EOFError, OSError)):
                ask(2, near)
        finally:
            os.close(near)


def rows(count: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    with SlotTable.create(count) as table:
        made = table.rows.copy()
    made["slot"] = np.arange(count)
    made["asked_ns"] = 8_000_000 * np.arange(count)
    return made


@settings(deadline=None, max_examples=30)
@given(
    drift=st.floats(-2e-4, 2e-4),
    offset_us=st.integers(0, (1 << 32) - 1),
    jitter_us=st.integers(20, 900),
    seed=st.integers(0, 99),
)
def test_the_device_clock_tells_jitter_and_neither_offset_nor_drift_nor_wrapping(
    drift: float, offset_us: int, jitter_us: int, seed: int
) -> None:
    made = rows(2000)
    off_us = np.random.default_rng(seed).uniform(-jitter_us, jitter_us, 2000)
    elapsed_us = made["asked_ns"] * 1e-3 * (1.0 + drift)
    made["device_time_us"] = (offset_us + np.rint(elapsed_us + off_us).astype(np.int64)) % (1 << 32)
    made["device_time_us"][[5, 900]] = MISSING
    told = {it.name: it for it in alignment(made)}["device clock"]
    assert told.missing == 2
    assert told.median_s * 1e6 == pytest.approx(jitter_us / 2, rel=0.15, abs=2.0)
    assert told.p99_s * 1e6 == pytest.approx(jitter_us, rel=0.15, abs=2.0)


def test_delays_are_of_what_came_and_absent_where_nothing_did() -> None:
    made = rows(100)
    made["drive_latency_s"] = np.linspace(1e-3, 2e-3, 100)
    made["load_sampled_s"][:90] = 2e-4
    told = {it.name: it for it in alignment(made)}
    assert set(told) == {"motor answer", "load sample"}
    assert told["motor answer"].median_s == pytest.approx(1.5e-3)
    assert told["load sample"].facts() == (
        "median_s=0.000200000 p99_s=0.000200000 slots=90 missing=10"
    )
    assert alignment(rows(0)) == ()
    assert alignment({"t_s": np.zeros(3)}) == ()


def test_run_quality_has_the_alignment_of_any_recording() -> None:
    quality = run_quality(PlayedRig().record(played_experiment("2327", fresh=64)))
    told = json.loads(json.dumps(quality.numbers()))["alignment"]
    assert set(told) == {delay.name for delay in quality.alignment}
    assert all(one["slots"] > 0 for one in told.values())


def test_a_sample_comes_back_from_its_row_whole() -> None:
    made = np.zeros(1, SAMPLE_DTYPE)
    with SlotTable.create(1) as table:
        made[0] = table.rows[0]
    made[0]["asked_ns"] = 10_000
    sample = Sample(
        0,
        10_000,
        drive_answered_ns=10_300,
        encoder_answered_ns=11_900,
        statusword=0x1237,
        motor_current_a=1.25,
        motor_sampled_ns=10_000,
        load_sampled_ns=10_174,
        load_angle_counts=7,
        load_angle_rad=0.001,
    )
    write_answer(made[0], sample)
    assert read_sample(made[0]) == sample


def test_the_live_page_has_the_drives_current_or_what_its_torque_takes() -> None:
    current_a = np.array([1.0, np.nan, np.nan])
    torque_nm = np.array([9.0, 0.072, np.nan])
    np.testing.assert_allclose(_current_a(current_a, torque_nm, 0.036), [1.0, 2.0, np.nan])


def test_the_supervisor_trips_on_a_load_encoder_that_answers_no_more() -> None:
    for run in watched(load_rig("rigs/serial-counter.toml")):
        silent = {"load_angle_rad": None, "load_angle_counts": None, "encoder_answered_ns": None}
        assert run.play(50) is None
        trip = run.play(150, **silent)
        assert trip is not None
        assert trip.kind == "bus silent"
        assert "load's encoder has answered no slot for 0.4" in trip.text
    for run in watched(load_rig("rigs/serial-counter.toml")):
        assert run.play(200, **silent) is None, "a rig without a load encoder has none to miss"
