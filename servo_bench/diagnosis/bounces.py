"""What a load's bounces may miss: nobody knows the law of the faces that it bounces on.

A load with a mass meets a face many times a second, and each bounce begins where the last one
ended: a face that is twice as stiff, or takes half as much of a blow, leaves the motor as it is and
sends the load elsewhere in its gap. The contact of the catalogue is linear and real ones are not
(Hertz, Hunt and Crossley), so no numbers of it are right for every blow. What such a factor changes
is therefore no sign of a wrong cause.
"""

from itertools import product

import numpy as np

from servo_bench.diagnosis.coasting import is_coasting
from servo_bench.diagnosis.evidence import Evidence
from servo_bench.diagnosis.hypotheses import VEHICLE
from servo_bench.diagnosis.rows import Array
from sim_rig.model import Model

OTHERWISE = (0.5, 2.0)
"""Of a face's stiffness and damping: Hertz's law makes it of blows eight times as hard or soft."""
NUMBERS = ("compliance_rad_per_nm", "damping_s")
MOST = 3.0
"""Of what a right simulation may miss anyway: what is more than that is not known at all."""


def bounces(whole: Evidence, model: Model) -> Array:
    """Robust change of every signal by other faces, the largest of four, within `MOST`; zeros
    without a load of its own. Shape (signals,).
    """
    none = np.zeros(len(whole.names))
    if VEHICLE not in model.effects or is_coasting(model):
        return none
    params = model.effects[VEHICLE]._asdict()
    others = [
        model.with_effect(VEHICLE, **{**params, name: times * params[name]})
        for name, times in product(NUMBERS, OTHERWISE)
    ]
    here, *there = whole.seen([model, *others])
    changes = [1.4826 * np.nanmedian(np.abs(e.rows - here.rows), axis=1) for e in there]
    largest = np.max([none, *(c for c in changes if np.isfinite(c).all())], axis=0)
    return np.asarray(np.minimum(largest, MOST * whole.allowed))
