"""What every rig has beside its drawing, and no cause worth a name."""

from dataclasses import asdict

import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import Unknown, nuisances
from sim_rig.model import Model
from sim_rig.settings import Nominal
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded, with_channels
from tests.truth.nuisances import QUIET
from tests.truth.plant import TruthPlant
from tests.truth.rigs import tuned

GAIN = "proportional_gain_error"
STIFF = tuned(120.0, 0.4, 0.05, 2.5e-4, 0.0)


def band(integral_per_s: float) -> dict[str, Unknown]:
    return {u.effect: u for u in nuisances(0.05, 0.02, integral_per_s)}


def test_a_gain_may_be_wrong_by_what_a_drive_sums_ahead() -> None:
    assert GAIN not in band(0.0)
    assert band(200.0)[GAIN].high == 2.0 * band(100.0)[GAIN].high == -2.0 * band(100.0)[GAIN].low


@pytest.mark.parametrize("factor", [0.3, 1.0, 4.0])
def test_a_gain_is_a_cause_beyond_that_alone(factor: float) -> None:
    """A soft loop's band is small, and its causes are as large as what a drive is set wrong by."""
    model = Model(
        NOMINAL.__class__(**{**asdict(NOMINAL), "integral_gain_a_per_rad": factor * 27.0})
    )
    scales = scales_of(model, commands(3, 100), PERIOD_S)
    assert scales.integral_per_s == pytest.approx(factor * 27.0 / 0.3466)
    assert material_sizes(scales)[GAIN] > band(scales.integral_per_s)[GAIN].high
    assert material_sizes(scales)[GAIN] >= 0.0125


@pytest.mark.long
def test_a_drive_that_sums_once_a_period_has_a_larger_gain() -> None:
    """Backward Euler of period T: K_P + K_I T/2. Of another hand's drive, which has 125 us."""
    nominal = Nominal(**asdict(STIFF))
    played = commands(5, 700)
    done = TruthPlant(STIFF, 5, nuisances=QUIET).play(played, PERIOD_S)
    model = Model(nominal)
    seen = with_channels(
        recorded(model, 5, slots=700, played=played),
        motor_position_rad=done.motor_position_rad,
        load_angle_rad=done.load_angle_rad,
        motor_torque_nm=nominal.torque_constant_nm_per_a * done.motor_current_a,
    )
    evidence = evidence_of([seen], model, block="loop")
    ahead = STIFF.integral_gain_a_per_rad / STIFF.proportional_gain_a_s_per_rad
    found = seek(evidence, model, nuisances(0.05, 0.0, ahead), iterations=4)
    wanted = 0.5 * QUIET.loop_period_s * ahead
    assert found.value(f"{GAIN}.error_fraction") == pytest.approx(wanted, rel=0.2)
