"""Drive profiles: what ships, what each makes of its drive, and that a new one needs no code."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.axis import Sample
from drivers.canopen.profile import DriveProfile, load_profile, profile_names
from drivers.canopen.settings import CanopenSettings, SecondEncoder
from drivers.errors import DriveError, DriverError, SettingsError
from servo_bench.rig import load_rig, rig_from_table
from tests.fake_canopen import I16, I32, U32, Entry, FakeRig

MILLI_RPM, RPM, TENTH_RPM = 0xFDB44700, 0x00B44700, 0xFFB44700
RAD_S_PER_RPM = 2 * 3.141592653589793 / 60


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    return FakeRig(tmp_path, monkeypatch)


def remove(rig: FakeRig, *indices: int) -> None:
    for key in [key for key in rig.drive.objects if key[0] in indices]:
        del rig.drive.objects[key]


def become_epos4(rig: FakeRig) -> None:
    """The objects of an EPOS4 as its EDS of firmware 0x0170 has them."""
    remove(rig, 0x1006, 0x1013, 0x608F, 0x6091, 0x6092)
    objects = rig.drive.objects
    objects[0x1018, 1] = Entry(U32, 0xFB, writable=False)
    objects[0x60A9, 0] = Entry(U32, RPM)
    objects[0x6076, 0] = Entry(U32, 640_000, writable=False)  # uN m
    for sensor in (1, 2, 3):
        objects[0x60E4, sensor] = Entry(I32, 0, writable=False, mappable=True)
    objects[0x30D1, 2] = Entry(I32, 0, writable=False, mappable=True)
    objects[0x60C2, 1].value = 0


def become_asda_a2(rig: FakeRig) -> None:
    """Profile velocity only, no 0x60A9; the external encoder is a manufacturer's object."""
    remove(rig, 0x1013, 0x608F, 0x6091, 0x6092, 0x60A9, 0x60C2)
    rig.drive.objects[0x1018, 1] = Entry(U32, 0x1DD, writable=False)
    rig.drive.objects[0x2511, 0] = Entry(I32, 0, writable=False, mappable=True)
    rig.drive[0x6502, 0] = 1 << 2


def profiled(rig: FakeRig, name: str, **changes: object) -> CanopenSettings:
    return rig.settings(
        node={"vendor_id": None}, encoder=False, profile=load_profile(name), **changes
    )


def one_sample(rig: FakeRig, settings: CanopenSettings, velocity_rad_s: float = 1.0) -> Sample:
    """Enter, play two slots, and give back the second's sample."""
    with rig.axis(settings) as axis:
        for slot in range(2):
            axis.command(velocity_rad_s, slot)
            samples = axis.samples(rig.world.now_ns + 8_000_000)
    assert rig.nothing_enabled()
    return samples[-1]


def test_each_shipped_profile_says_what_it_is_and_where_it_is_from() -> None:
    assert {"generic", "maxon-epos4", "nanotec", "delta-asda-a2"} <= set(profile_names())
    for name in profile_names():
        profile = load_profile(name)
        assert profile.title
        assert profile.sources


def test_an_epos4_gets_its_units_its_second_encoder_and_its_current(rig: FakeRig) -> None:
    become_epos4(rig)
    second = SecondEncoder(counts_per_revolution=4096, sensor=2, direction=-1)
    settings = profiled(rig, "maxon-epos4", second_encoder=second)
    drive = rig.drive
    drive.objects[0x60E4, 2].value = 1024
    drive.objects[0x6077, 0].value = 500
    drive.objects[0x30D1, 2].value = 1500
    sample = one_sample(rig, settings)
    assert drive[0x60A9, 0] == MILLI_RPM
    assert (drive[0x60C2, 1], drive[0x60C2, 2]) == (8, -3)
    assert drive[0x605A, 0] == 6
    assert drive[0x1A01, 0] == 2
    assert drive[0x1A01, 2] == 0x60E40220
    assert drive[0x1A02, 1] == 0x30D10220
    assert sample.load_angle_counts == 1024
    assert sample.load_angle_rad == pytest.approx(-3.141592653589793 / 2)
    assert sample.encoder_answered_ns is not None
    assert sample.motor_torque_nm == pytest.approx(0.32)  # half of 0.64 N m
    assert sample.motor_current_a == pytest.approx(1.5)
    command = [data for cob_id, data in rig.world.sent if cob_id == 0x201]
    digits = {int.from_bytes(data[2:6], "little", signed=True) for data in command}
    assert round(1.0 / (RAD_S_PER_RPM * 1e-3)) in digits


