"""Units on the wire."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.scaling import (
    INCREMENTS_PER_SECOND,
    MILLI_RPM,
    RPM,
    Unwrapper,
    check_ratio,
    drive_scale,
    velocity_unit_rad_s,
)
from drivers.errors import SettingsError


@pytest.mark.parametrize(
    ("unit", "digits_of_one_turn_per_second"),
    [
        (RPM, 60),
        (MILLI_RPM, 60_000),
        (INCREMENTS_PER_SECOND, 65536),
        (0x00B40300, 1),  # revolutions/s
        (0xFFB54700, 10 * 60 * 65536),  # tenths of increments/min
        (0x02B44700, 0.6),  # hundreds of rpm
    ],
)
def test_velocity_units(unit: int, digits_of_one_turn_per_second: float) -> None:
    rad_s = digits_of_one_turn_per_second * velocity_unit_rad_s(unit, 65536)
    assert rad_s == pytest.approx(2 * math.pi, rel=1e-12)


@pytest.mark.parametrize("unit", [0x00000000, 0x00414700, 0x00B44800, 0x00010300])
def test_an_unknown_velocity_unit_is_refused_in_words(unit: int) -> None:
    with pytest.raises(SettingsError, match=f"0x{unit:08X}.*0x00B44700 rpm.*Set 0x60A9"):
        velocity_unit_rad_s(unit, 65536)


@given(
    modulus=st.integers(3, 1 << 32),
    start=st.integers(0, (1 << 32) - 1),
    steps=st.lists(st.fractions(-1, 1), max_size=30),
    signed=st.booleans(),
)
def test_unwrapping_follows_any_motion_below_half_a_modulus(
    modulus: int, start: int, steps: list[float], signed: bool
) -> None:
    def shown(count: int) -> int:
        wrapped = count % modulus
        return wrapped - modulus if signed and wrapped > modulus // 2 else wrapped

    unwrap = Unwrapper(modulus)
    true = start
    offset = true - unwrap(shown(true))
    for step in steps:
        true += int(step * ((modulus - 1) // 2))
        assert unwrap(shown(true)) + offset == true


@given(
    counts=st.integers(1, 1 << 24),
    gear=st.floats(0.01, 100),
    direction=st.sampled_from([1, -1]),
)
def test_angle_and_velocity_have_the_same_sign_and_gear(
    counts: int, gear: float, direction: int
) -> None:
    scale = drive_scale(counts, gear, direction, INCREMENTS_PER_SECOND, rated_torque_nm=0.64)
    assert scale.rad_per_count == pytest.approx(scale.rad_s_per_digit)
    assert scale.rad_per_count * counts * gear == pytest.approx(direction * 2 * math.pi)
    assert scale.nm_per_digit == pytest.approx(direction * 0.00064)


def test_a_ratio_that_differs_shows_both_figures() -> None:
    check_ratio("what", "counts", 4096, 8192, 2)
    with pytest.raises(SettingsError, match=r"what = 10000 / 1.*counts = 65536"):
        check_ratio("what", "counts", 65536, 10000, 1)
    with pytest.raises(SettingsError, match="7 / 0"):
        check_ratio("what", "counts", 7, 7, 0)
