"""The catalogue: every physical effect that the model can have, one file each.

How to add an effect: one new file in this folder, and nothing else. Copy the nearest pattern

    coulomb.py           sum, no memory                current_limit.py   pipe, no memory
    pre_sliding.py       sum, memory                   current_loop_lag.py  pipe, memory
    cogging.py           several strengths             encoder_eccentricity.py  sensor
    inertia_error.py     once a simulation      transport_delay.py, clock_skew.py  once a slot
    contact.py           the transmission's elasticity

1. The docstring begins with one line "Name: where it acts." and, after an empty line, the
   equation indented by four spaces; then its symbols as a table (symbol, parameter, meaning), and
   what one must not expect of it.
2. `class Params(NamedTuple)`: strength first and 0.0 by default; every name ends in its unit
   (`sim_rig.effects.units.SUFFIXES`), every field is `Annotated[float, prior]` with LogUniform
   (a magnitude, never negative), Uniform (signed) or Known (not fitted) from `effect`. Hold a
   limit or a stiffness as its reciprocal, so that zero is none.
3. `def law(s, p)` returns what goes into the port: the torque (sum) or the new value (pipe; the
   old one is the signal of the port's name). Scalars and arrays alike. Its source is copied into
   the compiled page, so it is a row of assignments and one return, of arithmetic, comparisons,
   names from `s`, `z`, `p`, numbers that the file defines (`_NAME = 1.5`), and these functions:
   np.sin cos tan arctan arctan2 tanh exp expm1 log sqrt abs sign minimum maximum clip where
   floor rint hypot, np.pi. No `if`, no loop, no call of anything else. In the page np.where is
   lazy: guard costly terms with it. It is only reached while a strength is not zero; at zero the
   page skips it.
4. Memory: `class Memory(NamedTuple)` of floats, all 0.0; `law(s, z, p)` returns the mean over
   the step of length `s.step_s` that begins with z; `advance(s, z, p, dt_s)` returns the Memory
   at its end. dt_s and s.step_s are zero at a look: at a slot's start with the new command
   (`s.since_s` = 0: an input may have jumped) and at its end. `s.since_s` is the time since the
   law was last called. Advance stiff lags by their own exact exponentials. Looking twice must not
   change anything.
5. `EFFECT = Effect(port=..., params=..., law=..., shows=..., confused_with=(names), source=...)`
   with `sample={...}`, a plainly visible case (`beside={name: {...}}` if only beside others).
   `strengths=(...)` if more than the first one must be zero to switch it off. Confusion is
   mutual: every name in `confused_with` names this one.

The contract test (tests/contract_effect.py) asks every file the same questions. Order in a port:
by name; a law that must come before others says so by its name or by its port.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

from sim_rig.effects.effect import Effect
from sim_rig.errors import EffectError

_NOT_EFFECTS = frozenset({"effect", "units"})


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect by name, in alphabetical order."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    found = {}
    for name in names:
        if name not in _NOT_EFFECTS:
            found[name] = importlib.import_module(f"{__name__}.{name}").EFFECT
    return MappingProxyType(found)


def find_effect(name: str) -> Effect:
    """The effect called `name`; EffectError, naming those that exist, where there is none."""
    effects = catalogue()
    if name not in effects:
        raise EffectError(f"no effect is called {name!r}; there are {', '.join(effects)}.")
    return effects[name]


def effects_from_table(table: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Params by effect from `[effects.NAME]` tables. EffectError names what is not known."""
    return {name: find_effect(name).make(values) for name, values in table.items()}
