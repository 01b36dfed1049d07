"""Recordings: the value, and the one module that knows MCAP."""
