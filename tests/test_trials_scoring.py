"""What is right, on verdicts made up: every kind of trial, every worth of a name, every figure."""

import math
from collections.abc import Mapping
from typing import Any, get_args

import pytest

from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Quantity, Verdict
from sim_rig.effects import catalogue
from tests.trials.drawing import Kind, Question
from tests.trials.figures import calibration, figures, share
from tests.trials.limits import limits
from tests.trials.names import DECLARED, RIGHT, Channels, class_of, right_names
from tests.trials.nuisances import LARGEST
from tests.trials.parameters import COUNTERPARTS, LAX, WITHOUT, Known, true_value
from tests.trials.scoring import Score, hidden_numbers, score
from tests.truth.catalogue import BY_NAME, IN_THE_CATALOGUE
from tests.truth.hidden import HiddenTruth, hide
from tests.truth.nuisances import Nuisances

INSIDE = tuple(hiding.name for hiding in IN_THE_CATALOGUE)
PARAMETERS = {effect.name: effect.params._fields for effect in catalogue().values()}


def question(kind: Kind = "one") -> Question:
    return Question(seed=1101, kind=kind)


def truth(**sizes: float) -> HiddenTruth:
    return hide(1101, sizes).open()


def cause(
    effect: str, confidence: float = 0.9, ambiguous: tuple[str, ...] = (), **values: float
) -> Cause:
    return Cause(
        effect=effect,
        confidence=confidence,
        ambiguous_with=ambiguous,
        parameters={
            name: Quantity(
                value=value,
                unit="",
                ci95=(value - 0.1 * abs(value), value + 0.1 * abs(value)),
                standard_error=0.05 * abs(value),
            )
            for name, value in values.items()
        },
    )


def named(*causes: Cause) -> Verdict:
    error = ErrorFigures(
        before=4.0, after=1.0, noise_floor=0.5, share_explained=0.9, signal="load", unit="rad"
    )
    return Verdict(verdict="named", sentence="", causes=causes, error=error)


NONE = Verdict(verdict="none", sentence="")
UNKNOWN = Verdict(verdict="unknown", sentence="")


def test_every_cause_of_the_truth_has_its_name_in_the_catalogue() -> None:
    assert set(RIGHT) == set(INSIDE)
    for right in RIGHT.values():
        assert right.names
        assert set(right.names) <= set(PARAMETERS)
        assert right.reason
    for effect, field in LARGEST:
        assert field in PARAMETERS[effect]


def test_every_cause_has_a_parameter_to_compare_or_a_reason_why_not() -> None:
    assert set(COUNTERPARTS) | set(WITHOUT) == set(INSIDE)
    assert set(COUNTERPARTS).isdisjoint(WITHOUT)
    assert set(INSIDE) > LAX
    for one in COUNTERPARTS.values():
        for counterpart in one:
            assert counterpart.parameter in PARAMETERS[counterpart.effect]


@pytest.mark.parametrize("channels", ["all", "load"])
def test_classes_are_mutual_and_hold_what_was_declared(channels: Channels) -> None:
    for name in INSIDE:
        for other in class_of(name, channels):
            assert name in class_of(other, channels)
    for names, _ in DECLARED:
        for name in names:
            assert names <= class_of(name, channels)
    assert right_names("air_drag", channels) == frozenset()


def test_without_the_motor_no_more_can_be_told_apart() -> None:
    every, alone = (sum(len(class_of(n, c)) for n in INSIDE) for c in get_args(Channels))
    assert every <= alone


def test_a_right_name_is_right_and_another_is_wrong() -> None:
    hidden = truth(cogging=8e-3)
    right = score(question(), hidden, named(cause("cogging", torque_nm=8e-3)))
    assert (right.right, right.in_set, right.top, right.spurious) == (True, True, "cogging", 0)
    wrong = score(question(), hidden, named(cause("viscous", damping_nm_s_per_rad=1e-3)))
    assert (wrong.right, wrong.in_set, wrong.top, wrong.spurious) == (False, False, "viscous", 1)


