"""Setting up and enabling: what goes over the wire, and every way in which it can be refused."""

import logging
import math
import re
import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.canopen.line import open_bus
from drivers.canopen.timing import interpolation_time
from drivers.errors import DriveError, DriverError, SettingsError, WireError
from tests.fake_canopen import U16, U32, Entry, FakeRig

Spoil = Callable[[FakeRig], None]


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    monkeypatch.setattr(logging.getLogger("canopen"), "disabled", True)
    return FakeRig(tmp_path, monkeypatch)


def test_the_drive_is_set_up_as_the_wire_contract_says(rig: FakeRig) -> None:
    with rig.axis(period_s=0.008):
        drive, encoder = rig.drive, rig.encoder
        assert drive.enabled
        assert (drive[0x60C2, 1], drive[0x60C2, 2]) == (8, -3)
        assert drive[0x1006, 0] == 8000
        assert drive[0x1016, 1] == 127 << 16 | 300
        assert (drive[0x1017, 0], encoder[0x1017, 0]) == (100, 100)
        assert (drive[0x6007, 0], drive[0x605A, 0], drive[0x6060, 0]) == (3, 2, 9)
        assert [drive[0x1600, s] for s in range(3)] == [2, 0x60400010, 0x60FF0020]
        assert [drive[0x1A00, s] for s in range(4)] == [3, 0x60410010, 0x60640020, 0x60770010]
        assert [drive[0x1A01, s] for s in range(3)] == [2, 0x606C0020, 0x10130020]
        assert [encoder[0x1A01, s] for s in range(3)] == [2, 0x60040020, 0x10130020]
        assert drive[0x1800, 1] == 0x40000181, "bit 30 stays as the device had it"
        assert [drive[i, 2] for i in (0x1400, 0x1800, 0x1801)] == [1, 1, 1]
        assert drive[0x1802, 1] >> 31, "a default PDO that nobody reads is off"
        assert encoder[0x1800, 1] >> 31
        assert (drive.state, encoder.state) == (5, 5)
    assert rig.nothing_enabled()
    assert drive[0x1016, 1] == 0, "a drive that is left in peace watches nobody"
    assert (drive.state, encoder.state) == (0x7F, 0x7F)


def test_the_mapping_is_changed_only_while_the_pdo_is_invalid(rig: FakeRig) -> None:
    with rig.axis():
        pass  # so that the mapping is not empty to begin with
    valid_at_mapping = []

    def on_write(index: int, sub: int, value: int) -> None:
        if index in (0x1600, 0x1A00, 0x1A01):
            valid_at_mapping.append(not rig.drive[index - 0x200, 1] >> 31)
            assert sub == 0 or rig.drive[index, 0] == 0, "entries change while the count is 0"

    rig.drive.on_write = on_write
    rig.drive[0x6061, 0] = 9
    with rig.axis():
        pass
    assert valid_at_mapping
    assert not any(valid_at_mapping)


def test_a_velocity_in_milli_rpm_a_gear_and_a_direction_are_scaled(rig: FakeRig) -> None:
    rig.drive[0x60A9, 0] = 0xFDB44700
    with rig.axis(gear_ratio=5.0, direction=-1) as axis:
        axis.command(2 * math.pi / 60, 0)  # 1 rpm at the shaft, 5 rpm at the motor
        assert rig.drive[0x60FF, 0] == -5000


def test_what_an_eds_lacks_is_done_without_and_said(rig: FakeRig) -> None:
    without = (0x1013, 0x1016, 0x1017, 0x1006, 0x60A9, 0x608F, 0x6076, 0x6007, 0x60C2, 0x6502)
    with pytest.raises(SettingsError, match=r"no 0x1016: .*drive\.without_watchdog"):
        rig.axis(without=without).__enter__()
    rig.world.closed = 0
    with rig.axis(without=without, without_watchdog=True) as axis:
        axis.command(0.5, 0)
        (sample,) = axis.samples(rig.world.clock.now_ns())
        kinds = {event.kind for event in axis.events()}
    assert sample.motor_position_counts is not None
    assert sample.motor_torque_nm is None
    assert sample.device_time_us == rig.encoder[0x1013, 0]
    assert {"velocity unit assumed", "no torque", "no heartbeat", "master not watched"} <= kinds
    assert [rig.drive[0x1A01, s] for s in range(2)] == [1, 0x606C0020]
    assert rig.nothing_enabled()


