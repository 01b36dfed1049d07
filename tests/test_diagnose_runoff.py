"""What a recording's beginning leaves open is asked again of all of it, and what a load hides."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.searching import rounds, runoff
from servo_bench.diagnosis.searching.accepting import accepted_of
from servo_bench.diagnosis.searching.bounces import on_other_faces
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.diagnosis.searching.contenders import Contender, Round, faced
from servo_bench.diagnosis.searching.finding import find_causes, nothing_told
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial, hypotheses
from servo_bench.diagnosis.searching.joint import Named, fit_jointly, is_worth_it, own_unknowns
from servo_bench.diagnosis.searching.late import Late, unsure
from servo_bench.diagnosis.searching.rounds import merged
from servo_bench.diagnosis.searching.runoff import couplings_again, run_off
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.screening import Screened
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import Unknown, nuisances, widened
from servo_bench.report.diagnosis_figures import draw_evidence
from sim_rig.errors import EffectError
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
LAG_S = 4e-4
BAND = nuisances(0.05, NOMINAL.backlash_gap_rad)
LAGS = ("current_loop_lag", "lag_s"), ("transport_delay", "delay_s")
FRICTION_NM, FACE_RAD_PER_NM = 4e-3, 2e-3


def fitted(
    seen: Evidence, effect: str, field: str, size: float = LAG_S
) -> tuple[Found, Hypothesis]:
    start = MODEL.with_effect(effect, **{field: 0.5 * size})
    own = widened(effect, (field,), start, size)
    hypothesis = Hypothesis(effect, (Trial(effect, {field: size}, size),), (field,))
    return seek(seen, start, merged(BAND, own), iterations=4), hypothesis


@pytest.mark.parametrize(
    "named", [pytest.param("current_loop_lag", marks=pytest.mark.long), "transport_delay"]
)
def test_of_two_that_change_nearly_the_same_everything_tells_which(named: str) -> None:
    hidden = MODEL.with_effect("current_loop_lag", lag_s=LAG_S)
    whole = evidence_of([recorded(hidden, 61, slots=1200)], MODEL, block="loop")
    base = seek(whole, MODEL, BAND, iterations=3)
    played = faced(whole, base, [fitted(whole, *lag) for lag in LAGS])
    (one,) = (c for c in played.contenders if c.effect == named)
    begun = replace(played, contenders=tuple(_as_good(c, one) for c in played.contenders))
    first = Named(one.effect, begun, one, own_unknowns(one, one.effect))
    joint, _ = fit_jointly(whole, one.found, [first], BAND, nothing_told)
    final, (kept,) = run_off(whole, joint, [first], BAND, nothing_told)
    assert kept.effect == "current_loop_lag"
    assert kept.round is not begun
    fine = whole.seen([final.model], coarse=False)[0].cost(final.sigma) + final.belief
    assert final.cost == pytest.approx(fine)
    # a filter of the velocity, in its band, takes a part of it
    lags_s = final.value("current_loop_lag.lag_s") + final.value("velocity_filter_lag.lag_s")
    assert lags_s == pytest.approx(LAG_S, rel=0.1)


COUPLING = {"compliance_rad_per_nm": 0.02, "damping_s": 1.5e-4, "load_inertia_kg_m2": 4e-5}
SPRING = "coupling_compliance"
LIGHT = coasting(MODEL, 800.0)


@pytest.fixture(scope="module")
def sprung() -> tuple[Evidence, Named, Found]:
    """A lag beside a load that coasts, and a coupling that was ahead of it while the load stood:
    its three numbers fitted a part of what the load did in its gap. Both are in the joint fit."""
    hidden = LIGHT.with_effect("current_loop_lag", lag_s=LAG_S)
    whole = evidence_of([recorded(hidden, 67, slots=900)], MODEL, block="loop")
    base = seek(whole, MODEL, BAND, iterations=3)
    start = MODEL.with_effect(SPRING, **COUPLING)
    own = widened(SPRING, tuple(COUPLING), start, 0.02)
    coupling = Hypothesis(SPRING, (Trial(SPRING, COUPLING, 0.02),), tuple(COUPLING))
    found = seek(whole, start, merged(BAND, own), iterations=3)
    played = faced(whole, base, [(found, coupling), fitted(whole, *LAGS[0])])
    contenders = {c.effect: c for c in played.contenders}
    one = contenders[SPRING]
    lag = replace(contenders["current_loop_lag"], costs=1.2 * one.costs)
    begun = replace(played, contenders=(one, lag))
    beside = replace(LIGHT, effects={**LIGHT.effects, **start.effects})
    now = seek(whole, beside, found.unknowns, iterations=3)
    return whole, Named(SPRING, begun, one, own_unknowns(one, SPRING)), now


def late_of(whole: Evidence, *believed: str) -> Late:
    commands = np.asarray(whole.fitted[0].source.rows.channel("velocity_command_rad_s"))
    had = tuple(
        (effect, MODEL.with_effect(effect, **COUPLING).effects[effect]) for effect in believed
    )
    scales = scales_of(MODEL, commands, 0.008)._replace(believed=had)
    return Late(whole, whole, (), scales, BAND, nothing_told)


@pytest.mark.long
def test_a_coupling_faces_who_was_sure_once_the_load_coasts(
    sprung: tuple[Evidence, Named, Found],
) -> None:
    whole, first, now = sprung
    final, (kept,), small = couplings_again(late_of(whole), now, [first])
    assert kept.effect == "current_loop_lag"
    assert SPRING not in final.model.effects
    # a filter of the velocity, in its band, takes a part of it
    lags_s = final.value("current_loop_lag.lag_s") + final.value("velocity_filter_lag.lag_s")
    assert lags_s == pytest.approx(LAG_S, rel=0.15)
    assert small == []


@pytest.mark.long
def test_who_takes_a_couplings_place_has_to_be_worth_its_name(
    sprung: tuple[Evidence, Named, Found], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runoff, "worth_a_name", lambda *_: ())
    whole, first, now = sprung
    _, named, small = couplings_again(late_of(whole), now, [first])
    assert (named, small) == ([], ["current_loop_lag"])


def test_a_coupling_that_faced_them_beside_such_a_load_or_is_believed_does_not(
    sprung: tuple[Evidence, Named, Found],
) -> None:
    whole, first, now = sprung
    assert couplings_again(late_of(whole, SPRING), now, [first]) == (now, [first], [])
    stands = now._replace(model=MODEL.with_effect(SPRING, **COUPLING))
    assert couplings_again(late_of(whole), stands, [first]) == (stands, [first], [])
    base = first.round.base._replace(model=LIGHT)
    again = replace(first, round=replace(first.round, base=base))
    assert couplings_again(late_of(whole), now, [again])[1] == [again]


def test_what_gives_the_load_a_motion_of_its_own_takes_no_place_beside_one_that_coasts(
    sprung: tuple[Evidence, Named, Found],
) -> None:
    whole, first, now = sprung
    one, lag = first.round.contenders
    rubs = replace(lag, hypothesis=replace(lag.hypothesis, effect="load_friction"))
    begun = replace(first.round, contenders=(one, rubs))
    named = couplings_again(late_of(whole), now, [replace(first, round=begun)])[1]
    assert [n.effect for n in named] == [SPRING]


@pytest.mark.long
def test_a_cause_that_was_hardly_sure_faces_whoever_gained_and_no_coupling(
    sprung: tuple[Evidence, Named, Found],
) -> None:
    whole, first, now = sprung
    spring, lag = first.round.contenders
    for seen_z, held_gain, faces in ((3.0, 0.1, True), (30.0, 0.1, False), (3.0, -0.1, False)):
        unsure = replace(lag, seen_z=seen_z, held_z=3.0, costs=0.5 * lag.costs)
        line = replace(lag.hypothesis, effect="transport_delay")
        other = replace(lag, hypothesis=line, held_gain=held_gain)
        begun = replace(first.round, contenders=(unsure, other, spring))
        told = list[str]()
        one = Named("current_loop_lag", begun, unsure, own_unknowns(unsure, "current_loop_lag"))
        run_off(whole, now, [one], BAND, told.append)
        assert told[:1] == (["current_loop_lag against transport_delay"] if faces else [])


ONE_SIDED_NM = 4e-3
ONE_SIDED = {"asymmetric_friction": "difference_torque_nm", "load_torque": "torque_nm"}
OTHER_ORDERS = (("load_torque", "asymmetric_friction"), *((it, it) for it in ONE_SIDED))


@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ("asymmetric_friction", "load_torque"),
        *(pytest.param(*it, marks=pytest.mark.long) for it in OTHER_ORDERS),
    ],
)
def test_of_a_class_that_rest_tells_apart_the_one_that_fits_it_is_told_first(
    hidden: str, named: str
) -> None:
    """While the shaft turns both are the same torque; a friction takes what comes at rest."""
    rig = MODEL.with_effect(hidden, **{ONE_SIDED[hidden]: ONE_SIDED_NM})
    whole = evidence_of([recorded(rig, 66, slots=900)], MODEL, block="loop")
    base = seek(whole, MODEL, BAND, iterations=3)
    both = [fitted(whole, *effect, ONE_SIDED_NM) for effect in ONE_SIDED.items()]
    played = faced(whole, base, both)
    (one,) = (c for c in played.contenders if c.effect == named)
    first = Named(named, played, one, own_unknowns(one, named))
    joint, _ = fit_jointly(whole, one.found, [first], BAND, nothing_told)
    final, (kept,) = run_off(whole, joint, [first], BAND, nothing_told)
    assert kept.effect == hidden
    found_nm = final.value(f"{hidden}.{ONE_SIDED[hidden]}")
    assert found_nm == pytest.approx(ONE_SIDED_NM, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("asked", [True, False])
def test_bristles_that_slide_beside_everything_are_plain_friction(asked: bool) -> None:
    """Where that was asked: what nobody may name takes no place."""
    hidden = MODEL.with_effect("coulomb", torque_nm=FRICTION_NM, transition_rad_s=0.01)
    whole = evidence_of([recorded(hidden, 62, slots=1200)], MODEL, block="loop")
    commands = np.asarray(whole.fitted[0].source.rows.channel("velocity_command_rad_s"))
    tried = {h.effect: h for h in hypotheses(scales_of(MODEL, commands, 0.008))}
    start = MODEL.with_effect("pre_sliding", torque_nm=FRICTION_NM, breakaway_angle_rad=3e-6)
    own = widened("pre_sliding", tried["pre_sliding"].free, start, FRICTION_NM)
    bristles = seek(whole, start, merged(BAND, own), iterations=3)
    base = seek(whole, MODEL, BAND, iterations=3)
    screened = tuple(Screened(tried[e], tried[e].trials[0], 0.5) for e in ("coulomb",) if asked)
    played = faced(whole, base, [(bristles, tried["pre_sliding"])], screened)
    (one,) = played.contenders
    first = Named(one.effect, played, one, own_unknowns(one, one.effect))
    final, (kept,) = run_off(whole, bristles, [first], BAND, nothing_told)
    assert kept.effect == ("coulomb" if asked else "pre_sliding")
    assert final.value(f"{kept.effect}.torque_nm") == pytest.approx(FRICTION_NM, rel=0.05)


@pytest.mark.long
def test_of_a_class_that_rest_tells_apart_both_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little the one promised beside others: what was not fitted cannot compete."""
    monkeypatch.setattr(rounds, "FITTED", 1)
    rig = MODEL.with_effect("load_torque", torque_nm=ONE_SIDED_NM)
    run = recorded(rig, 67, slots=600)
    seen = evidence_of([run], MODEL, block="loop")
    commands = np.asarray(run["velocity_command_rad_s"])
    scales = scales_of(MODEL, commands, run.period_s)
    asked = hypotheses(scales, only=[*ONE_SIDED, "gravity_imbalance"])
    played = rounds.play_round(seen, seek(seen, MODEL, BAND, iterations=3), asked, {}, nothing_told)
    assert {c.effect for c in played.contenders} == set(ONE_SIDED)


