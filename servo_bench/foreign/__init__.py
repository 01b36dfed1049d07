"""Measured data from elsewhere in, and recordings out to other programs."""
