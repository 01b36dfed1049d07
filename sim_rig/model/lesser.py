"""The lesser and the greater of two numbers, as Python's min and max choose them.

Numba compiles its own min and max anew for every caller, by its whole pipeline; these two once.
"""


def lesser(a: float, b: float) -> float:
    """min(a, b)."""
    return b if b < a else a


def greater(a: float, b: float) -> float:
    """max(a, b)."""
    return b if b > a else a
