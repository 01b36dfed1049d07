"""Recordings again: played to a page, played into a rig, analysed anew, and compared.

playback     a recording's samples in time, at any speed, with seek
command      the recorded command as an experiment
difference   run against run, slot by slot
against      the recorded command played into a rig, and the difference
through      the analysis of today beside the figures of then
compare      has the rig changed: kernels, noise, parameters, with standard errors
"""
