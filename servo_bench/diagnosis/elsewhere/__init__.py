"""Verdicts on data from elsewhere: an effort in and a motion out, without a loop of ours.

gate        the thresholds, all of them
weak        the equation of motion, integrated over short stretches
equation    its columns and coefficients, solved for the acceleration or for the effort
terms       the catalogue's effects as columns of that equation; `spectrum`: those with an order
held        how well it foretells blocks that did not make it
selection   which columns pay on those blocks
mechanics, looped, locked, and the verdict of each     the three kinds of data
shown       what a picture of them needs
"""

from servo_bench.diagnosis.elsewhere.diagnose import diagnose_open, judge_open
from servo_bench.diagnosis.elsewhere.shown import Shown
from servo_bench.diagnosis.fitting.foreign_channels import is_open

__all__ = ["Shown", "diagnose_open", "is_open", "judge_open"]
