"""Three things that may be wrong with a rig, as a round's fits find them: a lag, a delay, which
changes nearly the same, and a line of the shaft, which changes something else."""

from collections.abc import Mapping

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import merged, nuisances, widened
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL

MODEL = Model(NOMINAL)
BAND = nuisances(0.05, NOMINAL.backlash_gap_rad)
LAG, LINE, DELAY = "current_loop_lag", "cogging", "transport_delay"
Sizes = Mapping[str, dict[str, float]]
SIZES: Sizes = {
    LAG: {"lag_s": 4e-4},
    DELAY: {"delay_s": 4e-4},
    LINE: {"torque_nm": 3e-3, "order": 24.0, "phase_rad": 0.4},
}
FREE = {LAG: ("lag_s",), DELAY: ("delay_s",), LINE: ("torque_nm", "phase_rad")}


def rig(*effects: str, sizes: Sizes = SIZES) -> Model:
    """With these wrong."""
    model = MODEL
    for effect in effects:
        model = model.with_effect(effect, **sizes[effect])
    return model


def fitted(seen: Evidence, effect: str, sizes: Sizes = SIZES) -> tuple[Found, Hypothesis]:
    """The search of a hypothesis from its true size."""
    start, size = rig(effect, sizes=sizes), next(iter(sizes[effect].values()))
    own = widened(effect, FREE[effect], start, size)
    hypothesis = Hypothesis(effect, (Trial(effect, dict(sizes[effect]), size),), FREE[effect])
    return seek(seen, start, merged(BAND, own), iterations=3), hypothesis