def test_a_member_of_the_class_is_as_right_as_the_cause() -> None:
    verdict = named(cause("torque_constant_error", error_fraction=-0.1))
    assert score(question(), truth(inertia_error=0.12), verdict).right


def test_the_set_may_hold_what_the_first_name_missed() -> None:
    verdict = named(cause("viscous", ambiguous=("cogging",), damping_nm_s_per_rad=1e-3))
    found = score(question(), truth(cogging=8e-3), verdict)
    assert (found.right, found.in_set) == (False, True)


def test_a_companion_is_neither_spurious_nor_enough() -> None:
    hidden = truth(position_dependent_friction=5e-3)
    friction = cause("coulomb", torque_nm=12e-3)
    alone = score(question(), hidden, named(friction))
    assert (alone.right, alone.spurious, alone.named[0].worth) == (False, 0, "companion")
    first = score(
        question(), hidden, named(friction, cause("position_friction", swing_torque_nm=5e-3))
    )
    assert (first.right, first.top) == (True, "position_friction")


def test_a_nuisance_may_be_named_as_large_as_it_is() -> None:
    hidden = truth(cogging=8e-3)
    cogging = cause("cogging", torque_nm=8e-3)
    for lag_s, worth, spurious in ((80e-6, "nuisance", 0), (500e-6, "wrong", 1)):
        verdict = named(cogging, cause("current_loop_lag", lag_s=lag_s))
        found = score(question(), hidden, verdict)
        assert found.right
        assert (found.named[1].worth, found.spurious) == (worth, spurious)


@pytest.mark.parametrize(
    ("kind", "sizes", "verdict", "right"),
    [
        ("none", {}, NONE, True),
        ("none", {}, UNKNOWN, False),
        ("none", {}, named(cause("current_loop_lag", lag_s=50e-6)), False),
        ("outside", {"air_drag": 1e-3}, UNKNOWN, True),
        ("outside", {"air_drag": 1e-3}, NONE, False),
        ("outside", {"air_drag": 1e-3}, named(cause("viscous")), False),
        ("removed", {"cogging": 8e-3}, UNKNOWN, True),
        ("removed", {"cogging": 8e-3}, named(cause("torque_ripple")), False),
        ("one", {"cogging": 8e-3}, UNKNOWN, False),
        ("one", {"cogging": 8e-3}, NONE, False),
        ("one", {"cogging": 8e-3}, None, False),
        ("none", {}, None, False),
    ],
)
def test_each_kind_has_its_right_verdict(
    kind: Kind, sizes: Mapping[str, float], verdict: Verdict | None, right: bool
) -> None:
    assert score(question(kind), truth(**sizes), verdict).right is right


def test_of_a_pair_both_must_be_named() -> None:
    hidden = truth(cogging=8e-3, transport_delay=2e-3)
    cogging, delay = cause("cogging", torque_nm=8e-3), cause("transport_delay", delay_s=2e-3)
    both = score(question("pair"), hidden, named(delay, cogging))
    assert (both.right, both.found, both.in_set) == (True, 2, True)
    one = score(question("pair"), hidden, named(cogging))
    assert (one.right, one.found, one.in_set) == (False, 1, False)
    wider = score(question("pair"), hidden, named(delay, cogging, cause("stribeck")))
    assert (wider.right, wider.spurious) == (True, 1)


def test_parameters_are_compared_in_the_catalogue_s_own_numbers() -> None:
    asked, hidden = question(), truth(load_torque=0.05)
    found = score(asked, hidden, named(cause("load_torque", torque_nm=-0.052))).measured[0]
    assert (found.true, found.covered) == (-0.05, True)
    assert found.relative_error == pytest.approx(0.04)
    off = score(asked, hidden, named(cause("load_torque", torque_nm=0.05))).measured[0]
    assert (off.covered, off.relative_error) == (False, 2.0)