def test_an_asda_a2_runs_in_profile_velocity_at_a_tenth_of_an_rpm(rig: FakeRig) -> None:
    become_asda_a2(rig)
    second = SecondEncoder(counts_per_revolution=4000)
    settings = profiled(rig, "delta-asda-a2", mode="pv", second_encoder=second)
    with rig.axis(settings) as axis:
        told = {event.kind: event.text for event in axis.events()}
        axis.command(1.0, 0)
        axis.samples(rig.world.now_ns + 8_000_000)
    assert rig.drive[0x1006, 0] == 8000
    assert rig.drive[0x1A01, 2] == 0x25110020
    assert "1 SYNC(s) after" in told["command delay"]
    assert "ramps" in told
    command = [data for cob_id, data in rig.world.sent if cob_id == 0x201]
    digits = {int.from_bytes(data[2:6], "little", signed=True) for data in command}
    assert round(1.0 / (RAD_S_PER_RPM * 0.1)) in digits


REFUSALS: list[tuple[str, Callable[[FakeRig], CanopenSettings], type[DriverError], str]] = [
    (
        "a mode that the drive lacks",
        lambda rig: profiled(rig, "delta-asda-a2", mode="csv"),
        SettingsError,
        r'has no mode "csv". Set drive.mode to pv',
    ),
    (
        "one command for many SYNCs where the drive wants one",
        lambda rig: replace(
            profiled(rig, "delta-asda-a2", mode="pv"), period_s=0.002, command_every=4
        ),
        SettingsError,
        r"wants 0x60C2 and the SYNC period equal",
    ),
    (
        "a period outside of the profile",
        lambda rig: replace(profiled(rig, "delta-asda-a2", mode="pv"), period_s=0.001),
        SettingsError,
        r"allows 2 to 20 ms",
    ),
    (
        "a drive of another maker",
        lambda rig: profiled(rig, "nanotec"),
        DriveError,
        r"vendor_id = 0x1DD.*says 0x26C.*and the profile",
    ),
    (
        "no SYNC period to write",
        lambda rig: (remove(rig, 0x1006), profiled(rig, "delta-asda-a2", mode="pv"))[1],
        DriveError,
        r"no 0x1006 to write",
    ),
    (
        "a second encoder that the EDS lacks",
        lambda rig: profiled(rig, "generic", second_encoder=SecondEncoder(4096), mode="pv"),
        SettingsError,
        r"0x60E4:1 \(additional position\) cannot go into a PDO, or is not there",
    ),
]


@pytest.mark.parametrize(
    ("settings", "error", "words"), [it[1:] for it in REFUSALS], ids=[it[0] for it in REFUSALS]
)
def test_what_a_profile_rules_out_is_refused_before_anything_is_enabled(
    rig: FakeRig,
    settings: Callable[[FakeRig], CanopenSettings],
    error: type[DriverError],
    words: str,
) -> None:
    become_asda_a2(rig)
    with pytest.raises(error, match=words), rig.axis(settings(rig)):
        pytest.fail("entered")
    assert not rig.drive.enabled


def test_two_load_encoders_are_one_too_many(rig: FakeRig) -> None:
    with pytest.raises(SettingsError, match="configured twice"):
        rig.settings(second_encoder=SecondEncoder(4096))


