"""A verdict, its rig and its page tell the same fit; and nothing that nobody asked for."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.concluding import Concluded, conclude
from servo_bench.recording.recording import Recording
from servo_bench.report.diagnosis_figures import judged
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, STANDSTILL, recorded

MODEL = Model(NOMINAL)
LOST = 8


def with_lost_commands(seed: int, slots: int) -> Recording:
    """Of every so many changes the drive heard none: it held the command before."""
    rng = np.random.default_rng(seed)
    sent = np.append(np.zeros(STANDSTILL), rng.choice([-6.0, -2.0, 2.0, 6.0], slots))
    heard = sent.copy()
    changes = np.flatnonzero(np.diff(sent) != 0.0) + 1
    for row in sorted(rng.choice(changes[changes > 2 * STANDSTILL], LOST, replace=False)):
        heard[row] = heard[row - 1]
    run = recorded(MODEL, seed, played=heard)
    return replace(run, channels={**run.channels, "velocity_command_rad_s": sent})


def concluded(*only: str) -> Concluded:
    seen, held_out = with_lost_commands(71, 1200), with_lost_commands(72, 800)
    return conclude([seen], model=MODEL, held_out=held_out, only=only)


def test_an_empty_recording_is_refused_in_words() -> None:
    run = recorded(MODEL, 70)
    empty = replace(run, channels={name: run[name][:0].copy() for name in run.channels})
    found = conclude([empty], model=MODEL)
    assert found.verdict.verdict == "unknown"
    assert "0 rows" in " ".join([found.verdict.sentence, *found.verdict.notes])


@pytest.mark.long
def test_the_page_s_nominal_has_the_commands_that_were_sent_as_the_sentence_has() -> None:
    found = concluded("missed_samples")
    assert found.verdict.names == ("missed_samples",)
    assert found.verdict.error is not None
    assert found.finding is not None
    (_, _, before, after, _), *_ = judged(found.finding).rms()
    assert before == pytest.approx(found.verdict.error.before)
    assert after == pytest.approx(found.verdict.error.after)
    assert before > 1.1 * after


@pytest.mark.nightly
def test_commands_that_were_lost_are_not_told_where_another_cause_was_asked() -> None:
    found = concluded("viscous")
    assert "missed_samples" not in found.verdict.names
    assert "missed_samples" not in found.verdict.effects


@pytest.mark.nightly
def test_what_is_too_small_for_a_name_is_in_the_rig_that_is_told() -> None:
    rig = MODEL.with_effect("cogging", torque_nm=2e-4, order=12.0, phase_rad=0.4)
    rig = rig.with_effect("coulomb", torque_nm=8e-4)
    seen, held_out = recorded(rig, 73, slots=1800), recorded(rig, 74, slots=1000)
    found = conclude([seen], model=MODEL, held_out=held_out, only=("cogging",))
    assert found.verdict.verdict == "none"
    assert found.verdict.error is not None
    assert found.finding is not None
    (_, _, _, after, _), *_ = judged(found.finding).rms()
    assert after == pytest.approx(found.verdict.error.after)
    for name, value in found.verdict.nuisances.items():
        effect, field = name.split(".")
        assert found.verdict.effects.get(effect, {}).get(field, 0.0) == pytest.approx(value)
    assert ("cogging" in found.verdict.effects) == ("cogging" in found.finding.absorbed)
