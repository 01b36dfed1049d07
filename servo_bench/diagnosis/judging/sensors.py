"""What a channel is that no rig makes so: counted the other way, read at another time, averaged.

Nobody's physics is wrong then, and no effect explains it. So it is looked for where nothing else
explained the error, and told in words: what it looks like, and what to write in the map.

    both angles over the simulated ones             the command's unit
    one of them, or the one in the other's place    (`reading.channels`)
    the measured torque over the simulated          sign, unit, rated value; or nothing said
    the instant, or the low pass, at which the simulation comes nearest to a channel (`sampled`)
"""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.evidence import coarser
from servo_bench.diagnosis.judging.sampled import CURRENT, as_read
from servo_bench.diagnosis.reading.channels import (
    another_size,
    commanded_scale,
    values_of,
    wrong_angles,
)
from sim_rig.model import Model

SAYS_NOTHING = 0.02
"""Of a torque's scatter, what is no sign of life."""
LEAST = 0.5
"""Of what the motion needs: an inertia that nobody knows makes so much."""


def misread(comparison: Comparison, nominal: Model, found: Model) -> Iterator[str]:
    """What stands in the channels of a closed loop's recording, one sentence for each.

    `found` has the causes that do not explain it: a cause may hide what a sensor does, or it may
    have been bent to stand in for it.
    """
    if comparison.block != "loop":
        return
    scale = commanded_scale(comparison, nominal)
    if scale is not None:
        yield (
            f"Motor and load move {scale:.3g} times as far as the command asks of the rig, both: "
            "look at the command's unit (1 rpm is 0.105 rad/s, 1 degree/s 0.0175) and its scale."
        )
        return
    said = (*wrong_angles(comparison, nominal), *_efforts(comparison, (nominal, found)))
    yield from said or as_read(comparison, [coarser(model) for model in (nominal, found)])


def _efforts(comparison: Comparison, models: Sequence[Model]) -> Iterator[str]:
    """A torque or current that is of another sign or unit by any of the models, or says nothing."""
    for signal in comparison.signals:
        if signal.simulated != CURRENT:
            continue
        played = [values_of(comparison, model, signal.channel, CURRENT) for model in models]
        measured, needed = played[0][0], signal.factor * played[0][1]
        scales = [another_size(values, signal.factor * shown) for values, shown in played]
        far = [scale for scale in scales if scale is not None and not LEAST < scale < 1.0 / LEAST]
        name = signal.name.removeprefix("motor ")
        if far:
            yield (
                f"The drive's {name} is {far[0]:.3g} times what the motion needs: look at its "
                "sign, its unit (a drive tells thousandths of a rated value), and that value."
            )
        elif measured.size and np.std(measured) < SAYS_NOTHING * np.std(needed):
            yield (
                f"The drive's {name} stays at {np.median(measured):.3g} {signal.unit} while the "
                "axis is driven: it says nothing. Map another object, or leave the channel away."
            )