def test_a_command_for_several_syncs_goes_out_once_and_again_after_a_skipped_slot(
    rig: FakeRig,
) -> None:
    settings = replace(rig.settings(), period_s=0.001, command_every=8)
    with rig.axis(settings) as axis:
        rig.world.sent.clear()
        for slot in [*range(20), *range(25, 33)]:
            axis.command(1.0 + slot // 8, slot)
            axis.samples(rig.world.now_ns + 1_000_000)
        order = [cob_id for cob_id, _ in rig.world.sent if cob_id in (0x201, 0x080)]
    syncs_before = [order[:n].count(0x080) for n, it in enumerate(order) if it == 0x201]
    assert syncs_before == [0, 8, 16, 20, 27]
    assert rig.drive[0x1006, 0] == 1000
    assert (rig.drive[0x60C2, 1], rig.drive[0x60C2, 2]) == (8, -3)


OWN = """
title = "a drive of my own"
mapping = "fixed"
[command]
pdo = 1
[[answers]]
pdo = 1
objects = ["0x6041", "0x6064"]
[stopping]
watchdog = "rpdo-timer"
quick_stop_option = 5
"""


def test_a_new_drive_needs_a_toml_and_no_code(rig: FakeRig, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    for (index, sub), value in {
        (0x1600, 0): 2,
        (0x1600, 1): 0x60400010,
        (0x1600, 2): 0x60FF0020,
        (0x1A00, 0): 2,
        (0x1A00, 1): 0x60410010,
        (0x1A00, 2): 0x60640020,
    }.items():
        rig.drive.objects[index, sub] = Entry(U32, value, writable=False)
    settings = rig.settings(profile=load_profile(str(path)))
    with rig.axis(settings) as axis:
        assert rig.drive[0x1400, 5] == 300
        assert rig.drive[0x605A, 0] == 5
        assert axis.command(1.0, 0)
        (sample,) = axis.samples(rig.world.now_ns + 8_000_000)
    assert sample.motor_position_counts is not None
    assert sample.motor_torque_nm is None
    assert rig.drive[0x1400, 5] == 0, "disarmed after a stop that was confirmed"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("title = ", "is not TOML"),
        ('title = "x"', "answers: Field required"),
        (OWN.replace("0x6064", "0x606C"), "no answer holds 0x6064"),
        (OWN.replace('"0x6041", ', '"0x6041", "0x6041", '), "twice in one"),
        (OWN.replace("[command]", "[command]\nspeed = 3"), "command.speed: Extra inputs"),
        (OWN.replace("0x6041", "6041 hex"), "invalid literal"),
        (OWN.replace("0x6041", "0x60411"), "0x1000 to 0xFFFF"),
        (OWN.replace('objects = ["0x6041"', "objects = [41"), "write .0x60E4."),
        (OWN.replace("rpdo-timer", "prayer"), "stopping.watchdog"),
    ],
)
def test_a_profile_that_cannot_be_is_refused_in_words(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=words):
        load_profile(str(path))


def test_a_profile_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(SettingsError, match="Choose one of delta-asda-a2, generic"):
        load_profile("acme")


def test_a_rig_file_names_a_profile_and_a_second_encoder(tmp_path: Path) -> None:
    table = load_rig("rigs/paper.toml").model_dump(mode="json")
    second = {"counts_per_revolution": 4096, "sensor": 1, "direction": -1}
    table["drive"] |= {"profile": "maxon-epos4", "second_encoder": second}
    table["encoder"] = None
    settings = rig_from_table(table, "test").canopen_settings(0.008)
    assert settings.drive.profile == load_profile("maxon-epos4")
    assert settings.drive.second_encoder == SecondEncoder(4096, 1, -1)
    simulated = rig_from_table(table, "test").simulation_settings()
    assert simulated.load_counts_per_revolution == 4096


def test_current_by_the_standard_is_per_mille_of_the_rated(rig: FakeRig) -> None:
    rig.drive.objects[0x6075, 0] = Entry(U32, 5000, writable=False)
    rig.drive.objects[0x6078, 0] = Entry(I16, 200, writable=False, mappable=True)
    rig.drive.objects[0x60E4, 1] = Entry(I32, 7, writable=False, mappable=True)
    settings = rig.settings(encoder=False, second_encoder=SecondEncoder(4096))
    sample = one_sample(rig, settings)
    assert sample.motor_current_a == pytest.approx(1.0)
    assert sample.load_angle_counts == 7


def test_the_generic_profile_maps_no_more_than_is_wanted(rig: FakeRig) -> None:
    generic: DriveProfile = load_profile("generic")
    assert generic.offers_load_position
    with rig.axis() as axis:
        assert axis.events() == []
    assert rig.drive[0x1802, 1] >> 31 == 1, "the third answer is for a second encoder only"
