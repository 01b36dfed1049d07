"""Readers' units in the files that people write: each means what its SI spelling means."""

import numpy as np
import pytest

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import experiment_from_table
from servo_bench.excitation.sequences import MultiAmplitude
from servo_bench.units import READER_UNITS, to_si


@pytest.mark.parametrize("suffix", READER_UNITS)
@pytest.mark.parametrize("value", [3, -0.25, [1.0, 2], [], [[1.0, 2.0], [3.0]]])
def test_a_list_is_converted_number_by_number(suffix: str, value: object) -> None:
    si_suffix, factor = READER_UNITS[suffix]

    def each(given: object) -> object:
        if isinstance(given, list):
            return [each(item) for item in given]
        assert isinstance(given, int | float)
        return given * factor

    assert to_si({f"gap{suffix}": value}) == {f"gap{si_suffix}": each(value)}


@pytest.mark.parametrize("value", ["1.5", True, None, [1.0, "2"], [1.0, True], {"a": 1.0}])
def test_what_is_no_number_is_left_to_the_check_under_its_own_name(value: object) -> None:
    assert to_si({"gap_deg": value}) == {"gap_deg": value}


def test_several_amplitudes_in_degrees_are_those_in_radians() -> None:
    sizes = {"kind": "multi-amplitude", "polynomial": "2327"}
    degrees = MultiAmplitude.model_validate(sizes | {"amplitudes_deg_s": [30, 60.0]})
    radians = MultiAmplitude.model_validate(
        sizes | {"amplitudes_rad_s": [np.radians(30), np.radians(60)]}
    )
    assert degrees.amplitudes_rad_s == pytest.approx(radians.amplitudes_rad_s, rel=1e-15)


def test_a_list_given_in_both_units_is_refused() -> None:
    with pytest.raises(ValueError, match="given twice"):
        to_si({"amplitudes_rpm": [1.0], "amplitudes_rad_s": [1.0]})


def test_a_list_in_degrees_that_does_not_fit_is_named() -> None:
    with pytest.raises(ConfigError, match="amplitudes_rad_s"):
        experiment_from_table(
            {"identification": {"kind": "multi-amplitude", "amplitudes_deg_s": [0.0, 60.0]}}, "x"
        )