def test_a_drive_without_a_product_code_is_taken_where_none_is_wanted(rig: FakeRig) -> None:
    settings = rig.settings()
    asked = rig.settings(node={"product_code": 402})
    del rig.drive.objects[0x1018, 2]
    with rig.axis(settings):
        assert rig.drive.enabled
    with pytest.raises(DriveError, match="0x1018:2"), rig.axis(asked):
        pytest.fail("entered")


def test_an_axis_without_an_encoder_and_in_profile_velocity(rig: FakeRig) -> None:
    rig.drive.follows = False  # in mode PV bit 12 means standstill, and nobody may ask for it
    with rig.axis(encoder=False, mode="pv") as axis:
        assert rig.drive[0x6060, 0] == 3
        axis.command(0.5, 0)
        (sample,) = axis.samples(rig.world.clock.now_ns())
        assert sample.load_angle_rad is None
        assert [e.kind for e in axis.events()] == ["ramps"]
    assert rig.nothing_enabled()


@pytest.mark.parametrize(
    ("period_s", "wire"),
    [(0.008, (8, -3)), (0.0005, (5, -4)), (0.1, (100, -3)), (0.00125, (125, -5)), (1e-6, (1, -6))],
)
def test_a_period_as_0x60c2(period_s: float, wire: tuple[int, int]) -> None:
    assert interpolation_time(period_s) == wire
    assert wire[0] * 10.0 ** wire[1] == pytest.approx(period_s)


@pytest.mark.parametrize("period_s", [0.0081234567, 0.3, 1e-7])
def test_a_period_that_0x60c2_cannot_say(period_s: float) -> None:
    with pytest.raises(SettingsError, match="0x60C2 cannot say it"):
        interpolation_time(period_s)


def spoil_mute(rig: FakeRig) -> None:
    rig.drive.mute = True
    rig.drive[0x1017, 0] = 50


def spoil_gone(rig: FakeRig) -> None:
    rig.world.nodes.remove(rig.drive)
    rig.encoder[0x1017, 0] = 50


def spoil_identity(rig: FakeRig) -> None:
    rig.drive[0x1018, 2] = 0x61500000


def spoil_encoder_identity(rig: FakeRig) -> None:
    rig.encoder[0x1018, 1] = 251


def spoil_mapping(rig: FakeRig) -> None:
    rig.drive.aborts[0x1A00, 2] = 0x06040041


def spoil_mapping_silently(rig: FakeRig) -> None:
    rig.drive.sticky.add((0x1A00, 0))


def spoil_period(rig: FakeRig) -> None:
    rig.drive.aborts[0x60C2, 1] = 0x06090030


def spoil_period_silently(rig: FakeRig) -> None:
    rig.drive.sticky.add((0x60C2, 1))


def spoil_counts(rig: FakeRig) -> None:
    rig.drive[0x608F, 1] = 10000


def spoil_encoder_counts(rig: FakeRig) -> None:
    rig.encoder[0x6001, 0] = 4096


def spoil_modes(rig: FakeRig) -> None:
    rig.drive[0x6502, 0] = 1 << 2


def spoil_mode_shown(rig: FakeRig) -> None:
    rig.drive.on_write = lambda index, sub, value: None


def spoil_type(rig: FakeRig) -> None:
    rig.drive.objects[0x6502, 0] = Entry(U16, 0x104, writable=False)


def spoil_unit(rig: FakeRig) -> None:
    rig.drive[0x60A9, 0] = 0x00414700


def spoil_start(rig: FakeRig) -> None:
    rig.world.drops = lambda cob_id: cob_id == 0x701


def spoil_for_good(rig: FakeRig) -> None:
    rig.drive.fault = 0x3220
    rig.drive[0x603F, 0], rig.drive[0x6041, 0] = 0x3220, 0x0218
    rig.drive.stuck_fault = True


def spoil_voltage(rig: FakeRig) -> None:
    rig.drive.dc_link = False


def spoil_follows(rig: FakeRig) -> None:
    rig.drive.follows = False


def spoil_answers(rig: FakeRig) -> None:
    rig.world.drops = lambda cob_id: cob_id == 0x181