def _as_good(contender: Contender, one: Contender) -> Contender:
    """What a beginning that is too short would have said."""
    return contender if contender is one else replace(contender, costs=one.costs)


def friction(load_share: float) -> Model:
    """Of a load with a mass that its gap lets go on."""
    mass = load_share * NOMINAL.inertia_kg_m2
    return MODEL.with_effect("load_friction", torque_nm=FRICTION_NM).with_effect(
        "contact",
        compliance_rad_per_nm=FACE_RAD_PER_NM,
        load_inertia_kg_m2=mass,
        damping_s=0.4 * float(np.sqrt(FACE_RAD_PER_NM * mass)),
    )


@pytest.mark.parametrize(
    ("share", "named"), [pytest.param(0.03, {"contact"}, marks=pytest.mark.long), (0.0015, set())]
)
def test_a_mass_behind_friction_is_a_cause_where_the_motor_feels_it(
    share: float, named: set[str]
) -> None:
    played = [recorded(friction(share), 62, slots=900)]
    found = find_causes(played, MODEL, only=("load_friction", "contact"))
    assert {n.effect for n in found.named} == {"load_friction"} | named
    if named:
        mass = found.final.model.effects["contact"].load_inertia_kg_m2
        assert mass == pytest.approx(share * NOMINAL.inertia_kg_m2, rel=0.15)


