"""What was too little for a name, asked once more beside a load that coasts."""

import numpy as np
import pytest

from servo_bench.diagnosis.coasting import coasting, is_coasting
from servo_bench.diagnosis.evidence import evidence_of
from servo_bench.diagnosis.finding import nothing_told
from servo_bench.diagnosis.hypotheses import hypotheses, scales_of
from servo_bench.diagnosis.joint import Named
from servo_bench.diagnosis.late import asked_again
from servo_bench.diagnosis.seeking import seek
from servo_bench.diagnosis.unknowns import nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
SLOWED_RAD_S2 = 350.0
COUPLING, COMPLIANCE, HUB_KG_M2 = "coupling_compliance", 4e-3, 7.5e-5
SOFT = MODEL.with_effect(
    COUPLING, compliance_rad_per_nm=COMPLIANCE, load_inertia_kg_m2=HUB_KG_M2, damping_s=4e-5
)


def again(hidden: Model, seed: int) -> Named | None:
    run = recorded(hidden, seed, slots=1200)
    seen = evidence_of([run], MODEL, block="loop")
    commands = np.asarray(run["velocity_command_rad_s"])
    scales = scales_of(MODEL, commands, MODEL.simulate(commands, PERIOD_S))
    band = nuisances(scales.rig_torque_nm, scales.speed_rad_s, scales.gap_rad)
    plain = seek(seen, MODEL, band, iterations=3)
    tried = hypotheses(scales, only=(COUPLING, "load_friction"))
    return asked_again(seen, plain, (COUPLING, "load_friction"), tried, scales, report=nothing_told)


def test_a_coupling_is_found_where_the_load_coasts_beside_it() -> None:
    found = again(coasting(SOFT, SLOWED_RAD_S2), 61)
    assert found is not None
    assert found.effect == COUPLING
    model = found.contender.found.model
    assert is_coasting(model)
    assert model.effects[COUPLING].compliance_rad_per_nm == pytest.approx(COMPLIANCE, rel=0.15)


@pytest.mark.parametrize("hidden", [coasting(MODEL, SLOWED_RAD_S2), MODEL, SOFT])
def test_none_is_found_where_there_is_none_or_where_nothing_coasts(hidden: Model) -> None:
    """A coupling alone has been asked already, and was too little."""
    assert again(hidden, 62) is None
