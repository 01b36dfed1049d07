"""What templates foretell: of causes that nuisances stood in for, and of what is there already."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.searching.approaching import KEPT, approached
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.gap import play_gap
from servo_bench.diagnosis.searching.gate import RIGHT
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial, hypotheses
from servo_bench.diagnosis.searching.rounds import play_round
from servo_bench.diagnosis.searching.scales import Scales, band_of, scales_of
from servo_bench.diagnosis.searching.screening import Screened, at_phase, screen, towards
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.sizes import material_sizes
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
SLOTS = 900


def rested(
    hidden: Model, seed: int, of: str = ""
) -> tuple[Evidence, Found, tuple[Hypothesis, ...], Scales]:
    """What the nuisances leave, each in its band, of a rig that has something more."""
    run = recorded(hidden, seed, slots=SLOTS)
    seen = evidence_of([run], MODEL)
    commands = np.asarray(run["velocity_command_rad_s"])
    scales = scales_of(MODEL, commands, PERIOD_S)
    band = band_of(scales, MODEL)
    band = tuple(u for u in band if of in u.effect)
    return seen, seek(seen, MODEL, band, iterations=4), hypotheses(scales), scales


def first(screened: tuple[Screened, ...], effect: str) -> Screened:
    return next(s for s in screened if s.hypothesis.effect == effect)


@pytest.mark.long
def test_a_nuisance_at_its_bound_comes_back_where_the_cause_takes_its_place() -> None:
    """K_T that falls with the current is K_T that is too large, as far as its band allows."""
    hidden = MODEL.with_effect("torque_constant_droop", droop_per_a2=3e-3)
    seen, base, tried, _ = rested(hidden, 31)
    assert abs(base.value("torque_constant_error.error_fraction")) > 4.9e-3
    best = screen(seen, base, tried)[0]
    assert best.hypothesis.effect == "torque_constant_droop"
    assert best.gain > 0.5


@pytest.mark.parametrize("lag_s", [2e-4, pytest.param(3e-4, marks=pytest.mark.long)])
def test_of_what_is_there_already_a_template_tells_the_whole(lag_s: float) -> None:
    hidden, lag = MODEL.with_effect("current_loop_lag", lag_s=lag_s), "current_loop_lag"
    seen, base, tried, _ = rested(hidden, 32, of=lag)
    assert base.value("current_loop_lag.lag_s") > 5e-5
    found = first(screen(seen, base, tried), lag)
    assert found.trial.size == pytest.approx(lag_s, rel=0.25)


@pytest.mark.parametrize(
    ("now_nm", "amount", "torque_nm"),
    [(0.0, 0.5, 0.01), (0.01, 0.5, 0.015), (0.08, 0.5, 0.05), (0.08, 1.5, 0.002)],
)
def test_a_trial_is_as_strong_as_what_is_there_and_what_is_added_and_never_less_than_nothing(
    now_nm: float, amount: float, torque_nm: float
) -> None:
    model = MODEL.with_effect("coulomb", torque_nm=now_nm)
    trial = towards(Trial("coulomb", {"torque_nm": 0.02}, 0.02), model, np.array([amount]))
    assert trial.size == pytest.approx(torque_nm)
    assert trial.on(model).effects["coulomb"].torque_nm == pytest.approx(torque_nm)


@pytest.mark.parametrize("effect", ["cogging", "misalignment"])
def test_a_wave_is_where_two_ways_from_the_believed_one_lead(effect: str) -> None:
    """From B so much of the way to each of two trials a quarter apart, as its error counts them:
    a misalignment's by its square, at twice its phase."""
    power = 2 if effect == "misalignment" else 1
    strength = "angle_rad" if effect == "misalignment" else "torque_nm"
    model = MODEL.with_effect(effect, **{strength: 0.006, "phase_rad": 0.5})
    trial = Trial(effect, {strength: 0.02, "phase_rad": 0.0}, 0.02)
    believed, one = 0.006**power * np.exp(1j * power * 0.5), 0.02**power
    amounts = np.array([0.7, -0.2])
    wanted = believed + amounts[0] * (one - believed) + amounts[1] * (1j * one - believed)
    found = at_phase(trial, model, amounts).settings
    made = found[strength] ** power * np.exp(1j * power * found["phase_rad"])
    assert made == pytest.approx(wanted)


def test_a_believed_wave_of_another_order_is_no_way_to_a_trial() -> None:
    model = MODEL.with_effect("cogging", torque_nm=0.02, order=24.0, phase_rad=1.0)
    trial = Trial("cogging", {"torque_nm": 0.01, "order": 12.0, "phase_rad": 0.0}, 0.01)
    found = at_phase(trial, model, np.array([0.3, 0.2])).settings
    assert found["torque_nm"] == pytest.approx(0.01 * np.hypot(0.3, 0.2))
    assert found["phase_rad"] == pytest.approx(np.arctan2(0.2, 0.3))


