"""What every effect's file must answer; `check_effect` asks one after another.

1 its parameters end in their units          5 arrays give what scalars give
2 strengths come first and are off           6 the law is closed over its arguments, and fits
3 every parameter has a prior                  the page
4 zero changes nothing, to the last bit      7 its docstring begins with name and equation

Beyond the seven: its sample is seen, the compiled page and plain Python agree to the last bit,
and looking twice changes nothing.
"""

import math
from typing import Any

import numpy as np

from sim_rig.effects import catalogue
from sim_rig.effects.effect import Effect, Port, Signals
from sim_rig.effects.units import SUFFIXES
from sim_rig.model import Model, Simulated
from sim_rig.model.engine import Engine, engine
from sim_rig.model.inline import inline
from sim_rig.model.running import flat_parameters, rig_array
from sim_rig.settings import Nominal

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, math.radians(1.5))
COMMANDS_RAD_S = np.random.default_rng(3).choice([-8.0, 0.0, 3.0, 8.0], 60)
PERIOD_S = 0.008
SAMPLES = 7


def check_effect(effect: Effect) -> None:
    """Ask everything of one effect."""
    names_end_in_units(effect)
    strengths_come_first_and_are_off(effect)
    priors_are_given(effect)
    zero_changes_nothing(effect)
    arrays_give_what_scalars_give(effect)
    fits_the_page(effect)
    docstring_begins_with_name_and_equation(effect)
    sample_is_seen(effect)
    compiled_is_plain(effect)
    looking_twice_changes_nothing(effect)


def names_end_in_units(effect: Effect) -> None:
    for parameter in effect.parameters:
        assert parameter.name.endswith(SUFFIXES), f"{parameter.name}: no unit that is known"


def strengths_come_first_and_are_off(effect: Effect) -> None:
    fields = effect.params._fields
    assert fields[: len(effect.strengths)] == effect.strengths
    assert effect.is_off(effect.params())


def priors_are_given(effect: Effect) -> None:
    effect.check(effect.params())
    effect.check(effect.make(effect.sample))
    for parameter in effect.parameters:
        assert parameter.prior.low < parameter.prior.high, parameter
        if parameter.name in effect.strengths:
            assert parameter.prior.objection(0.0) is None, f"{parameter.name} may not be zero"
            for value in (parameter.prior.low, parameter.prior.high):
                assert math.isfinite(value), f"{parameter.name}: its prior has no end"
                assert parameter.prior.objection(value) is None, parameter


def zero_changes_nothing(effect: Effect) -> None:
    off = dict.fromkeys(effect.strengths, 0.0)
    with_zero = Model(NOMINAL).with_effect(effect.name, **{**effect.sample, **off})
    assert simulated(with_zero)[:-1] == _Equal(simulated(Model(NOMINAL))[:-1])


def arrays_give_what_scalars_give(effect: Effect) -> None:
    rng = np.random.default_rng(5)
    params = effect.make(effect.sample)
    signals = _signals(rng)
    rest = [] if effect.memory is None else [_memory(effect, rng)]
    whole = np.array(_values(effect.law(signals, *rest, params)))
    for k in range(SAMPLES):
        one = [type(group)(*(float(values[k]) for values in group)) for group in rest]
        each = np.array(_values(effect.law(_at(signals, k), *one, params)))
        np.testing.assert_allclose(_at_sample(whole, k), each, rtol=1e-12, atol=1e-15)


def fits_the_page(effect: Effect) -> None:
    inline(effect, effect.law)
    assert (effect.memory is None) == (effect.advance is None)
    if effect.advance is not None:
        inline(effect, effect.advance)
    other = set(effect.law.__code__.co_names) & {"random", "time", "os"}
    assert not other, f"the law reads more than its arguments: {other}"


def docstring_begins_with_name_and_equation(effect: Effect) -> None:
    name, colon, rest = effect.summary.partition(":")
    assert name, effect.summary
    assert colon, effect.summary
    assert rest.endswith("."), effect.summary
    assert "=" in effect.equation or "<-" in effect.equation, effect.equation
    assert all((effect.shows, effect.source, effect.confused_with))
    assert effect.name not in effect.confused_with


