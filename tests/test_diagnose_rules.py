"""Rules by which a contender becomes a cause, and a cause explains: each alone, on numbers."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from servo_bench.diagnosis.judging.causes import cause_of, leaves_no_doubt
from servo_bench.diagnosis.judging.judgement import _explained, _has_a_name
from servo_bench.diagnosis.judging.verdict import Cause, Quantity
from servo_bench.diagnosis.searching import joint, rounds
from servo_bench.diagnosis.searching.accepting import with_a_name
from servo_bench.diagnosis.searching.contenders import Round, _is_alike
from servo_bench.diagnosis.searching.gate import passes, passes_beside_coasting, passes_slowly
from servo_bench.diagnosis.searching.hypotheses import hypotheses
from servo_bench.diagnosis.searching.joint import Named, is_worth_it
from servo_bench.diagnosis.searching.late import held_back, no_plainer
from servo_bench.diagnosis.searching.reading_off import is_windup
from servo_bench.diagnosis.searching.scales import Scales, scales_of
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, commands

MODEL = Model(NOMINAL)
SCALES = Scales(0.05, 3.0, 0.7, (1.5, 1.2, 1.0), (1.0, 0.8, 0.5), 6.0, 5.0, 0.02, 2e-4)


def contender(
    seen: tuple[float, float],
    held: tuple[float, float],
    effect: str = "cogging",
    *,
    model: Model = MODEL,
) -> Any:
    """Gain and z of what was seen, and of what was held out."""
    return SimpleNamespace(
        effect=effect,
        seen_gain=seen[0],
        seen_z=seen[1],
        held_gain=held[0],
        held_z=held[1],
        found=SimpleNamespace(model=model),
    )


@pytest.mark.parametrize(("ratio", "able"), [(0.04, True), (0.3, True), (1.5, False)])
@pytest.mark.parametrize("share", [0.1, 0.9])
def test_a_coupling_that_does_not_ring_is_none(ratio: float, share: float, able: bool) -> None:
    """A spring k between the two parts of J is damped by d = 2 ratio sqrt(k J (1 - a) a)."""
    compliance, inertia = 2e-3, NOMINAL.inertia_kg_m2
    damping = 2.0 * ratio * np.sqrt(inertia * share * (1.0 - share) / compliance)
    model = MODEL.with_effect(
        "coupling_compliance",
        compliance_rad_per_nm=compliance,
        damping_s=float(damping * compliance),
        load_inertia_kg_m2=share * inertia,
    )
    assert passes(contender((0.3, 20.0), (0.3, 20.0), model=model)) is able


@pytest.mark.parametrize(
    ("seen", "held", "able"),
    [
        ((0.64, 7.2), (0.040, 14.7), True),  # most of it, and as sure as anybody must be
        ((0.05, 7.2), (0.040, 14.7), True),
        ((0.64, 7.2), (0.040, 2.0), False),
        ((0.64, 3.5), (0.200, 5.0), True),  # most of it, of both: need not be as sure on one
        ((0.05, 3.5), (0.200, 5.0), False),
    ],
)
def test_who_takes_more_is_not_asked_for_more(
    seen: tuple[float, float], held: tuple[float, float], able: bool
) -> None:
    assert passes(contender(seen, held)) is able


def spring_or_drag(spring_seen: float, leads: float = 10.0) -> tuple[Any, Any, Any]:
    """A round that a coupling won before a damping, both beyond chance."""
    costs = 10.0 + np.random.default_rng(1).normal(size=40)
    model = MODEL.with_effect("viscous", damping_nm_s_per_rad=1e-3)
    found: Any = SimpleNamespace(model=model, unknowns=())
    spring, drag = (
        SimpleNamespace(
            effect=effect,
            found=found,
            seen_gain=seen,
            seen_z=15.0,
            held_gain=held,
            held_z=14.0,
            costs=all_of,
        )
        for effect, seen, held, all_of in (
            ("coupling_compliance", spring_seen, 0.19, np.full(40, 10.0)),
            ("viscous", 0.05, 0.08, costs + leads),
        )
    )
    return spring, drag, SimpleNamespace(contenders=(spring, drag))


def test_a_coupling_that_takes_little_gives_way_to_what_has_a_name() -> None:
    """Three free numbers of a spring fit a part of whatever is wrong."""
    spring, drag, played = spring_or_drag(0.05)
    assert with_a_name(spring, played, SCALES, passes) is drag
    assert with_a_name(drag, played, SCALES, passes) is drag
    spring, drag, played = spring_or_drag(0.4)
    assert with_a_name(spring, played, SCALES, passes) is spring
    spring, drag, played = spring_or_drag(0.4, leads=0.0)
    assert with_a_name(spring, played, SCALES, passes) is drag, "no more than chance"
    alone: Any = SimpleNamespace(contenders=(spring_or_drag(0.05)[0],))
    assert with_a_name(alone.contenders[0], alone, SCALES, passes) is alone.contenders[0]
    assert with_a_name(None, played, SCALES, passes) is None


@pytest.mark.parametrize(
    ("effect", "seen_z", "held_z", "able"),
    [
        ("thermal_torque_constant", 2.3, 4.0, True),
        ("thermal_torque_constant", 1.0, 4.5, False),  # nothing of it before
        ("thermal_torque_constant", 4.5, 2.0, False),  # nothing of it last
        ("thermal_friction", 2.3, 4.0, False),  # another speed would do the same
        ("clock_skew", 2.3, 4.0, False),
    ],
)
def test_magnets_that_warm_show_on_what_came_last(
    effect: str, seen_z: float, held_z: float, able: bool
) -> None:
    gains = {"seen_gain": 0.007, "held_gain": 0.026}
    one: Any = SimpleNamespace(effect=effect, seen_z=seen_z, held_z=held_z, **gains)
    assert passes_slowly(one) is able


@pytest.mark.parametrize(
    ("effect", "seen_z", "held_z", "sure"),
    [
        ("cogging", 6.5, 6.5, True),
        ("cogging", 8.8, 3.5, True),
        ("cogging", 8.8, 2.5, False),
        ("coupling_compliance", 8.8, 3.5, False),  # it fits a part of anything
        ("cogging", 5.5, 5.5, False),
        ("thermal_friction", 2.6, 10.9, True),
        ("thermal_friction", 1.6, 7.0, True),
        ("cogging", 1.6, 7.0, False),
    ],
)
def test_a_size_of_few_deviations_is_a_cause_where_its_gain_is_far_beyond_chance(
    effect: str, seen_z: float, held_z: float, sure: bool
) -> None:
    gains: dict[str, float] = {"seen_gain": 0.1, "held_gain": 0.05}
    contender = SimpleNamespace(seen_z=seen_z, held_z=held_z, **gains)
    one: Any = SimpleNamespace(effect=effect, contender=contender, missed_z=None)
    assert leaves_no_doubt(one) is sure


@pytest.mark.parametrize(
    ("effect", "beside", "held_gain", "kept"),
    [
        ("thermal_friction", "coulomb", 0.03, True),
        ("thermal_friction", "coulomb", 0.004, False),
        ("thermal_friction", "coulomb", -0.03, False),
        ("thermal_friction", "cogging", 0.03, False),  # another speed would do the same
        ("thermal_torque_constant", "cogging", 0.03, True),
        ("viscous", "coulomb", 0.03, False),
    ],
)
def test_what_warms_is_kept_where_what_came_last_misses_it(
    monkeypatch: pytest.MonkeyPatch, effect: str, beside: str, held_gain: float, kept: bool
) -> None:
    """Of what was seen it takes a thousandth, far beyond chance: of nothing else would that do."""

    def fit(gain: float) -> Any:
        rough = np.random.default_rng(4).uniform(0.5, 1.5, 60)
        costs = 10.0 * (1.0 - gain * rough)
        return SimpleNamespace(costs=lambda _: costs, cost=lambda _: costs.sum())

    ends = [
        SimpleNamespace(errors=fit(g), model=None, sigma=None, unknowns=()) for g in (0.001, 0.0)
    ]
    with_it, less = ends
    held = [fit(held_gain), fit(0.0)]
    whole: Any = SimpleNamespace(held_out=lambda _: held)
    monkeypatch.setattr(joint, "seek", lambda *_, **__: with_it)
    monkeypatch.setattr(joint, "settle", lambda *_, **__: with_it)
    monkeypatch.setattr(joint, "without_effect", lambda *_: less)
    named: Any = [SimpleNamespace(effect=e) for e in (effect, beside)]
    now: Any = SimpleNamespace(model=None, unknowns=())
    _, left = joint.fit_jointly(whole, now, named, (), lambda _: None)
    assert (named[0] in left) is kept


@pytest.mark.parametrize(("z", "able"), [(5.2, False), (7.4, True)])
def test_a_spring_is_surer_than_others_where_all_is_right_already(z: float, able: bool) -> None:
    effects = ("coupling_compliance", "cogging")
    both = [contender((0.19, z), (0.15, z), effect) for effect in effects]
    assert [passes(one, right=True) for one in both] == [able, True]
    assert all(passes(one) for one in both)


@pytest.mark.parametrize(
    ("effect", "gain", "z", "able"),
    [
        ("inverter_dead_time", 0.01, 5.0, True),
        ("inverter_dead_time", 0.005, 5.0, False),
        ("inverter_dead_time", 0.01, 3.5, False),
        ("viscous", 0.01, 5.0, False),
        ("viscous", 0.04, 5.0, False),
        ("coupling_compliance", 0.04, 20.0, False),
        ("coupling_compliance", 0.06, 20.0, True),
    ],
)
def test_beside_a_load_that_coasts_a_little_of_the_cost_is_enough_where_it_is_beyond_chance(
    effect: str, gain: float, z: float, able: bool
) -> None:
    """Not for a spring, nor for what every rig has up to nearly a cause's size."""
    one = contender((gain, z), (gain, z), effect)
    assert passes_beside_coasting(one, right=True) is able


