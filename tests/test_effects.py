"""Every effect of the catalogue answers the contract's questions; what is not one is refused."""

import math
from pathlib import Path

import pytest

import sim_rig.effects
from sim_rig.effects import catalogue, effects_from_table, find_effect
from sim_rig.effects.effect import Effect
from sim_rig.errors import EffectError
from tests.contract_effect import ALL, check_effect


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_the_contract(effect: Effect) -> None:
    check_effect(effect)


def test_every_file_is_in_the_catalogue() -> None:
    files = {path.stem for path in Path(sim_rig.effects.__file__).parent.glob("*.py")}
    assert files - set(catalogue()) == {"__init__", "effect", "units"}
    assert all(name == effect.name for name, effect in catalogue().items())


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"friction": {}}, ("no effect is called 'friction'", "coulomb")),
        ({"coulomb": {"torque": 1.0}}, ("no parameter 'torque'", "torque_nm")),
        ({"coulomb": {"torque_nm": -1.0}}, ("torque_nm = -1.0", "at least 0", "0.0001")),
        ({"coulomb": {"torque_nm": math.nan}}, ("torque_nm = nan", "finite")),
        ({"coulomb": {"transition_rad_s": 0.0}}, ("transition_rad_s = 0.0", "above 0")),
        ({"inertia_error": {"error_fraction": -1.0}}, ("error_fraction = -1.0", "-0.99")),
        ({"coulomb": {"torque_nm": "much"}}, ("'much'", "must be a number")),
        ({"coulomb": {"torque_nm": True}}, ("True", "must be a number")),
    ],
)
def test_what_is_not_an_effect_is_refused(
    table: dict[str, dict[str, float]], words: tuple[str, ...]
) -> None:
    with pytest.raises(EffectError) as refused:
        effects_from_table(table)
    assert all(word in str(refused.value) for word in words), refused.value


def test_an_effect_prints_its_equation() -> None:
    assert find_effect("coulomb").equation.strip() == "tau = -T tanh(omega / omega_0)"
