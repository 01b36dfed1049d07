"""The truth of a trial behind a real wire: factories that a rig file can name as its plant.

The rig's seed is twice the trial's seed, plus the take. How long the trial lasts does not come
over: neither what is hidden nor the largest velocity depends on it. Only the rig's process imports
this.
"""

from sim_rig.plant import Plant
from tests.trials.drawing import Kind, Question
from tests.truth.plant import NominalValues


def _plant(kind: Kind, nominal: NominalValues, seed: int) -> Plant:
    question = Question(seed=seed // 2, kind=kind, wire=True)
    return question.sealed().plant(nominal, question.plan.velocity_rad_s, take=seed % 2)


def one(nominal: NominalValues, seed: int) -> Plant:
    """One effect."""
    return _plant("one", nominal, seed)


def none(nominal: NominalValues, seed: int) -> Plant:
    """Nothing but the nuisances."""
    return _plant("none", nominal, seed)


def outside(nominal: NominalValues, seed: int) -> Plant:
    """A cause that the catalogue lacks."""
    return _plant("outside", nominal, seed)


def pair(nominal: NominalValues, seed: int) -> Plant:
    """Two effects."""
    return _plant("pair", nominal, seed)


def removed(nominal: NominalValues, seed: int) -> Plant:
    """One effect, whose name the diagnoser may not use."""
    return _plant("removed", nominal, seed)
