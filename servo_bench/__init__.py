"""A test bench for AC servo rigs."""

__version__ = "0.1.0"
