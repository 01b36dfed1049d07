"""The page's hyperbolic tangent against the C library's."""

import math

import numpy as np

from sim_rig.model.saturated import saturated


def test_it_is_the_hyperbolic_tangent_to_a_rounding_of_one() -> None:
    for x in (*np.linspace(-25.0, 25.0, 5001), *10.0 ** np.arange(-300.0, 300.0, 7.0)):
        assert abs(saturated(float(x)) - math.tanh(x)) <= 2.5e-16
        assert saturated(-float(x)) == -saturated(float(x))


def test_it_rests_and_is_full() -> None:
    assert saturated(0.0) == 0.0
    assert saturated(math.inf) == 1.0
    assert saturated(-math.inf) == -1.0