def test_a_mass_is_tried_that_the_known_friction_slows_down() -> None:
    rig = MODEL.with_effect("load_friction", torque_nm=FRICTION_NM)
    scales = scales_of(MODEL, np.ones(64), 0.008)
    (contact,) = hypotheses(scales, only=("contact",))
    slowed = [trial for trial in contact.trials if trial.slowed_rad_s2 is not None]
    for trial in slowed:
        mass = trial.on(rig).effects["contact"].load_inertia_kg_m2
        assert FRICTION_NM / mass == pytest.approx(trial.slowed_rad_s2)
        with pytest.raises(EffectError, match="No friction of a load"):
            trial.on(MODEL)
    assert slowed


@pytest.mark.long
def test_a_search_among_faces_goes_on_where_one_ended() -> None:
    """From faces that are far too stiff a search by secants ends in a valley of its own."""
    hidden = friction(0.05)
    whole = evidence_of([recorded(hidden, 63, slots=600)], MODEL, block="loop")
    stiff = hidden.effects["contact"]._asdict() | {"compliance_rad_per_nm": 0.05 * FACE_RAD_PER_NM}
    start = hidden.with_effect("contact", **stiff)
    free = widened("contact", ("compliance_rad_per_nm", "damping_s"), start, 0.05 * FACE_RAD_PER_NM)
    ended = seek(whole, start, free, iterations=4, first=2, coarse=False)
    assert ended.value("contact.compliance_rad_per_nm") < 0.6 * FACE_RAD_PER_NM
    found = on_other_faces(whole, ended, {"contact"})
    assert found.cost < 0.7 * ended.cost
    assert found.value("contact.compliance_rad_per_nm") == pytest.approx(FACE_RAD_PER_NM, rel=0.2)


