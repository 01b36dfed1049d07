"""Estimators by name, each with the memory that is its default or is asked for."""

from collections.abc import Callable, Mapping

from servo_bench.errors import ConfigError
from servo_bench.estimators.correlation import Correlation
from servo_bench.estimators.data import Estimator
from servo_bench.estimators.greybox import GreyBox, RigModel, SecondOrderPlay
from servo_bench.estimators.hybrid import Hybrid
from servo_bench.estimators.least_squares import LeastSquares
from servo_bench.estimators.play import FirPlay
from servo_bench.estimators.regularised import RegularisedVolterra

Maker = Callable[[int | None, RigModel], Estimator]

ESTIMATORS: Mapping[str, Maker] = {
    "correlation": lambda memory, _: Correlation(memory or 18),
    "least-squares": lambda memory, _: LeastSquares(memory or 14),
    "regularised": lambda memory, _: RegularisedVolterra(memory or 30),
    "play": lambda memory, _: FirPlay(memory or 30),
    "plays": lambda memory, _: FirPlay(memory or 30, plays=6),
    "grey-box": lambda _, model: GreyBox(model),
    "hybrid": lambda memory, model: Hybrid(GreyBox(model), RegularisedVolterra(memory or 20)),
}


def estimator(name: str, memory: int | None = None, model: RigModel | None = None) -> Estimator:
    """The estimator of that name; ConfigError where there is none.

    `memory` in samples; `model` is what the grey box and the hybrid fit, else the paper's.
    """
    if name not in ESTIMATORS:
        raise ConfigError(f"there is no estimator {name!r}: choose one of {', '.join(ESTIMATORS)}.")
    return ESTIMATORS[name](memory, model or SecondOrderPlay())
