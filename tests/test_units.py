"""Readers' units in the files that people write: each means what its SI spelling means."""

from pathlib import Path

import numpy as np
import pytest

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import experiment_from_table
from servo_bench.excitation.sequences import MultiAmplitude
from servo_bench.rig import load_rig
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


@pytest.mark.parametrize("value", ["1.5", True])
def test_text_and_truth_are_no_quantities(value: object) -> None:
    with pytest.raises(ValueError, match=r"gap_deg = .*give a number, without quotation marks"):
        to_si({"gap_deg": value})


@pytest.mark.parametrize("value", [None, [1.0, "2"], [1.0, True], {"a": 1.0}])
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
    with pytest.raises(ConfigError, match=r"amplitudes_deg_s\.0: .* greater than 0, got 0\.0"):
        experiment_from_table(
            {"identification": {"kind": "multi-amplitude", "amplitudes_deg_s": [0.0, 60.0]}}, "x"
        )


RIG = """
name = "axis"
[nominal]
torque_constant_nm_per_a = 0.036
inertia_kg_m2 = {inertia}
proportional_gain_a_s_per_rad = 0.35
integral_gain_a_per_rad = 27.0
backlash_gap_deg = 1.5
[bus]
interface = "virtual"
[drive]
node_id = 1
eds = "eds/sim_drive.eds"
counts_per_revolution = 65536
[encoder]
node_id = {encoder}
eds = "eds/sim_encoder.eds"
counts_per_revolution = 65536
[limits]
{limits}
run_time_s = 100.0
"""
GOOD = "velocity_deg_s = 400\ntravel_deg = 720"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"limits": "velocity_deg_s = 400\ntravel_dge = 720"}, r"Is limits\.travel_deg meant\?"),
        ({"limits": "velocity_degs = 400\ntravel_deg = 720"}, r"Is limits\.velocity_deg_s meant"),
        ({"limits": 'velocity_deg_s = 400\ntravel_deg = "720"'}, "travel_deg = '720': give a num"),
        ({"limits": "velocity_deg_s = -400\ntravel_deg = 720"}, r"velocity_deg_s: .* got -400"),
        ({"inertia": "true"}, "inertia_kg_m2 = True: give a number"),
        ({"inertia": '"2.5e-4"'}, "inertia_kg_m2 = '2.5e-4': give a number"),
        ({"encoder": "1"}, "drive.node_id and encoder.node_id are both 1"),
    ],
)
def test_what_is_wrong_is_said_in_the_words_that_were_written(
    tmp_path: Path, changes: dict[str, str], says: str
) -> None:
    file = tmp_path / "rig.toml"
    values = {"inertia": "2.5e-4", "encoder": "2", "limits": GOOD}
    file.write_text(RIG.format(**values))
    load_rig(file)
    file.write_text(RIG.format(**{**values, **changes}))
    with pytest.raises(ConfigError, match=says):
        load_rig(file)