@pytest.mark.parametrize(
    ("seen_gain", "seen_z", "held_z", "able"),
    [
        (0.16, 24.0, 3.2, True),
        (0.09, 24.0, 3.2, False),
        (0.16, 12.0, 3.2, False),
        (0.16, 24.0, 2.5, False),
    ],
)
def test_a_spring_that_stands_far_out_need_not_take_much_of_what_was_held_out(
    seen_gain: float, seen_z: float, held_z: float, able: bool
) -> None:
    one = contender((seen_gain, seen_z), (0.017, held_z), "coupling_compliance")
    assert passes_beside_coasting(one, right=True) is able
    assert not passes(one, right=True)


def test_what_is_left_out_carries_nothing_else_either() -> None:
    """An anti-windup acts where a limit cuts the current: with that it would be told after all."""
    tried = {h.effect for h in hypotheses(SCALES)}
    assert tried - {h.effect for h in hypotheses(SCALES, without=("current_limit",))} == {
        "current_limit",
        "anti_windup",
    }


@pytest.mark.parametrize(
    ("torque_constant", "inertia", "strained"),
    [
        (-1.0, 1.0, True),
        (1.0, -1.0, True),
        (1.0, 1.0, False),
        (-1.0, 0.5, False),
        (0.0, 0.0, False),
    ],
)
def test_a_ratio_is_held_back_where_both_stand_at_opposite_ends(
    torque_constant: float, inertia: float, strained: bool
) -> None:
    shares = {"torque_constant_error": torque_constant, "inertia_error": inertia}
    unknowns = nuisances(0.036, NOMINAL.backlash_gap_rad)
    values = np.array([shares.get(u.effect, 0.0) * u.high for u in unknowns])
    final: Any = SimpleNamespace(unknowns=unknowns, values=values)
    assert held_back(final) == (frozenset(shares) if strained else frozenset())


