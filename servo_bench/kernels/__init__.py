"""Volterra kernels of an M-sequence: pure functions from arrays, or a recording, to values."""
