"""`servo-bench sequence …`, and the amplitude that it advises."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from servo_bench.cli.app import app
from servo_bench.diagnosis.judging.extended import toml_lines
from servo_bench.errors import ConfigError
from servo_bench.excitation.amplitude import advise_amplitude
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.excitation.prediction import predict
from servo_bench.rig import RigConfig, load_rig

RUNNER = CliRunner()


def said(*arguments: str) -> str:
    """The output with its line breaks taken out."""
    done = RUNNER.invoke(app, ["sequence", *arguments])
    assert done.exit_code == 0, done.output
    return " ".join(done.output.split())


@pytest.mark.long
def test_search_recommends_and_writes_what_it_found(tmp_path: Path) -> None:
    out = tmp_path / "found.json"
    text = said("search", "--degree", "12", "--memory", "18", "--order", "3", "--json", str(out))
    found = json.loads(out.read_text())
    octals = [candidate["polynomial"] for candidate in found["candidates"]]
    assert "15341" in octals
    assert f"Recommended: {octals[0]}" in text
    assert found["primitives"] == 144


def test_show_draws_a_line_per_order_and_warns_of_aliases(tmp_path: Path) -> None:
    out = tmp_path / "shown.json"
    clean = said("show", "15341", "--memory", "18", "--json", str(out))
    assert "987 elements up to order 3 lie on 987 shifts; 0 of them" in clean
    assert all(f"order {order} |" in clean for order in (1, 2, 3))
    assert "ALIASED" not in clean
    assert "ALIASED" in said("show", "15341", "--memory", "24")
    slices = json.loads(out.read_text())["slices"]
    assert sum(part["length"] for part in slices) == 987


def test_amplitude_stays_inside_the_rigs_limits() -> None:
    text = said("amplitude", "40473", "--rig", "rigs/paper.toml")
    assert "From 93.7 to 319 deg/s the backlash shows" in text
    assert "Recommended" in text


def test_errors_are_the_benchs_own() -> None:
    done = RUNNER.invoke(app, ["sequence", "search", "--degree", "12", "--memory", "19"])
    assert isinstance(done.exception, ConfigError)


def test_the_range_is_that_of_the_excursion_over_the_gap() -> None:
    advice = advise_amplitude(
        backlash_gap_rad=0.02, period_s=0.01, bandwidth_rad_s=50.0, peak_travel_periods=100.0
    )
    assert advice.least_rad_s == pytest.approx(0.5 * 2.0)
    assert advice.most_rad_s == pytest.approx(1.7 * 2.0)
    assert advice.travel_rad == pytest.approx(3.4)
    assert advice.least_rad_s < advice.recommended_rad_s < advice.most_rad_s


def test_a_slower_loop_needs_less_velocity_than_a_fast_one() -> None:
    slow, fast = (
        advise_amplitude(
            backlash_gap_rad=0.02, period_s=0.01, bandwidth_rad_s=wn, peak_travel_periods=1.0
        )
        for wn in (10.0, 60.0)
    )
    assert slow.least_rad_s < fast.least_rad_s


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"travel_limit_rad": 0.5}, "travel limit allows only"),
        ({"velocity_limit_rad_s": 0.4}, "velocity limit allows only"),
    ],
)
def test_limits_that_leave_no_room_are_said(limits: dict[str, float], says: str) -> None:
    advice = advise_amplitude(
        backlash_gap_rad=0.02,
        period_s=0.01,
        bandwidth_rad_s=50.0,
        peak_travel_periods=100.0,
        **limits,
    )
    assert not advice.possible
    assert advice.recommended_rad_s == advice.most_rad_s < advice.least_rad_s
    assert any(says in sentence for sentence in advice.sentences)


@pytest.mark.parametrize("gap", [0.0, -1.0, math.nan])
def test_a_gap_that_is_none_is_refused(gap: float) -> None:
    with pytest.raises(ConfigError, match=r"backlash_gap_rad is .*above zero"):
        advise_amplitude(
            backlash_gap_rad=gap, period_s=0.01, bandwidth_rad_s=50.0, peak_travel_periods=9.0
        )


def test_the_amplitude_that_is_recommended_can_be_played(tmp_path: Path) -> None:
    """With the lead-in that every experiment has, on a rig with little room."""
    table = load_rig("rigs/paper.toml").model_dump(mode="json", exclude_none=True)
    table["limits"]["travel_rad"] = float(np.radians(9.0))
    rig = RigConfig.model_validate(table)
    said_so = tmp_path / "rig.toml"
    said_so.write_text("\n".join(toml_lines("", table)) + "\n")
    out = tmp_path / "told.json"
    said("amplitude", "1021", "--rig", str(said_so), "--json", str(out))
    told_rad_s = json.loads(out.read_text())["recommended_rad_s"]
    plan = Experiment(
        name="told",
        rig=str(said_so),
        period_s=0.008,
        memory=8,
        identification=MSequence(polynomial="1021", amplitude_rad_s=told_rad_s),
        validation=RandomBinary(
            kind="random-binary", seed=1, amplitude_rad_s=told_rad_s, length=64
        ),
    )
    schedule = plan.schedule()
    assert schedule.peak_travel_rad <= rig.limits.travel_rad
    assert predict(schedule, rig).motor_travel_rad <= rig.limits.travel_rad
