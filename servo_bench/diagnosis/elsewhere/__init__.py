"""Verdicts on data from elsewhere: an effort in and a motion out, without a loop of ours.

gate        the thresholds, all of them
channels    what such a recording has, on even times
weak        the equation of motion, integrated over short stretches
terms       the catalogue's effects as columns of that equation
selection   which columns pay on blocks that did not choose them
windows     simulation from the measured state, a second at a time
mechanics, locked, verdicts, diagnose     the two kinds of data, and their verdict
"""

from servo_bench.diagnosis.elsewhere.diagnose import diagnose_open
from servo_bench.diagnosis.fitting.foreign_channels import is_open

__all__ = ["diagnose_open", "is_open"]