@pytest.mark.parametrize(
    ("before", "after", "explained"),
    [
        ((18.0, 0.75), (0.9, 0.6), True),
        ((18.0, 0.75), (0.9, 1.04), False),  # right by all, and one signal worse than it was
        ((18.0, 0.30), (0.9, 0.60), True),  # worse, and no more than a right one may be
        ((18.0, 2.0, 2.0), (1.7, 0.5, 0.5), True),  # a bounce
        ((18.0, 16.0, 8.0), (0.5, 1.2, 0.5), False),  # what a motor does is known better
        ((18.0, 16.0, 8.0), (0.5, 0.9, 1.12), False),
        ((100.0, 90.0, 8.0), (0.5, 2.0, 1.0), True),  # no law is exact
    ],
)
def test_what_explains(
    before: tuple[float, ...], after: tuple[float, ...], explained: bool
) -> None:
    whole = SimpleNamespace(names=("twist", "motor velocity", "torque")[: len(before)])
    assert _explained(_finding(whole, before, after, "viscous")) is explained


@pytest.mark.parametrize(
    ("cause", "explained"), [("gravity_imbalance", True), ("load_torque", True), ("viscous", False)]
)
def test_what_a_torque_throws_about_reaches_the_motor(cause: str, explained: bool) -> None:
    whole = SimpleNamespace(names=("twist", "motor velocity", "torque"))
    thrown = _finding(whole, (21.0, 5.3, 5.1), (0.45, 1.25, 1.05), cause)
    assert _explained(thrown) is explained
    worse = _finding(whole, (21.0, 5.3, 5.1), (0.45, 1.6, 1.05), cause)
    assert not _explained(worse)