def spoil_bus(rig: FakeRig) -> None:
    def at_sync(count: int) -> None:
        rig.world.dead = count == 3

    rig.world.at_sync = at_sync


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (spoil_gone, WireError, r"drive 1 does not answer.*heard on this bus: 2\. Check node_id"),
        (spoil_mute, WireError, r"drive 1 is on the bus but did not answer.*Power-cycle"),
        (spoil_identity, DriveError, r"product_code = 0x61500000 .*configuration says 0x192"),
        (spoil_encoder_identity, DriveError, r"encoder 2 is another device.*vendor_id = 0xFB"),
        (spoil_mapping, DriveError, r"refuses to write 0x1A00:2.*0x06040041, Object cannot be"),
        (spoil_mapping_silently, DriveError, r"keeps 0x1A00:0 = 0x0 where .* wrote 0x3"),
        (spoil_period, DriveError, r"0x60C2:1.*= 8: SDO abort 0x06090030.*period_s = 0\.008"),
        (spoil_period_silently, DriveError, r"0x60C2:1.*= 8 and keeps 1\..*period_s = 0\.008"),
        (spoil_counts, SettingsError, r"0x608F.*= 10000 / 1.*counts_per_revolution = 65536"),
        (spoil_encoder_counts, SettingsError, r"0x6001\) = 4096 / 1.*encoder\.counts.* = 65536"),
        (spoil_modes, DriveError, r"does not support mode csv.*0x00000004.*drive\.mode of pv"),
        (spoil_mode_shown, DriveError, r"was told mode 9 \(csv\) and shows 0"),
        (spoil_type, DriveError, r"0x6502 .*in another type than the EDS says"),
        (spoil_unit, SettingsError, r"0x00414700.*Set 0x60A9"),
        (spoil_start, WireError, r"did not become operational within 2 s: no heartbeat came"),
        (
            spoil_for_good,
            DriveError,
            r"in fault and a fault reset did not clear it.*0x3220 \(DC link under-voltage\).*"
            r"switch on the DC link",
        ),
        (
            spoil_voltage,
            DriveError,
            r"did not reach operation enabled within 2 s: last state switched on \(statusword "
            r"0x0223, voltage not enabled\)\. Switch on the DC link\. Or raise",
        ),
        (spoil_follows, DriveError, r"is enabled but does not follow.*bit 12 is 0"),
        (spoil_answers, WireError, r"did not answer SYNC within 2 s: no statusword"),
        (spoil_bus, WireError, r"bus .* is gone: (server closed|.*Broken pipe)"),
    ],
)
def test_what_goes_wrong_is_said_and_nothing_is_left_enabled(
    rig: FakeRig, spoil: Spoil, error: type[DriverError], words: str
) -> None:
    settings = rig.settings(node={"product_code": 402})
    spoil(rig)
    with pytest.raises(error, match=words), rig.axis(settings):
        pytest.fail("an axis that cannot be trusted must not be entered")
    assert rig.world.closed == 1
    assert not rig.drive.enabled or rig.world.dead
    assert all(data[2:] == bytes(4) for cob_id, data in rig.world.sent if cob_id == 0x201)


@pytest.mark.parametrize("away_ms", [30.0, 120.0])
def test_a_computer_that_is_away_at_first_is_no_slow_drive(rig: FakeRig, away_ms: float) -> None:
    """A machine that others share is taken away for 10 to 40 ms: every answer then is late."""
    end_ns: list[int] = []

    def be_away(_: int) -> None:
        end_ns[:] = end_ns or [rig.world.now_ns + round(away_ms * 1e6)]
        if rig.world.now_ns < end_ns[0]:
            rig.world.now_ns += 2_500_000

    rig.world.at_sync = be_away
    with rig.axis(rig.settings(period_s=0.001)):
        assert rig.drive.enabled
    assert rig.world.now_ns > end_ns[0]


def test_a_drive_that_is_always_late_is_refused_after_a_while(rig: FakeRig) -> None:
    begun_ns = rig.world.now_ns
    rig.world.at_sync = lambda _: setattr(rig.world, "now_ns", rig.world.now_ns + 2_500_000)
    words = r"answers SYNC after 2\.5\d ms in the middle of 1\d\d, and the period is 1 ms"
    with pytest.raises(WireError, match=words), rig.axis(rig.settings(period_s=0.001)):
        pytest.fail("its answers would pile up")
    assert not rig.drive.enabled
    assert rig.world.now_ns - begun_ns < 2e9