def sample_is_seen(effect: Effect) -> None:
    sampled, ideal = simulated(_sample(effect)), simulated(_ideal(effect))
    seen = max(
        float(np.abs(sampled.load_angle_rad - ideal.load_angle_rad).max()),
        float(np.abs(sampled.motor_angle_rad - ideal.motor_angle_rad).max()),
        float(np.abs(sampled.motor_current_a - ideal.motor_current_a).max()) * 1e-3,
    )
    assert seen > 1e-6, f"its sample changes nothing: {seen}"


def compiled_is_plain(effect: Effect) -> None:
    machine, model = engine(), _sample(effect)
    compiled, plain = _page(machine, model, machine.run), _page(machine, model, machine.plain)
    np.testing.assert_array_equal(compiled, plain)


def looking_twice_changes_nothing(effect: Effect) -> None:
    if effect.memory is None or effect.advance is None or effect.port is Port.SLOT_COMMAND:
        return
    rng = np.random.default_rng(7)
    params = effect.make(effect.sample)
    look = _at(_signals(rng), 0)._replace(step_s=0.0, since_s=0.0)
    once = effect.advance(look, effect.memory(), params, 0.0)
    twice = effect.advance(look, once, params, 0.0)
    np.testing.assert_allclose(np.array(twice), np.array(once), rtol=1e-15)


def simulated(model: Model) -> Simulated:
    """Sixty slots of several levels from rest."""
    return model.simulate(COMMANDS_RAD_S, PERIOD_S)


def _ideal(effect: Effect) -> Model:
    """Without the effect, but with what it shows beside."""
    return Model.from_table(NOMINAL, effect.beside)


def _sample(effect: Effect) -> Model:
    return _ideal(effect).with_effect(effect.name, **effect.sample)


class _Equal:
    """Equal to a row of arrays that has the same bits."""

    def __init__(self, arrays: Any) -> None:
        self._arrays = arrays

    def __eq__(self, other: object) -> bool:
        assert isinstance(other, tuple)
        return all(np.array_equal(a, b) for a, b in zip(self._arrays, other, strict=True))

    __hash__ = None  # type: ignore[assignment]


def _signals(rng: np.random.Generator) -> Signals:
    drawn = {name: rng.normal(0.0, 1.0, SAMPLES) for name in Signals._fields}
    fixed = {
        **{"step_s": 50e-6, "since_s": 50e-6, "slot_duration_s": 0.008},
        **{"torque_constant_nm_per_a": 0.036, "proportional_gain_a_s_per_rad": 0.97},
        **{"integral_gain_a_per_rad": 69.0, "nominal_inertia_kg_m2": 2.5e-4},
        **{"inertia_kg_m2": 2.5e-4, "nominal_gap_rad": 0.03},
    }
    drawn |= {name: np.full(SAMPLES, value) for name, value in fixed.items()}
    drawn |= {name: np.abs(drawn[name]) for name in ("time_s", "command_delay_s")}
    drawn["slot"] = np.arange(SAMPLES, dtype=np.float64)
    return Signals(**drawn)


def _memory(effect: Effect, rng: np.random.Generator) -> Any:
    assert effect.memory is not None
    return effect.memory(*(rng.uniform(-0.9, 0.9, SAMPLES) for _ in effect.memory._fields))


def _at(signals: Signals, k: int) -> Signals:
    return Signals(*(float(values[k]) for values in signals))


def _values(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _at_sample(whole: Any, k: int) -> Any:
    constant = whole.shape == () or whole.shape[-1] != SAMPLES
    return whole if constant else whole[..., k]


def _page(machine: Engine, model: Model, run: Any) -> Any:
    """A few short slots on the page, whichever way it is run."""
    slots = 8
    values = np.array(model.at_rest().values)
    rows = np.zeros((slots, 8))
    run(
        *(rig_array(model), flat_parameters(model, machine), values),
        *(COMMANDS_RAD_S[:slots], np.full(slots, 0.003), np.zeros((slots, 4)), 0, 50e-6, rows),
    )
    return np.concatenate((values, rows.ravel()))


ALL = tuple(catalogue().values())
