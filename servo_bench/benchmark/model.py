"""The model's speed beside one loop written by hand, its start, and its truth by halving steps.

To reach: 18 effects within 1.2x of the loop; first call of a fresh process within 2 s, from the
cache within 0.5 s, both without the interpreter's start; halving the step changes both angles by
less than 0.1 of the smallest change that is named, with any effect.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from servo_bench.benchmark.handwritten import EFFECTS, Symbols, compiled
from sim_rig.effects import catalogue
from sim_rig.model import LONGEST_STEP_S, Model, Simulated, simulate_many
from sim_rig.settings import Nominal

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, 0.0262)
SLOTS = 4096
PERIOD_S = 0.008
REPEATS = 15
SMALLEST_NAMED_RAD = 2.5e-5
"""The smallest change of load angle that a diagnosis is asked to name: the gap's floor limit."""

_FIRST_CALL = """
from sim_rig.model import Model
from sim_rig.settings import Nominal
Model(Nominal(0.03606, 2.5e-4, 0.97, 69.0, 0.0262)).simulate([5.0], 0.008)
"""
_BEGIN = (
    "from time import perf_counter, process_time\nbegan, worked = perf_counter(), process_time()\n"
)
_END = "print(perf_counter() - began, process_time() - worked)"
FIRST_CALLS, STARTS = 3, 9


def measure(seed: int) -> dict[str, Any]:
    """Medians in seconds and nanoseconds per step; `seed` draws the commands."""
    levels = np.random.default_rng(seed).choice(np.array([-5.0, 5.0]), SLOTS)
    ideal, all_on = Model(NOMINAL), Model.from_table(NOMINAL, EFFECTS)
    return {
        "effects_composed": len(catalogue()),
        "effects_on": len(EFFECTS),
        **_beside_the_loop(ideal, all_on, levels),
        **_start(),
        "simulations_per_second_over_cores": _batch(all_on, levels),
        "halving_the_step": _halving(levels[:512]),
        "seed": seed,
    }


def _beside_the_loop(ideal: Model, all_on: Model, levels: Any) -> dict[str, float]:
    loop, loads = compiled(), np.empty(levels.size)
    symbols = Symbols(0.03606, 2.5e-4, 0.97, 69.0, 0.0262)

    def by_hand() -> None:
        loop(symbols, levels, PERIOD_S, LONGEST_STEP_S, loads)

    done = all_on.simulate(levels, PERIOD_S)
    ours, hand = _together(lambda: all_on.simulate(levels, PERIOD_S), by_hand)
    alone, _ = _together(lambda: ideal.simulate(levels, PERIOD_S), lambda: None)
    steps = levels.size * PERIOD_S / LONGEST_STEP_S
    return {
        "ns_per_step": ours / steps * 1e9,
        "ns_per_step_without_effects": alone / steps * 1e9,
        "ns_per_step_by_hand": hand / steps * 1e9,
        "times_the_loop_by_hand": ours / hand,
        "largest_difference_in_80_ms_rad": float(
            np.abs(done.load_angle_rad[1:11] - loads[:10]).max()
        ),
    }


def _together(first: Callable[[], object], second: Callable[[], object]) -> tuple[float, float]:
    """Medians of runs that take turns, so that the machine's moods fall on both.

    Processor time: both run in this thread alone, and may have to wait for other programs.
    """
    first(), second()
    times: list[tuple[float, float]] = []
    for _ in range(REPEATS):
        began = process_time()
        first()
        between = process_time()
        second()
        times.append((between - began, process_time() - between))
    ours, theirs = np.median(np.array(times), axis=0).tolist()
    return ours, theirs


def _start() -> dict[str, float]:
    """One call in a process of its own, with an empty cache and again with what it left.

    Beside it what importing numpy takes, which every simulation needs, and numba.
    """
    with tempfile.TemporaryDirectory() as folder:
        firsts = [_process_s(_FIRST_CALL, Path(folder) / str(k)) for k in range(FIRST_CALLS)]
        warm = Path(folder) / "0"
        programs = (_FIRST_CALL, "import numpy", "import numba")
        starts = [[_process_s(program, warm) for program in programs] for _ in range(STARTS)]
    first, first_cpu = np.median(firsts, axis=0).tolist()
    (again, again_cpu), (numpy_s, _), (numba_s, _) = np.median(starts, axis=0).tolist()
    return {
        "first_call_s": first,
        "first_call_cpu_s": first_cpu,
        "first_call_from_cache_s": again,
        "first_call_from_cache_cpu_s": again_cpu,
        "import_numpy_s": numpy_s,
        "import_numba_s": numba_s,
    }


def _process_s(program: str, cache_home: Path) -> list[float]:
    """Wall and processor time of a program, without the start of its interpreter."""
    timed = f"{_BEGIN}{program}\n{_END}"
    done = subprocess.run(
        [sys.executable, "-c", timed],
        env={**os.environ, "XDG_CACHE_HOME": str(cache_home)},
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(word) for word in done.stdout.split()]


def _batch(model: Model, levels: Any) -> float:
    models = [model.with_effect("coulomb", torque_nm=0.001 * k) for k in range(16)]
    began = perf_counter()
    simulate_many(models, levels, PERIOD_S)
    return len(models) / (perf_counter() - began)


def _halving(levels: Any) -> dict[str, float]:
    """The change of either angle over the smallest one to name, by effect; the largest first."""

    def played(effects: dict[str, dict[str, float]], longest_step_s: float) -> Simulated:
        model = Model.from_table(NOMINAL, effects)
        return Model(NOMINAL, model.effects, longest_step_s).simulate(levels, PERIOD_S)

    changes = {}
    for name, effect in catalogue().items():
        effects = {
            "load_friction": {"torque_nm": 3e-3},
            **{other: dict(values) for other, values in effect.beside.items()},
            name: dict(effect.sample),
        }
        whole, half = (played(effects, h) for h in (LONGEST_STEP_S, LONGEST_STEP_S / 2.0))
        change = max(
            np.abs(whole.load_angle_rad - half.load_angle_rad).max(),
            np.abs(whole.motor_angle_rad - half.motor_angle_rad).max(),
        )
        changes[name] = float(change / SMALLEST_NAMED_RAD)
    return dict(sorted(changes.items(), key=lambda item: -item[1]))