def no_better_than_the_base(*effects: str) -> Round:
    """A round of contenders with nothing to show, for tests to say what they have."""
    whole = evidence_of([recorded(MODEL, 64, slots=300)], MODEL, block="loop")
    base = seek(whole, MODEL, (), iterations=0)
    return faced(whole, base, [(base, Hypothesis(effect, (), ())) for effect in effects])


def test_a_cause_that_another_cannot_be_without_is_not_taken_away() -> None:
    """A hub of more than the drawing's whole inertia: only with the inertia that was found."""
    inertia = NOMINAL.inertia_kg_m2
    rig = MODEL.with_effect("inertia_error", error_fraction=0.25)
    rig = rig.with_effect(
        "coupling_compliance", compliance_rad_per_nm=3e-3, load_inertia_kg_m2=1.02 * inertia
    )
    whole = evidence_of([recorded(rig, 62, slots=600)], MODEL, block="loop")
    played = no_better_than_the_base("inertia_error", "coupling_compliance")
    named = [Named(c.effect, played, c, ()) for c in played.contenders]
    unknown = Unknown("inertia_error", "error_fraction", 0.2, 0.3, step=0.01)
    final = seek(whole, rig, (unknown,), iterations=1)
    _, kept = fit_jointly(whole, final, named, (), nothing_told)
    assert "inertia_error" in {one.effect for one in kept}


