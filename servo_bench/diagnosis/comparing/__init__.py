"""Measured minus simulated, signal by signal, and what a right simulation may miss of each.

rows, thinning      times and holes; a row to a command
playing, low_pass   a model over the rows' commands, taken where each signal was sampled
noise               the least error that a sensor allows
comparison, haar    both together; `compare(recording, model)`; over increments between means
evidence            the same of many recordings, in blocks; `evidence_of(recordings, model)`
allowance           what a right simulation misses anyway; beside it for uneven slots
                    (`lateness`), a coarse encoder (`rounding`), a drive's ticks, a bearing
                    (`unevenness`), and torque that is noise in motion alone (`scatter`)
locking             how much of an error repeats with angle, velocity, commands, or time
"""