def _finding(whole: Any, before: Sequence[float], after: Sequence[float], cause: str) -> Any:
    return SimpleNamespace(
        misfit_before=np.array(before),
        misfit_after=np.array(after),
        whole=whole,
        named=(SimpleNamespace(effect=cause),),
    )


@pytest.mark.parametrize(
    ("confidence", "ambiguous_with", "named"),
    [
        (0.85, (), True),
        (0.70, (), False),
        (0.70, ("misalignment",), True),  # one of two, and both are told
        (0.70, ("load_torque",), False),
    ],
)
def test_a_doubt_is_told_with_who_makes_it(
    confidence: float, ambiguous_with: tuple[str, ...], named: bool
) -> None:
    cause = Cause(
        effect="encoder_eccentricity",
        parameters={},
        confidence=confidence,
        ambiguous_with=ambiguous_with,
        rival="misalignment",
    )
    assert _has_a_name(cause) is named


@pytest.mark.parametrize(
    ("others", "there", "rival"),
    [
        ({"cogging": 1.0, "viscous": 2.0}, frozenset[str](), "cogging"),
        ({"cogging": 1.0, "viscous": 2.0}, frozenset({"cogging"}), "viscous"),
        ({"coupling_compliance": -0.1, "viscous": 2.0}, frozenset[str](), "viscous"),
        ({"coupling_compliance": 0.1}, frozenset[str](), "coupling_compliance"),
        ({"coupling_compliance": -0.1}, frozenset[str](), None),
        ({"viscous": -0.1}, frozenset[str](), "viscous"),
        ({"misalignment": 0.1, "viscous": 2.0}, frozenset[str](), "viscous"),
    ],
)
def test_who_is_a_rival_of_a_cause(
    others: dict[str, float], there: frozenset[str], rival: str | None
) -> None:
    """Not what is there as well, nor who makes what was held out worse, nor a coupling that led by
    chance and was passed over."""
    costs = 10.0 + np.random.default_rng(2).normal(size=40)
    fitted: list[Any] = [
        SimpleNamespace(
            effect=effect,
            costs=costs + leads,
            total=(costs + leads).sum(),
            held_gain=-0.01 if effect == "misalignment" else 0.1,
        )
        for effect, leads in {"stribeck": 0.0, **others}.items()
    ]
    fitted[0].costs = np.full(40, 10.0)
    played = SimpleNamespace(
        contenders=fitted, near=lambda _: (), base_costs=costs + 90.0, screened=()
    )
    one: Any = SimpleNamespace(
        effect="stribeck",
        missed_z=None,
        round=played,
        contender=fitted[0],
        as_well=frozenset({"cogging"}),
    )
    told = cause_of(one, {}, there)
    assert told.rival == rival
    assert told.ambiguous_with == ("cogging",)


@pytest.mark.parametrize(
    ("bends_rad", "there", "as_well"),
    [
        (1.5e-5, frozenset(), ("coulomb",)),
        (1e-4, frozenset(), ()),
        (1.5e-5, frozenset({"coulomb"}), ()),
    ],
)
def test_bristles_of_any_bearing_are_plain_friction_as_well(
    bends_rad: float, there: frozenset[str], as_well: tuple[str, ...]
) -> None:
    fitted: Any = SimpleNamespace(effect="pre_sliding", costs=np.full(40, 10.0), total=400.0)
    played = SimpleNamespace(
        contenders=[fitted], near=lambda _: (), base_costs=fitted.costs + 90.0, screened=()
    )
    one: Any = SimpleNamespace(
        effect="pre_sliding", missed_z=None, round=played, contender=fitted, as_well=frozenset()
    )
    angle = Quantity(value=bends_rad, unit="rad", ci95=(0.0, 1.0), standard_error=1e-6)
    told = cause_of(one, {"pre_sliding.breakaway_angle_rad": angle}, there)
    assert told.ambiguous_with == as_well
    assert bool(told.splitting_experiment) is bool(as_well)