def test_a_fault_that_one_reset_clears_is_reset_once_and_said(rig: FakeRig) -> None:
    rig.drive.fault = 0x8130
    rig.drive[0x603F, 0], rig.drive[0x6041, 0] = 0x8130, 0x0218
    with rig.axis() as axis:
        (event,) = axis.events()
        assert rig.drive.enabled
    assert event.kind == "fault reset"
    assert "0x8130 (heartbeat of the master lost)" in event.text
    assert not event.fatal
    words = [data[0] for cob_id, data in rig.world.sent if cob_id == 0x201]
    rising = [b for a, b in zip([0, *words], words, strict=False) if b & 0x80 and not a & 0x80]
    assert len(rising) == 1


def test_a_drive_found_enabled_is_switched_off_before_anything_is_changed(rig: FakeRig) -> None:
    rig.drive[0x6041, 0] = 0x1237
    states: list[bool] = []
    obey = rig.drive.on_write

    def on_write(index: int, sub: int, value: int) -> None:
        states.append(rig.drive.enabled)
        obey(index, sub, value)

    rig.drive.on_write = on_write
    with rig.axis() as axis:
        assert axis.events()[0].kind == "drive found enabled"
    assert len(states) > 10
    assert states[0]
    assert not any(states[1:-1])
    assert rig.nothing_enabled()


def test_a_missing_or_foreign_eds_is_refused_before_anything_is_sent(rig: FakeRig) -> None:
    settings = rig.settings()
    node = replace(settings.drive.node, eds=rig.folder / "none.eds")
    missing = replace(settings, drive=replace(settings.drive, node=node))
    node = replace(settings.drive.node, eds=rig.folder / "encoder.eds")
    foreign = replace(settings, drive=replace(settings.drive, node=node))
    for bad, words in ((missing, r"none\.eds: No such"), (foreign, "lacks the objects.*0x6040")):
        with pytest.raises(SettingsError, match=words), rig.axis(bad):
            pytest.fail("entered")
    assert rig.world.sent == []
    assert rig.world.closed == 2


def test_a_feed_constant_of_one_is_taken_as_none_and_another_must_fit(rig: FakeRig) -> None:
    rig.drive.objects[0x6092, 1], rig.drive.objects[0x6092, 2] = Entry(U32, 1), Entry(U32, 1)
    with rig.axis():
        assert rig.drive.enabled
    rig.drive[0x6092, 1] = 360
    with pytest.raises(SettingsError, match=r"0x6092.*= 360 / 1.*= 65536"), rig.axis():
        pytest.fail("entered")


def test_an_axis_that_was_not_entered_says_so(rig: FakeRig) -> None:
    with pytest.raises(WireError, match="not been entered"):
        rig.axis().command(0.0, 0)


def closed_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_no_server_on_the_port() -> None:
    port = closed_port()
    with pytest.raises(WireError, match=rf"no socketcand server at 127\.0\.0\.1:{port}.*bus\.port"):
        open_bus({"interface": "socketcand", "host": "127.0.0.1", "port": port, "channel": "can0"})


def test_a_server_that_is_no_socketcand() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        pytest.raises(WireError, match=r"no socketcand server: it said b'SSH-2\.'"),
    ):
        _open_while_answering(server, b"SSH-2.0")


def _open_while_answering(server: socket.socket, words: bytes) -> None:
    def answer() -> None:
        peer, _ = server.accept()
        with peer:
            peer.sendall(words)

    thread = threading.Thread(target=answer)
    thread.start()
    host, port = server.getsockname()
    try:
        open_bus({"interface": "socketcand", "host": host, "port": port, "channel": "can0"})
    finally:
        thread.join()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"interface": "cobweb"}, SettingsError, "'cobweb', which python-can does not know.*slcan"),
        ({}, SettingsError, "bus.interface is None"),
        ({"interface": "socketcand", "host": "x"}, SettingsError, "bus.port = None"),
        ({"interface": "kvaser", "channel": 0}, SettingsError, "cannot open the bus.*Install"),
    ],
)
def test_a_bus_that_cannot_be_opened(
    options: dict[str, str | int], error: type[DriverError], words: str
) -> None:
    with pytest.raises(error, match=words):
        open_bus(options)


def test_an_option_that_the_interface_does_not_know_is_a_settings_error(rig: FakeRig) -> None:
    with pytest.raises(SettingsError, match=r"bananas.*Correct the options of \[bus\]"):
        open_bus({**rig.settings().bus, "bananas": 1})


def test_a_kernel_without_can_or_without_that_interface_says_what_to_do() -> None:
    with pytest.raises(WireError) as caught:
        open_bus({"interface": "socketcan", "channel": "nocan7"})
    assert re.search(r"no CAN\. Load the modules|no such CAN interface", str(caught.value))
