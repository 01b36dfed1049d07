"""Whether a model explains what was measured where no fit saw it.

Without that, a verdict "none" would say that nothing pays beside a model that is not this rig's.
"""

EXPLAINED = 0.5
"""Of the square of an acceleration, an effort or a twist, that a plain model explains at least."""
PLAYED = 0.9
"""The same of a position loop that is played whole: it leads any motor to its goal. Made ones of a
right model had 0.999 and more, one that an unrecorded torque turned as much as its goal 0.66."""


def share_explained(error: float, there: float) -> float:
    """1 - (error/there)^2, both rms; 1 where nothing is there."""
    return 1.0 - (error / there) ** 2 if there > 0.0 else 1.0