@pytest.mark.parametrize(("seen", "held", "worth"), [(0.02, 0.12, False), (0.06, 0.12, True)])
def test_a_coupling_takes_some_of_what_was_seen(seen: float, held: float, worth: bool) -> None:
    soft = MODEL.with_effect(
        "coupling_compliance", compliance_rad_per_nm=0.01, load_inertia_kg_m2=3e-5
    )
    one: Any = SimpleNamespace(
        effect="coupling_compliance", contender=contender((seen, 9.0), (held, 9.0))
    )
    found: Any = SimpleNamespace(model=soft)
    assert is_worth_it(one, found, scales_of(MODEL, commands(1, 400), 0.008)) is worth


@pytest.mark.parametrize(("times", "right", "worth"), [(0.8, False, True), (0.8, True, False)])
def test_where_all_is_right_nothing_smaller_than_its_size_is_a_cause(
    times: float, right: bool, worth: bool
) -> None:
    """A null's uneven bearing was a load's torque, because it took a fifth of hardly anything."""
    scales = scales_of(MODEL, commands(1, 400), 0.008)
    size = times * material_sizes(scales)["load_torque"]
    found: Any = SimpleNamespace(model=MODEL.with_effect("load_torque", torque_nm=size))
    one: Any = SimpleNamespace(effect="load_torque", contender=contender((0.05, 9.0), (0.21, 9.0)))
    assert is_worth_it(one, found, scales, right=right) is worth


@pytest.mark.parametrize(
    ("phase_rad", "amplitude_rad", "windup"),
    [
        (0.7 + np.pi, 3e-4, True),
        (0.9 - np.pi, 3e-4, True),
        (0.7, 3e-4, False),  # against the weight
        (0.7 + np.pi, 2e-3, False),  # no face gives so much
    ],
)
def test_what_a_face_gives_to_a_weight_is_not_the_encoders(
    phase_rad: float, amplitude_rad: float, windup: bool
) -> None:
    """-T sin(y + phi) presses the load on, so that it reads less than it would, in proportion."""
    heavy = MODEL.with_effect("gravity_imbalance", torque_nm=0.027, phase_rad=0.7)
    wave = {"amplitude_rad": amplitude_rad, "phase_rad": phase_rad}
    assert is_windup(heavy.with_effect("encoder_eccentricity", **wave)) is windup
    assert not is_windup(MODEL.with_effect("encoder_eccentricity", **wave))


@pytest.mark.parametrize(("amplitude_rad", "windup"), [(3e-4, True), (8e-4, False)])
def test_a_face_that_was_fitted_too_soft_is_taken_back_by_a_wave(
    amplitude_rad: float, windup: bool
) -> None:
    """Under 27 mN m one of 0.02 rad/N m gives 0.54 mrad: a wave against that takes off no more."""
    heavy = MODEL.with_effect("gravity_imbalance", torque_nm=0.027, phase_rad=0.7)
    heavy = heavy.with_effect("contact", compliance_rad_per_nm=0.02, load_inertia_kg_m2=1e-6)
    wave = {"amplitude_rad": amplitude_rad, "phase_rad": 0.8}
    assert is_windup(heavy.with_effect("encoder_eccentricity", **wave)) is windup


@pytest.mark.parametrize(
    ("best", "leads", "gives_way"),
    [("stribeck", 0.01, True), ("stribeck", 0.5, False), ("viscous", 0.01, False)],
)
def test_a_refinement_that_leads_by_chance_gives_way_to_what_it_refines(
    best: str, leads: float, gives_way: bool
) -> None:
    """Blocks scatter by a fifth; what leads in all of them by half is beyond chance."""
    costs = 10.0 + 0.2 * np.random.default_rng(5).standard_normal((2, 40))
    one: Any = SimpleNamespace(effect=best, costs=costs[0] - leads)
    plain: Any = SimpleNamespace(effect="coulomb", costs=costs[1])
    unlike: Any = SimpleNamespace(likeness=lambda *_: 0.5)
    assert _is_alike(unlike, one, plain) is gives_way


