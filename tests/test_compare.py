"""Two runs of one rig are alike whatever the noise; what was changed is found, and only that."""

import json
import math
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.diagnosis.fitting.fit import Fit, fit
from servo_bench.errors import FitError
from servo_bench.excitation.experiment import MSequence
from servo_bench.recording.recording import Recording
from servo_bench.replay import parameter_change
from servo_bench.replay.change import ALPHA, Change, two_sided
from servo_bench.replay.compare import compare
from servo_bench.replay.kernel_change import kernel_change
from servo_bench.replay.noise_change import noise_changes
from servo_bench.replay.parameter_change import FREE, changes_between
from servo_bench.run.virtual import run_virtually, save
from tests.small_runs import NOISE_RAD, experiment, noisy_rig, paper_rig, small_run

SEEDS = (1, 2, 3, 4)
NUMBERS = FREE[1]
"""Without friction: a fit takes a third of the time."""
PER_TEST = ALPHA / 12


@cache
def _fitted(seed: int) -> Fit:
    return fit(small_run(seed), paper_rig().model(), NUMBERS)


def _run(seed: int, **simulated: object) -> Recording:
    return run_virtually(experiment(), noisy_rig(seed, **simulated))


@pytest.mark.long
def test_two_runs_of_one_rig_are_alike() -> None:
    for one, other in combinations(SEEDS, 2):
        a, b = small_run(one), small_run(other)
        orders = kernel_change(a, b).orders
        changes = (*changes_between(_fitted(one), _fitted(other)), *noise_changes(a, b))
        assert len(orders) == 3
        assert len(changes) >= 6
        assert min(change.p_value for change in (*orders, *changes)) > PER_TEST


def test_a_gap_three_percent_wider_is_found_and_nothing_else() -> None:
    gap = paper_rig().nominal.backlash_gap_rad
    found = compare(small_run(1), _run(5, backlash_gap_rad=1.03 * gap))
    assert found.changed
    changed = [change for change in (*found.parameters, *found.noise) if found.is_change(change)]
    assert [change.symbol for change in changed] == ["gap"]
    low, high = changed[0].interval()
    assert low - (high - low) < 0.03 * gap < high + (high - low)
    assert changed[0].where == "transmission"
    assert any("gap (transmission) has changed" in sentence for sentence in found.sentences())
    assert json.loads(json.dumps(found.numbers(), allow_nan=False))["changed"] is True


def test_an_inertia_three_percent_larger_is_found_where_it_is() -> None:
    heavier = _run(6, effects={"inertia_error": {"error_fraction": 0.03}})
    changes = changes_between(_fitted(1), fit(heavier, paper_rig().model(), NUMBERS))
    assert [change.symbol for change in changes if change.p_value < PER_TEST] == ["J"]
    inertia = next(change for change in changes if change.symbol == "J")
    assert inertia.share == pytest.approx(0.03, abs=0.002)
    orders = kernel_change(small_run(1), heavier).orders
    assert orders[0].p_value < PER_TEST


def test_the_difference_of_kernels_is_antisymmetric_and_zero_for_one_run() -> None:
    a, b = small_run(1), small_run(2)
    there, back = kernel_change(a, b), kernel_change(b, a)
    assert there.c1_difference == pytest.approx(-back.c1_difference, abs=1e-12)
    same = kernel_change(a, a)
    assert not same.c1_difference.any()
    assert {order.p_value for order in same.orders} == {1.0}


def test_noise_four_times_as_large_is_found() -> None:
    loud = _run(7, load_encoder_noise_rad=4.0 * NOISE_RAD)
    changes = {change.symbol: change for change in noise_changes(small_run(1), loud)}
    found = changes["load encoder noise"]
    assert found.p_value < PER_TEST
    assert found.b / found.a == pytest.approx(4.0, rel=0.3)
    assert found.a == pytest.approx(NOISE_RAD, rel=0.3)
    assert changes["motor encoder noise"].p_value > PER_TEST


def test_another_sequence_leaves_kernels_out_and_says_so() -> None:
    other = experiment().model_copy(
        update={"identification": MSequence(polynomial="1055", amplitude_rad_s=2.0)}
    )
    with pytest.raises(FitError, match="1021 and 1055"):
        kernel_change(small_run(1), run_virtually(other, noisy_rig(2)))


def test_recordings_with_nothing_in_common_are_refused() -> None:
    run = small_run(1)
    bare = replace(
        run,
        channels={name: run[name] for name in ("slot", "velocity_command_rad_s")},
        rig=None,
        experiment=None,
    )
    with pytest.raises(FitError, match="nothing to compare"):
        compare(bare, bare)


@pytest.mark.parametrize(
    ("difference", "error", "p_value"),
    [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (1.0, math.inf, 1.0), (1.959964, 1.0, 0.05)],
)
def test_p_values_of_differences(difference: float, error: float, p_value: float) -> None:
    assert two_sided(difference, error) == pytest.approx(p_value, abs=1e-6)


def test_a_share_of_nothing_is_no_share() -> None:
    none = Change("coulomb.torque_nm", "coulomb", "N m", "mechanics", 0.0, 1e-3, 1e-5, 0.0)
    assert math.isnan(none.share)
    assert none.numbers(changed=True)["share"] is None
    assert not none.is_known


def test_the_command_line_says_that_nothing_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parameter_change, "FREE", (("gap",),))
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path, seed in zip(paths, (1, 2), strict=True):
        save(small_run(seed), path)
    out = tmp_path / "out.json"
    words = ["compare", *map(str, paths), "--json", str(out)]
    done = CliRunner().invoke(cli.app, words)
    assert done.exit_code == 0, done.output
    assert "Nothing has changed" in done.output
    assert json.loads(out.read_text())["changed"] is False


@pytest.mark.parametrize(
    ("symbol", "label"),
    [
        ("J", "J"),
        ("K_P", "K_P"),
        ("coulomb.torque_nm", "coulomb torque"),
        ("viscous.damping_nm_s_per_rad", "viscous damping"),
        ("stribeck.order", "stribeck order"),
    ],
)
def test_a_change_is_named_in_words_and_angles_are_told_in_degrees(symbol: str, label: str) -> None:
    change = Change("n", symbol, "rad", "mechanics", 0.1, 0.2, 0.01, 0.0)
    assert change.numbers(changed=True)["label"] == label
    factor, unit = change.shown
    assert (factor * math.pi, unit) == (pytest.approx(180.0), "deg")