def test_a_ratio_is_the_same_whichever_of_both_is_named() -> None:
    known = Known(Nuisances(), 2.5e-4, 44.0, {}, {})
    for effect, expected in (("inertia_error", 0.25), ("torque_constant_error", -0.2)):
        parameter, value = true_value("inertia_error", 0.25, effect, known) or ("", math.nan)
        assert parameter == "error_fraction"
        assert value == pytest.approx(expected)
    assert true_value("inertia_error", 0.25, "cogging", known) is None
    assert true_value("command_deadband", 0.1, "command_deadband", known) is None


def line(kind: Kind, verdict: Verdict | None, sizes: Mapping[str, float]) -> dict[str, Any]:
    asked, hidden = question(kind), truth(**sizes)
    judged: Score = score(asked, hidden, verdict)
    return {
        "question": asked.numbers(),
        "hidden": hidden_numbers(asked, hidden),
        "score": judged.numbers(),
        "failure": "" if verdict else "exit code 1",
        "wall_s": 2.0,
        "cpu_s": 1.0,
        "peak_bytes": 1 << 20,
    }


def test_figures_count_what_was_scored() -> None:
    cogging = {"cogging": 8e-3}
    right = named(cause("cogging", torque_nm=8e-3))
    lines = [
        *[line("one", right, cogging)] * 3,
        line("one", named(cause("torque_ripple", ripple_fraction=0.03)), cogging),
        line("one", None, cogging),
        *[line("none", NONE, {})] * 9,
        line("none", right, {}),
        line("outside", UNKNOWN, {"air_drag": 1e-3}),
        line("pair", right, {**cogging, "transport_delay": 2e-3}),
    ]
    found = figures(lines)
    assert found["failed"]["of"] == 1
    every = found["all"]
    assert every["confusion"]["cogging"] == {"cogging": 3, "torque_ripple": 1, "failed": 1}
    assert every["one"]["top_1"]["share"] == 0.6
    assert every["none"]["false_alarms"] == share([True, *[False] * 9])
    assert every["outside"]["unknown"]["share"] == 1.0
    assert every["pair"]["both_named"]["share"] == 0.0
    assert every["parameters"]["causes"]["cogging: cogging.torque_nm"]["median_error"] == 0.0
    assert every["gain"]["median_factor"] == 4.0
    assert every["confidence"]["of"] == 6
    assert sum(sum(row.values()) for row in every["confusion"].values()) == len(lines) - 1


def test_no_alarm_in_sixty_still_allows_five_percent() -> None:
    interval = share([False] * 60)["interval"]
    assert interval[0] == 0.0
    assert interval[1] == pytest.approx(
        1.0 - 0.025 ** (1.0 / 60.0)
    )  # the exact bound, in closed form
    assert share([])["share"] is None


def test_a_confidence_that_is_kept_is_calibrated_and_one_that_is_not_is_off() -> None:
    kept = [(0.75, k % 4 != 0) for k in range(400)] + [(0.25, k % 4 == 0) for k in range(400)]
    honest = calibration(kept)
    assert honest["ece"] == pytest.approx(0.0)
    assert honest["brier"] == pytest.approx(0.75 * 0.25)
    assert honest["brier"] < honest["brier_of_the_best_constant"] == pytest.approx(0.25)
    boasting = calibration([(1.0, right) for _, right in kept])
    assert boasting["ece"] == pytest.approx(0.5)
    assert boasting["brier"] == pytest.approx(0.5)
    assert boasting["brier_of_the_best_constant"] == pytest.approx(0.25)
    assert calibration([])["of"] == 0


@pytest.mark.parametrize("channels", ["all", "load"])
def test_sizes_of_limits_are_positive_and_within_reach(channels: Channels) -> None:
    found = limits(channels)
    assert set(found) == set(INSIDE)
    sizes = {name: size for name, size in found.items() if size is not None}
    assert len(sizes) >= 24
    for name, size in sizes.items():
        assert 0.0 < size <= 4.0 * BY_NAME[name].high