@pytest.mark.parametrize(("bristle_rad", "gives_way"), [(1.2e-5, True), (3e-5, False)])
def test_bristles_that_only_slide_are_coulomb_friction(bristle_rad: float, gives_way: bool) -> None:
    """However far they lead: here in every block alike."""
    costs = 10.0 + 0.2 * np.random.default_rng(5).standard_normal((2, 40))
    sticks = MODEL.with_effect("pre_sliding", torque_nm=0.01, breakaway_angle_rad=bristle_rad)
    found: Any = SimpleNamespace(model=sticks)
    one: Any = SimpleNamespace(effect="pre_sliding", costs=costs[0] - 2.0, found=found)
    plain: Any = SimpleNamespace(effect="coulomb", costs=costs[1])
    alike: Any = SimpleNamespace(likeness=lambda *_: 0.97)
    assert _is_alike(alike, one, plain) is gives_way


@pytest.mark.parametrize(
    ("leads", "likeness", "near"),
    [(0.5, 0.97, True), (0.5, 0.9, False), (2.0, 0.97, False)],
)
def test_who_is_hardly_behind_is_a_rival_however_sure_that_is(
    leads: float, likeness: float, near: bool
) -> None:
    """Of 90 that a block of 100 loses half, or two, in every one alike."""
    costs = np.full(40, 10.0)
    one: Any = SimpleNamespace(effect="transport_delay", costs=costs, total=costs.sum())
    behind: Any = SimpleNamespace(
        effect="current_loop_lag", costs=costs + leads, total=(costs + leads).sum()
    )
    played: Any = SimpleNamespace(
        likeness=lambda *_: likeness, contenders=(one, behind), base_costs=np.full(40, 100.0)
    )
    assert (behind in Round.near(played, one)) is near
    assert one in Round.near(played, behind)


@pytest.mark.parametrize(
    ("effect", "missed", "first"),
    [
        ("coupling_compliance", 1.6, "right"),
        ("coupling_compliance", 0.9, "lowest"),  # all is right: nothing hides which it is
        ("clock_skew", 1.6, "lowest"),
    ],
)
def test_the_right_resonance_is_the_lowest_beside_a_load_that_coasts(
    monkeypatch: pytest.MonkeyPatch, effect: str, missed: float, first: str
) -> None:
    ends = {
        name: SimpleNamespace(name=name, cost=cost, errors=None)
        for name, cost in (("lowest", 1.0), ("right", 1.1), ("far", 1.5))
    }
    beside = {"lowest": 0.9, "right": 0.4, "far": 0.1}
    monkeypatch.setattr(rounds, "misfit", lambda *_: np.array([missed]))
    monkeypatch.setattr(
        rounds, "with_coasting", lambda _, end: SimpleNamespace(cost=beside[end.name])
    )
    quick: Any = None
    several: Any = list(ends.values())
    chosen: Any = rounds._deepest(quick, several, effect)
    assert chosen.name == first


@pytest.mark.parametrize(
    ("small", "needed", "kept"), [(0, False, True), (1, False, False), (1, True, True)]
)
def test_a_cause_alone_is_needed_beside_what_is_too_small_for_a_name(
    monkeypatch: pytest.MonkeyPatch, small: int, needed: bool, kept: bool
) -> None:
    """A clamp was accepted first, and friction too small for a name then took its place."""
    fit = SimpleNamespace(model=MODEL, unknowns=(), errors=None)
    for name in ("seek", "settle", "without_effect"):
        monkeypatch.setattr(joint, name, lambda *_, **__: fit)
    monkeypatch.setattr(joint, "is_needed", lambda *_: needed)
    evidence: Any = None
    now: Any = fit
    one: Any = SimpleNamespace(effect="anti_windup")
    _, named = joint.fit_jointly(evidence, now, [one], (), lambda _: None, small=small)
    assert (named == [one]) is kept


@pytest.mark.parametrize(
    ("effect", "open_", "kept"),
    [
        ("load_torque", ("load_torque", "contact"), False),
        ("load_torque", ("load_torque",), True),
        ("coulomb", ("coulomb", "contact"), True),
    ],
)
def test_what_turns_a_load_is_needed_beside_a_mass_that_the_load_has(
    monkeypatch: pytest.MonkeyPatch, effect: str, open_: tuple[str, ...], kept: bool
) -> None:
    """Beside a light load a small torque stood in for its friction, and later for nothing."""
    unknowns = tuple(SimpleNamespace(effect=name) for name in open_)
    fit = SimpleNamespace(model=MODEL, unknowns=unknowns, errors=None)
    for name in ("seek", "settle", "without_effect"):
        monkeypatch.setattr(joint, name, lambda *_, **__: fit)
    monkeypatch.setattr(joint, "is_needed", lambda *_: False)
    monkeypatch.setattr(joint, "misfit", lambda *_: np.zeros(1))
    evidence: Any = None
    now: Any = fit
    one: Any = SimpleNamespace(effect=effect)
    _, named = joint.fit_jointly(evidence, now, [one], (), lambda _: None)
    assert (named == [one]) is kept