@pytest.mark.long
@pytest.mark.parametrize(
    "phase_rad", [0.7, -0.8, *(pytest.param(it, marks=pytest.mark.long) for it in (0.0, 1.5))]
)
def test_two_templates_tell_a_misalignment_of_any_phase(phase_rad: float) -> None:
    """Its error turns twice as its phase turns once, and grows with the square of the angle."""
    hidden = MODEL.with_effect("misalignment", angle_rad=0.06, phase_rad=phase_rad)
    seen, base, tried, _ = rested(hidden, 34, of="lag")
    found = first(screen(seen, base, tried), "misalignment")
    assert found.gain > 0.2  # the rest is noise
    assert found.trial.size == pytest.approx(0.06, rel=0.1)
    off_rad = float(found.trial.settings["phase_rad"]) - phase_rad
    assert abs(np.sin(off_rad)) < 0.1  # half a turn is the same joint


@pytest.mark.parametrize(
    ("compliance_rad_per_nm", "hub_share"),
    [(0.045, 0.3), (0.012, 0.45)],
)
@pytest.mark.long
def test_a_resonance_is_sought_from_trials_as_they_were_tried(
    compliance_rad_per_nm: float, hub_share: float
) -> None:
    """No part of a resonance's template is another resonance, and the valleys are narrow."""
    hub_kg_m2 = hub_share * NOMINAL.inertia_kg_m2
    soft = MODEL.with_effect(
        "coupling_compliance",
        compliance_rad_per_nm=compliance_rad_per_nm,
        load_inertia_kg_m2=hub_kg_m2,
        damping_s=1e-4,
    )
    seen, base, tried, scales = rested(soft, 35, of="lag")
    coupling = [h for h in tried if h.effect == "coupling_compliance"]
    found = play_round(seen, base, coupling, material_sizes(scales), lambda _: None)
    assert set(map(repr, found.screened[0].tried)) <= set(map(repr, coupling[0].trials))
    starts = approached(seen, base, coupling[0], found.screened[0].tried)
    assert 1 <= len(starts) <= KEPT[-1]
    left = [errors.cost(base.sigma) for errors in seen.seen([start.model for start in starts])]
    tried_as_they_are = [trial.on(base.model) for trial in found.screened[0].tried]
    assert max(left) < min(e.cost(base.sigma) for e in seen.seen(tried_as_they_are))
    assert starts[0].model.effects["coupling_compliance"].compliance_rad_per_nm == pytest.approx(
        compliance_rad_per_nm, rel=0.3
    )
    swinging = found.contenders[0].found.model.effects["coupling_compliance"]
    assert swinging.compliance_rad_per_nm == pytest.approx(compliance_rad_per_nm, rel=0.1)
    assert swinging.load_inertia_kg_m2 == pytest.approx(hub_kg_m2, rel=0.1)


@pytest.mark.parametrize(("share", "named"), [(0.045, True), (-0.045, True), (0.0, False)])
def test_a_gap_that_is_a_little_wrong_is_a_cause_where_nothing_else_is(
    share: float, *, named: bool
) -> None:
    """Within the band that is free in every fit."""
    change_rad = share * NOMINAL.backlash_gap_rad
    hidden = MODEL.with_effect("backlash_width", change_rad=change_rad) if share else MODEL
    seen, base, tried, scales = rested(hidden, 33)
    found = play_gap(seen, base, tried, scales)
    assert (found is not None) is named
    if found is not None:
        gap = found.contender.found.value("backlash_width.change_rad")
        assert gap == pytest.approx(change_rad, rel=0.05)


@pytest.mark.long
def test_what_promised_less_has_its_turn_where_nothing_held_what_it_promised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A rig that rubs, and a gate that lets nothing pass."""
    for gate in ("accepting.passes", "late.passes_beside_coasting", "late.promises"):
        monkeypatch.setattr(f"servo_bench.diagnosis.searching.{gate}", lambda *_, **__: False)
    hidden = MODEL.with_effect("coulomb", torque_nm=0.03)
    run = recorded(hidden, 34, slots=SLOTS)
    finding = find_causes([run], MODEL, only=("coulomb", "viscous", "stribeck", "load_friction"))
    assert not finding.named
    assert float(finding.misfit_before.max()) > RIGHT
    asked = [{s.hypothesis.effect for s in played.screened} for played in finding.rounds]
    tried = [{c.effect for c in played.contenders} for played in finding.rounds]
    assert len(finding.rounds) > 1
    assert not any(tried[0] & later for later in asked[1:])
