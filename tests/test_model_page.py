"""The generated page: readable, never stale, compiled once for all combinations."""

import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sim_rig.effects import catalogue, coulomb
from sim_rig.effects.effect import Effect, Port
from sim_rig.errors import EffectError
from sim_rig.model import Model
from sim_rig.model.engine import Engine, build, engine
from sim_rig.model.inline import inline
from sim_rig.model.page import page_text
from sim_rig.model.skeleton import run
from tests.contract_effect import NOMINAL, simulated


def loaded(file: Path, text: str) -> Effect:
    """The effect of a file with this text, as a process that starts now would see it."""
    file.write_text(text)
    sys.modules.pop(file.stem, None)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None  # noqa: PT018
    module: ModuleType = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    effect = module.EFFECT
    assert isinstance(effect, Effect)
    return effect


def angles(machine: Engine, torque_nm: float) -> np.ndarray:
    """Load angles with the page's one effect, friction, at this torque."""
    state, rows = np.zeros(machine.state_size), np.zeros((20, 8))
    levels = np.tile([5.0, -5.0], 10)
    rig = np.array([0.03606, 2.5e-4, 0.97, 69.0, 0.0])
    parameters = np.array([torque_nm, 0.5])
    machine.run(
        *(rig, parameters, state, levels, np.full(20, 0.008)), np.zeros((20, 4)), 0, 5e-5, rows
    )
    return rows[:, 3]


def test_an_edited_effect_is_seen_at_once(tmp_path: Path) -> None:
    """The trap: a cached compilation that answers with the law as it was."""
    text = Path(inspect.getfile(coulomb)).read_text()
    file = tmp_path / "edited.py"
    first = angles(build({"edited": loaded(file, text)}, tmp_path), 0.01)
    twice = text.replace("return -p.torque_nm", "return -2.0 * p.torque_nm")
    assert twice != text
    machine = build({"edited": loaded(file, twice)}, tmp_path)
    assert not np.array_equal(angles(machine, 0.01), first)
    np.testing.assert_array_equal(angles(machine, 0.005), first)
    assert len(list(tmp_path.glob("page_*.py"))) == 2
    back = build({"edited": loaded(file, text)}, tmp_path)
    np.testing.assert_array_equal(angles(back, 0.01), first)
    assert len(list(tmp_path.glob("page_*.py"))) == 2


def test_no_combination_compiles_again() -> None:
    for effect in catalogue().values():
        simulated(Model(NOMINAL).with_effect(effect.name, **effect.sample))
    compiled: Any = engine().run
    assert len(compiled.signatures) == 1


def test_the_page_without_effects_is_the_skeleton() -> None:
    """Written in plain Python both times; the skeleton itself runs."""
    state, rows = np.zeros(16 + 128), np.zeros((3, 8))
    rig = np.array([0.03606, 2.5e-4, 0.97, 69.0, 0.026])
    levels, durations, given = np.array([5.0, -5.0, 5.0]), np.full(3, 0.004), np.zeros((3, 4))
    run(rig, np.zeros(0), state, levels, durations, given, 0, 5e-5, rows)
    ideal = Model(NOMINAL.__class__(0.03606, 2.5e-4, 0.97, 69.0, 0.026)).simulate(levels, durations)
    np.testing.assert_array_equal(rows[:-1, 3], ideal.load_angle_rad[1:])


def test_every_effect_stands_on_the_page_with_its_name() -> None:
    text = page_text(catalogue())
    for effect in catalogue().values():
        assert f"  # {effect.summary}\n" in text


class TestWhatCannotBeWrittenIn:
    """Laws that are more than a row of assignments are refused when the page is made."""

    def effect(self, law: Any) -> Effect:
        return Effect(Port.MOTOR_TORQUE, coulomb.Params, law, "", (), "")

    def test_branches(self) -> None:
        def law(s: Any, p: Any) -> Any:
            if s.motor_velocity_rad_s > 0.0:
                return p.torque_nm
            return 0.0

        with pytest.raises(EffectError, match="only assignments"):
            inline(self.effect(law), law)

    def test_unknown_signals(self) -> None:
        def law(s: Any, p: Any) -> Any:
            return p.torque_nm * s.temperature_k

        with pytest.raises(EffectError, match=r"s\.temperature_k"):
            inline(self.effect(law), law)

    def test_other_functions(self) -> None:
        def law(s: Any, p: Any) -> Any:
            return p.torque_nm * np.interp(s.time_s, [0.0], [1.0])

        with pytest.raises(EffectError, match="cannot be written"):
            inline(self.effect(law), law)
