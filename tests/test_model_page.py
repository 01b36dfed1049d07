"""The generated page: readable, never stale, compiled once for all combinations."""

import importlib.util
import inspect
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sim_rig.effects import catalogue, coulomb
from sim_rig.effects.effect import Effect, Port
from sim_rig.errors import EffectError
from sim_rig.model import Model, machine_code
from sim_rig.model import engine as engine_module
from sim_rig.model.engine import Engine, build, engine
from sim_rig.model.inline import inline
from sim_rig.model.machine_code import LinkedRun, file_beside, kept, linked
from sim_rig.model.page import page_text
from sim_rig.model.skeleton import run
from tests.contract_effect import NOMINAL, simulated

COMPILER = Path(engine_module.__file__).with_name("compiler.py")


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


def test_no_combination_compiles_again(monkeypatch: pytest.MonkeyPatch) -> None:
    engine()
    monkeypatch.setattr(engine_module, "_compiled", None)
    for effect in catalogue().values():
        simulated(Model(NOMINAL).with_effect(effect.name, **effect.sample))
    assert engine.cache_info().currsize == 1


class TestMachineCode:
    """What a process left for the next one: used as it is, or not at all."""

    def kept_in(self, folder: Path) -> Path:
        """The engine's page and its machine code, copied; returns the code's file."""
        page = engine().file
        shutil.copy(page, folder)
        code = file_beside(folder / page.name, COMPILER)
        shutil.copy(page.with_name(code.name), code)
        return code

    def test_a_start_from_the_cache_compiles_nothing(self, tmp_path: Path) -> None:
        """Not even numba is imported, and the answer is that of plain Python."""
        self.kept_in(tmp_path)
        program = (
            "import sys; from pathlib import Path; from sim_rig.effects import catalogue\n"
            "from sim_rig.model.engine import build\n"
            "import numpy as np\n"
            "machine, rows = build(catalogue(), Path(sys.argv[1])), []\n"
            "for run in (machine.run, machine.plain):\n"
            "    rows.append(np.empty((3, 8)))\n"
            "    run(np.array([0.036, 2.5e-4, 0.97, 69.0, 0.026]), np.array(machine.defaults),\n"
            "        np.zeros(machine.state_size), np.array([5.0, -5.0, 5.0]), np.full(3, 4e-3),\n"
            "        np.zeros((3, 4)), 0, 5e-5, rows[-1])\n"
            "print((rows[0] == rows[1]).all(), rows[0].any(), 'numba' in sys.modules)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, str(tmp_path)],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.split() == ["True", "True", "False"]

    @pytest.mark.parametrize("place", [0, 70, 200, -1])
    def test_torn_or_changed_is_not_used(self, tmp_path: Path, place: int) -> None:
        code = self.kept_in(tmp_path)
        whole = code.read_bytes()
        assert kept(code) is not None
        for torn in (
            whole[:place],
            bytes(b ^ (1 if k == place % len(whole) else 0) for k, b in enumerate(whole)),
        ):
            code.write_bytes(torn)
            assert kept(code) is None
        code.unlink()
        assert kept(code) is None

    def test_what_does_not_link_is_not_used(self) -> None:
        made = kept(file_beside(engine().file, COMPILER))
        assert made is not None
        assert linked(made) is not None
        assert linked(made._replace(entry="another")) is None
        assert linked(made._replace(code=made.code[: len(made.code) // 2])) is None

    @pytest.mark.parametrize(
        "changed", ["numpy", "llvmlite", "numba", "processor", "setting", "our own compiler"]
    )
    def test_another_maker_or_machine_has_another_file(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
    ) -> None:
        page, compiler = tmp_path / "page_1.py", tmp_path / "compiler.py"
        compiler.write_bytes(COMPILER.read_bytes())
        before = file_beside(page, compiler)
        assert file_beside(page, compiler) == before
        if changed == "numpy":
            monkeypatch.setattr(np, "__version__", "9.9.9")
        elif changed == "llvmlite":
            monkeypatch.setattr(machine_code, "llvmlite_version", "9.9.9")
        elif changed == "numba":
            (tmp_path / "numba").mkdir()
            (tmp_path / "numba" / "__init__.py").touch()
            (tmp_path / "numba" / "_version.py").write_text("another")
            monkeypatch.delitem(sys.modules, "numba", raising=False)
            monkeypatch.syspath_prepend(tmp_path)
        elif changed == "processor":
            monkeypatch.setattr(machine_code.binding, "get_host_cpu_name", lambda: "another")
        elif changed == "setting":
            monkeypatch.setenv("NUMBA_OPT", "1")
        else:
            compiler.write_bytes(COMPILER.read_bytes() + b"# edited")
        assert file_beside(page, compiler) != before

    def test_without_it_numba_gives_the_same(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(machine_code, "linked", lambda _: None)
        text = Path(inspect.getfile(coulomb)).read_text()
        machine = build({"edited": loaded(tmp_path / "edited.py", text)}, tmp_path)
        assert not isinstance(machine.run, LinkedRun)
        plain = machine._replace(run=machine.plain)
        np.testing.assert_array_equal(angles(machine, 0.01), angles(plain, 0.01))

    def test_arrays_that_the_page_cannot_work_on_are_refused(self) -> None:
        run, good = engine().run, np.zeros((4, 4))
        read_only = np.zeros(3)
        read_only.flags.writeable = False
        for bad in (np.zeros(3, np.float32), good, read_only, np.zeros(6)[::2]):
            with pytest.raises((TypeError, ValueError, BufferError)):
                run(bad, *[np.zeros(3)] * 4, good, 0, 5e-5, good)


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