def showing(played: Round, effect: str, **what: float) -> Contender:
    (one,) = (c for c in played.contenders if c.effect == effect)
    return replace(one, **what)


def test_what_explained_much_of_what_no_fit_saw_is_asked_again_beside_its_plain_rival() -> None:
    played = no_better_than_the_base("stribeck")

    def having(held_gain: float, held_z: float) -> Round:
        one = showing(played, "stribeck", held_gain=held_gain, held_z=held_z)
        return replace(played, contenders=(one,))

    assert unsure([having(0.3, 6.0)]) == {"stribeck", "coulomb"}
    assert unsure([having(0.3, 1.0), having(0.1, 6.0)]) == set()


@pytest.mark.parametrize(
    ("beside", "seen_gain", "held_gain", "worth"),
    [
        (MODEL, 0.05, 0.2, True),
        (MODEL, 0.2, 0.05, False),
        (friction(0.05).without("contact"), 0.05, 0.2, False),
        (friction(0.05).without("contact"), 0.15, 0.2, True),
        (coasting(MODEL, 350.0), 0.2, 0.05, True),
    ],
)
def test_what_a_coupling_must_take_goes_with_what_else_gives_way(
    beside: Model, seen_gain: float, held_gain: float, *, worth: bool
) -> None:
    """Faces that a load's friction presses give way as a coupling does; beside a load that coasts
    little else is left for one to fit."""
    played = no_better_than_the_base("coupling_compliance")
    one = showing(played, "coupling_compliance", seen_gain=seen_gain, held_gain=held_gain)
    table = {"compliance_rad_per_nm": 3e-3, "load_inertia_kg_m2": 5e-5}
    soft = beside.with_effect("coupling_compliance", **table)
    found = one.found._replace(model=soft)
    scales = scales_of(MODEL, np.ones(64), 0.008)
    assert is_worth_it(Named(one.effect, played, one, ()), found, scales) is worth


@pytest.mark.parametrize(
    ("held_z", "held_gain", "accepted"), [(11.0, 0.33, "coulomb"), (-5.0, -0.3, "stribeck")]
)
def test_what_only_refines_gives_way_unless_the_held_out_blocks_speak_against_the_plain_one(
    held_z: float, held_gain: float, accepted: str
) -> None:
    played = no_better_than_the_base("coulomb", "stribeck")
    plain = showing(
        played, "coulomb", seen_z=3.2, held_z=held_z, seen_gain=0.018, held_gain=held_gain
    )
    fine = showing(played, "stribeck", seen_z=4.3, held_z=13.5, seen_gain=0.018, held_gain=0.35)
    found = accepted_of(replace(played, contenders=(plain, fine)), 0, right=False)
    assert found is not None
    assert found.effect == accepted


def test_the_evidence_shows_every_block_of_a_part_and_none_of_the_other() -> None:
    played = no_better_than_the_base("coulomb")
    one = showing(played, "coulomb")
    one = replace(one, costs=np.array([0.0, 0.0, 3.0, 16.0, 0.0]))
    played = replace(played, base_costs=np.array([0.0, 0.0, 12.0, 0.0, 0.0]), contenders=(one,))
    figure = Figure()
    draw_evidence(figure, played, one)
    (line,) = (line for line in figure.axes[2].lines if line.get_label() == "over the base")
    np.testing.assert_allclose(line.get_ydata(), [-4.0, 3.0])


def test_what_fits_too_well_for_a_bar_is_told_in_figures() -> None:
    played = no_better_than_the_base("coulomb")
    one = replace(showing(played, "coulomb"), costs=np.array([0.5, 0.0]))
    figure = Figure()
    draw_evidence(
        figure, replace(played, base_costs=np.array([60.0, 40.0]), contenders=(one,)), one
    )
    assert [text.get_text() for text in figure.axes[1].texts] == ["0.5"]
    assert figure.axes[1].get_xlim()[1] > 115.0  # room for that of a cost that all is left of