@pytest.mark.parametrize(
    ("open_", "needed", "left"),
    [
        (("current_limit",), ("coulomb", "current_limit"), ["coulomb", "current_limit"]),
        (("current_limit",), ("coulomb",), ["coulomb"]),
        ((), ("coulomb", "current_limit"), ["coulomb"]),
    ],
)
def test_what_an_anti_windup_acted_beside_keeps_a_name_where_it_is_needed(
    monkeypatch: pytest.MonkeyPatch,
    open_: tuple[str, ...],
    needed: tuple[str, ...],
    left: list[str],
) -> None:
    """On all that was recorded it had taken its limit's place, and was not missed beside it."""
    unknowns = tuple(SimpleNamespace(effect=name) for name in open_)
    fit = SimpleNamespace(model=MODEL, unknowns=unknowns, errors=None)
    for name in ("seek", "settle", "without_effect"):
        monkeypatch.setattr(joint, name, lambda *_, **__: fit)
    monkeypatch.setattr(joint, "is_missed", lambda *a: a[3] in needed)
    evidence: Any = None
    now: Any = fit
    names = ("coulomb", "anti_windup")
    round_: Any = None
    contender: Any = SimpleNamespace(found=fit)
    both = [Named(name, round_, contender, ()) for name in names]
    _, named = joint.fit_jointly(evidence, now, both, (), lambda _: None)
    assert [n.effect for n in named] == left


@pytest.mark.parametrize(
    ("there", "also"),
    [
        (("coulomb", "current_limit"), {"pre_sliding"}),
        (("coulomb", "pre_sliding"), set()),
        (("current_limit",), set()),
    ],
)
def test_bristles_are_fitted_wherever_plain_friction_is(
    there: tuple[str, ...], also: set[str]
) -> None:
    found: Any = [SimpleNamespace(hypothesis=SimpleNamespace(effect=e)) for e in there]
    assert rounds._bristles(found) == also


def test_what_every_rig_may_have_is_not_asked_whether_it_is_needed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit without it has it all the same, in its band."""
    wider = MODEL.with_effect("backlash_width", change_rad=3e-4)
    fit = SimpleNamespace(model=wider, unknowns=(), errors=None)
    for name in ("seek", "settle"):
        monkeypatch.setattr(joint, name, lambda *_, **__: fit)
    evidence: Any = None
    now: Any = fit
    one: Any = SimpleNamespace(effect="backlash_width")
    band = nuisances(0.1, 0.02)
    _, named = joint.fit_jointly(evidence, now, [one], band, lambda _: None, small=1)
    assert named == [one]


@pytest.mark.parametrize(
    ("plain", "warming", "kept"),
    [(60.0, 45.0, ["thermal_friction", "coulomb"]), (50.0, 45.0, ["coulomb"])],
)
def test_friction_that_warms_is_plain_friction_that_takes_nearly_as_much(
    plain: float, warming: float, kept: list[str]
) -> None:
    contenders = tuple(
        SimpleNamespace(effect=effect, total=total)
        for effect, total in (("thermal_friction", warming), ("coulomb", plain))
    )
    played: Any = SimpleNamespace(contenders=contenders, base_costs=np.array([40.0, 60.0]))
    assert [c.effect for c in no_plainer(played)] == kept


@pytest.mark.parametrize(
    ("ranked", "foremost"),
    [
        (("coulomb", "cogging", "stribeck", "viscous"), ("coulomb", "cogging", "stribeck")),
        (
            ("coulomb", "pre_sliding", "thermal_friction", "stribeck", "load_friction", "viscous"),
            ("coulomb", "pre_sliding", "thermal_friction", "load_friction"),
        ),
        (("pre_sliding", "coulomb"), ("pre_sliding", "coulomb")),
    ],
)
def test_one_law_and_its_refinements_do_not_take_every_place(
    ranked: Sequence[str], foremost: Sequence[str]
) -> None:
    pairs: Any = [(SimpleNamespace(hypothesis=SimpleNamespace(effect=e)), None) for e in ranked]
    assert [one.hypothesis.effect for one, _ in rounds._foremost(pairs)] == list(foremost)
