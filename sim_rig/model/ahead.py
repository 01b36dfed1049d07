"""Commands that act before the clock of the samples says that they were sent.

Where the recorder's clock falls behind that of the commands, `command_delay_s` is below zero: the
sample taken "at t" is taken later, when the next command may act already. A rig on the wire knows
no next command; a schedule that is known whole is cut where each command acts,

    command k from T_k + D(T_k),  T_k its slot's start,  D < 0;  samples at every slot's end

and the page plays the pieces as slots of their own.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_rig.effects import find_effect
from sim_rig.effects.effect import Port, Signals
from sim_rig.model.state import Array

if TYPE_CHECKING:
    from sim_rig.model.model import Model


class Cut(NamedTuple):
    """A schedule in pieces: shape (pieces,), and which piece ends where each slot did."""

    commands: Array
    durations: Array
    ends: NDArray[np.intp]


def cut_ahead(model: "Model", commands: Array, durations: Array, clock_s: float) -> Cut | None:
    """The schedule, shape (slots,), cut where its commands act; None where all act in time."""
    since_s = np.concatenate([[0.0], np.cumsum(durations)])
    lead_s = -np.minimum(_delay_s(model, clock_s + since_s[:-1]), 0.0)
    if not lead_s.any():
        return None
    acts_s = np.maximum.accumulate(np.maximum(since_s[:-1] - lead_s, 0.0))
    edges_s = _whole_ns(np.sort(np.concatenate([acts_s[1:], since_s])))
    held = np.searchsorted(_whole_ns(acts_s), edges_s[:-1], side="right") - 1
    ends = np.searchsorted(edges_s, _whole_ns(since_s[1:]), side="left") - 1
    return Cut(commands[held], _whole_ns(np.diff(edges_s)), np.maximum(ends, 0))


def _delay_s(model: "Model", time_s: Array) -> Array:
    delay_s = np.zeros_like(time_s)
    for name, params in model.effects.items():
        effect = find_effect(name)
        if effect.port is Port.COMMAND_DELAY and not effect.is_off(params):
            delay_s += effect.law(Signals(time_s=time_s), params)
    return delay_s


def _whole_ns(time_s: Array) -> Array:
    """In whole nanoseconds, so that equal times are equal bits."""
    return np.asarray(np.rint(time_s * 1e9) * 1e-9)
