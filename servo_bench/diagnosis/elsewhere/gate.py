"""When a cause may be named on data from elsewhere: one set of thresholds for every data set.

Gains are those of blocks that neither chose the effect nor fitted it (`selection`).
"""

BLOCK_S = 1.0
"""Errors of two blocks count as independent."""
FOLDS = 5
HELD_Z = 2.5
"""Least mean gain over blocks, in its standard errors.

Set on the four data sets of tests/test_diagnose_realdata.py, so these do not prove it.
"""
HELD_SHARE = 0.01
"""Least share of the held-out error's square that the effect takes away."""
SURE = 4.0
"""Standard errors of an effect's size beyond zero; a sandwich of few blocks is too sure."""
QUIET = 1.5
"""What is no more than so many of its noise floor tells of nothing but the noise."""
MATERIAL = 0.015
"""Least rms of the effect's torque over that of the effort."""
ALIKE = 0.002
"""A column of which the others leave a smaller share of its norm cannot be told from them."""
MOST_TERMS = 16
"""Of the equation; every line is one."""
FEWEST_BLOCKS = 10
SECURE_Z = 6.0
"""An advantage over a rival at which the rival is out."""
EQUAL_GAIN = 0.97
"""Share of the best gain at which the simpler effect is taken, while the best is not secure."""


def confidence(evidence: float, over_rival: float) -> float:
    """Probability that the name is right: evidence and lead beside their thresholds.

    Stated, not calibrated: there are too few data sets of known truth from elsewhere.
    """
    lead = min(max(over_rival, 0.0), SECURE_Z) / SECURE_Z
    strength = min(max(evidence - HELD_Z, 0.0), 3.0 * SECURE_Z) / (3.0 * SECURE_Z)
    return 0.6 + 0.2 * lead + 0.15 * strength
