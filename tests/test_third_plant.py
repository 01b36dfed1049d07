"""The third hand's axis by laws that it alone must obey, and by what it may import."""

import ast
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tests.third
from servo_bench.excitation.experiment import Experiment, MSequence
from servo_bench.excitation.sequences import FromRecording
from servo_bench.recording.mcap_file import load
from tests.third.asked import asked
from tests.third.commands import TURNING, runs
from tests.third.hiding import (
    BY_NAME,
    IN_THE_CATALOGUE,
    OUTSIDE_THE_CATALOGUE,
    Hidden,
    Hiding,
)
from tests.third.plant import (
    SOURCE,
    Axis,
    Link,
    NoCompilerError,
    Played,
    compiled,
    has_compiler,
    play,
)
from tests.third.recorded import Start, World, received, record, write
from tests.third.rigs import RIGS, A, B, C, D, E, F, Rig, built, rig_toml
from tests.third.told import score

pytestmark = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler")

Array = NDArray[np.float64]
PERIOD_S = 0.008
FINE_RAD = 1e-10
"""A motor's count that no velocity shows."""
SHORT = Experiment(
    name="short",
    rig="none",
    period_s=PERIOD_S,
    memory=1,
    lead_in=4,
    standstill_s=0.2,
    identification=MSequence(polynomial="23", amplitude_rad_s=6.0, bias_rad_s=0.5),
    validation=FromRecording(commands_rad_s=(3.0, -4.5, 1.5)),
)


def axis_of(rig: Rig, **values: Any) -> Axis:
    """The rig as it may be built, with these numbers."""
    return built(rig, np.random.default_rng(7))._replace(**values)


def played(axis: Axis, commands_rad_s: Array, period_s: float = PERIOD_S) -> Played:
    """Commands from the first tick on, sampled when each comes."""
    times_s: Array = period_s * np.arange(commands_rad_s.size, dtype=np.float64)
    return play(axis, times_s, commands_rad_s, times_s)


def reversing(count: int) -> Array:
    """Levels of both signs, held for some periods each."""
    return np.resize(np.repeat([2.0, -1.5, 0.5], [7, 9, 5]), count)


# --- motion ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [A, B, C, E], ids=lambda rig: rig.name)
def test_energy_goes_where_it_is_counted(rig: Rig) -> None:
    wave = {"inertia_wave_fraction": 0.1, "inertia_wave_order": 2.0}
    energy = played(axis_of(rig, gravity_nm=3e-3, **wave), reversing(150)).energy
    spent_j = energy.friction_loss_j + energy.link_loss_j + energy.stored_j
    assert energy.work_j == pytest.approx(spent_j, rel=1e-5)
    assert energy.friction_loss_j > 0.0
    assert (energy.link_loss_j > 0.0) == (rig.coupling is not None or rig.wheel is not None)


@pytest.mark.parametrize("velocity_rad_s", [2.0, -2.0, 6.0])
def test_at_a_constant_velocity_the_current_bears_the_friction(velocity_rad_s: float) -> None:
    axis = axis_of(E, detent_nm=0.0, motor_count_rad=FINE_RAD)
    current_a = played(axis, np.full(250, velocity_rad_s)).current_a[-100:].mean()
    friction_nm = math.copysign(axis.coulomb_nm, velocity_rad_s)
    friction_nm += axis.viscous_nm_s_per_rad * velocity_rad_s
    assert current_a * axis.torque_constant_nm_per_a == pytest.approx(friction_nm, rel=2e-3)


def test_stribeck_friction_is_there_at_low_speed_only() -> None:
    axis = axis_of(B, detent_nm=0.0, coulomb_nm=0.0, stribeck_nm=5e-3, stribeck_rad_s=1.0)
    for velocity_rad_s in (0.5, 4.0):
        current_a = played(axis, np.full(150, velocity_rad_s)).current_a[-50:].mean()
        expected_nm = 5e-3 * math.exp(-(velocity_rad_s**2))
        assert current_a * axis.torque_constant_nm_per_a == pytest.approx(expected_nm, abs=2e-5)


def test_a_step_is_answered_by_the_linear_loop() -> None:
    """(2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2), where ticks are too fast to matter."""
    fast = {"tick_s": 1e-5, "substeps": 1, "current_lag_s": 0.0, "motor_count_rad": FINE_RAD}
    axis = axis_of(B, coulomb_nm=0.0, detent_nm=0.0, **fast)
    per_gain = axis.torque_constant_nm_per_a / axis.inertia_kg_m2
    wn = math.sqrt(axis.integral_gain_a_per_rad * per_gain)
    zeta = 0.5 * axis.proportional_gain_a_s_per_rad * per_gain / wn
    damped, time_s = wn * math.sqrt(1.0 - zeta**2), 1e-3 * np.arange(60)
    swing = np.cos(damped * time_s) - zeta * wn / damped * np.sin(damped * time_s)
    expected_rad_s = 3.0 * (1.0 - np.exp(-zeta * wn * time_s) * swing)
    answer_rad_s = played(axis, np.full(60, 3.0), 1e-3).motor_rad_s
    assert answer_rad_s == pytest.approx(expected_rad_s, abs=5e-3)


@pytest.mark.parametrize("rig", [A, C, E], ids=lambda rig: rig.name)
def test_half_the_step_changes_little(rig: Rig) -> None:
    axis = axis_of(rig)
    coarse, fine = (
        played(axis._replace(substeps=n * axis.substeps), reversing(120)) for n in (1, 2)
    )
    change_rad = (coarse.load_rad - fine.load_rad).std()
    assert change_rad < (0.2 if rig.wheel else 0.02) * rig.load_count_rad


def test_a_load_follows_at_either_side_of_its_gap() -> None:
    axis = axis_of(A)
    twist_rad = played(axis, np.repeat([1.0, -1.0], 60))
    sides_rad = [float((twist_rad.motor_rad - twist_rad.load_rad)[k]) for k in (58, 118)]
    assert sides_rad[0] - sides_rad[1] == pytest.approx(axis.gap_rad, rel=0.02)


def test_a_coupling_twists_by_what_it_bears() -> None:
    axis = axis_of(C, load_torque_nm=20e-3)
    rest = played(axis, np.zeros(150))
    twist_rad = float(rest.motor_rad[-1] - rest.load_rad[-1])
    assert twist_rad == pytest.approx(-20e-3 / axis.stiffness_nm_per_rad, rel=1e-3)


def test_a_current_is_clamped_and_the_ticks_are_counted() -> None:
    axis = axis_of(E)
    free, held = (
        played(axis._replace(current_limit_a=a), reversing(60)) for a in (axis.current_limit_a, 1.0)
    )
    assert (free.clamped_ticks, np.abs(held.reference_a).max()) == (0, 1.0)
    assert held.clamped_ticks > 0


def test_a_loose_disc_turns_with_slow_loads_and_slips_from_fast_ones() -> None:
    slow, fast = (
        played(axis_of(B, disc_slip_rad_s2=500.0), levels * np.ones(100)) for levels in (0.1, 6.0)
    )
    assert np.abs(slow.disc_rad - slow.load_rad).max() < 1e-5
    assert np.abs(fast.disc_rad - fast.load_rad).max() > 1e-3


# --- what is hidden --------------------------------------------------------------------------


@pytest.mark.parametrize("hiding", BY_NAME.values(), ids=lambda hiding: hiding.effect)
def test_at_zero_strength_nothing_is_hidden(hiding: Hiding) -> None:
    rig = next(rig for rig in RIGS if hiding.is_for(rig))
    plain = World(axis_of(rig))
    nothing = hiding.change(plain, Hidden(hiding.effect, 0.0, "", hiding.choices[0], 0.5))
    size = hiding.drawn(rig, np.random.default_rng(1))
    rows, of_nothing, of_size = (
        record(rig, world, SHORT, 5, Start()).rows
        for world in (plain, nothing, hiding.change(plain, size))
    )
    assert np.array_equal(rows["load_angle_counts"], of_nothing["load_angle_counts"])
    assert np.array_equal(rows["motor_velocity_rad_s"], of_nothing["motor_velocity_rad_s"])
    lost = hiding.effect == "missed_samples"  # so few of so few rows
    assert lost or not np.array_equal(rows["load_angle_counts"], of_size["load_angle_counts"])


def test_where_a_command_is_lost_the_last_one_goes_on() -> None:
    commands, lost = np.arange(1.0, 7.0), np.array([True, False, True, True, False, True])
    assert received(commands, lost).tolist() == [1.0, 2.0, 2.0, 2.0, 5.0, 5.0]


def test_lost_commands_are_counted_and_change_the_motion() -> None:
    plain = World(axis_of(B))
    whole, losing = (
        record(B, plain._replace(loss_probability=share), SHORT, 3, Start()) for share in (0.0, 0.2)
    )
    assert (whole.lost, losing.lost > 0) == (0, True)
    told = (whole.rows["velocity_command_rad_s"], losing.rows["velocity_command_rad_s"])
    assert np.array_equal(*told)
    assert not np.array_equal(whole.played.motor_rad, losing.played.motor_rad)


def test_an_eccentric_disc_adds_its_sine() -> None:
    plain = World(axis_of(B))
    eccentric = plain._replace(eccentricity_rad=5e-3, eccentricity_phase_rad=0.7)
    right, wrong = (record(B, world, SHORT, 3, Start()) for world in (plain, eccentric))
    added_rad = wrong.rows["load_angle_rad"] - right.rows["load_angle_rad"]
    true_rad = right.played.load_rad
    expected_rad = 5e-3 * (np.sin(true_rad + 0.7) - math.sin(0.7))  # zeroed where it begins
    assert added_rad == pytest.approx(expected_rad, abs=1.01 * B.load_count_rad)


def test_what_every_rig_has_is_not_worth_a_name() -> None:
    """The bands of docs/diagnosis.md, and half a percent of tau of cogging 24 times a turn."""
    for rig in RIGS:
        for seed in range(20):
            axis = built(rig, np.random.default_rng(seed))
            told = rig.friction
            coulomb_nm = axis.coulomb_nm - (told.coulomb_nm if told else 0.0)
            viscous = axis.viscous_nm_s_per_rad - (told.viscous_nm_s_per_rad if told else 0.0)
            assert axis.detent_nm <= 0.005 * rig.tau_nm
            assert abs(coulomb_nm) <= 0.04 * rig.tau_nm
            assert abs(viscous) <= 0.005 * rig.tau_nm / 3.0
            assert axis.total_inertia_kg_m2 == pytest.approx(rig.inertia_kg_m2, rel=0.005)
            per_a = axis.torque_constant_nm_per_a
            assert per_a == pytest.approx(rig.torque_constant_nm_per_a, rel=0.005)
            assert abs(axis.gap_rad - rig.gap_rad) <= min(1e-3, 0.05 * rig.gap_rad)
            assert axis.current_lag_s <= 0.1e-3


# --- trials ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [D, F], ids=lambda rig: rig.name)
def test_the_same_seed_writes_the_same_bytes(rig: Rig, tmp_path: Path) -> None:
    experiment = SHORT.model_copy(update={"period_s": rig.period_s})
    for name, seed in (("one", 4), ("again", 4), ("other", 5)):
        (tmp_path / name).mkdir()
        take = record(rig, World(axis_of(rig)), experiment, seed, Start(0.1, 0.2))
        write(tmp_path / name / "id.mcap", rig, experiment, take.rows, 1_795_700_000 * 10**9)
    one, again, other = (
        (tmp_path / name / "id.mcap").read_bytes() for name in ("one", "again", "other")
    )
    assert one == again
    assert one != other
    recording = load(tmp_path / "one" / "id.mcap")
    assert len(recording) == experiment.schedule().slots
    assert recording.rig is not None
    assert recording.rig.simulated is None
    assert np.isfinite(recording["motor_torque_nm"]).all() == rig.tells_torque


def test_the_same_seed_asks_the_same_and_every_kind_comes() -> None:
    trials = [asked(seed) for seed in range(60)]
    assert trials == [asked(seed) for seed in range(60)]
    assert {trial.kind for trial in trials} == {"null", "one", "pair", "outside"}
    for trial in trials:
        groups = {BY_NAME[hidden.effect].group for hidden in trial.hidden}
        number = {"null": 0, "one": 1, "pair": 2, "outside": 1}[trial.kind]
        assert len(trial.hidden) == len(groups) == number
        assert all(BY_NAME[hidden.effect].is_for(trial.rig) for hidden in trial.hidden)
        assert len(trial.expected) == (0 if trial.kind == "outside" else number)


def test_what_repeats_with_a_shaft_is_hidden_where_it_turns() -> None:
    for hiding in IN_THE_CATALOGUE + OUTSIDE_THE_CATALOGUE:
        if hiding.phased:
            assert all(rig.name in TURNING for rig in RIGS if hiding.is_for(rig))


@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: rig.name)
def test_a_rig_keeps_its_own_limits(rig: Rig) -> None:
    for experiment in runs(rig):
        schedule = experiment.schedule()
        assert schedule.peak_velocity_rad_s <= 0.8 * rig.velocity_rad_s
    assert f'name = "{rig.name}"' in rig_toml(rig)


def test_a_verdict_is_scored_with_what_it_cannot_tell_apart() -> None:
    trial = next(t for t in map(asked, range(200)) if t.kind == "one")
    (wanted,) = trial.expected
    quantity = {wanted.parameter: {"value": wanted.value}}
    itself = {"effect": wanted.effect, "ambiguous_with": [], "parameters": quantity}
    alike = {"effect": "another", "ambiguous_with": [wanted.effect], "parameters": {}}
    wrong = {"effect": "another", "ambiguous_with": [], "parameters": {}}
    for causes, right, spurious in (
        ([itself], True, ()),
        ([alike], True, ()),
        ([itself, wrong], False, ("another",)),
        ([], False, ()),
    ):
        scored = score(trial, {"verdict": "named", "causes": causes})
        assert (scored.right, scored.spurious) == (right, spurious)
    assert score(trial, {"verdict": "named", "causes": [itself]}).sizes_right
    assert not score(trial, None).right


# --- compiled and independent ----------------------------------------------------------------


def test_both_sides_have_the_same_axis() -> None:
    text = SOURCE.read_text(encoding="utf-8")
    body = re.findall(r"typedef struct \{([^}]*)\} Axis;", text)[0]
    kinds = {"double": float, "long": int}
    there = {name: kinds[kind] for kind, name in re.findall(r"(double|long) (\w+);", body)}
    assert list(there.items()) == list(Axis.__annotations__.items())
    (links,) = re.findall(r"enum \{ (.*) \}", text)
    assert links == ", ".join(link.name for link in Link)


def test_without_a_compiler_it_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NoCompilerError, match="install one"):
        compiled(tmp_path)
    monkeypatch.setenv("CC", "false")
    with pytest.raises(NoCompilerError, match=r"refused plant\.c"):
        compiled(tmp_path)
    assert list(tmp_path.iterdir()) == []


ALLOWED = (
    *("servo_bench.recording", "servo_bench.excitation", "servo_bench.rig", "servo_bench.errors"),
    *("tests.third", "numpy"),
)
STANDARD = {
    *("argparse", "collections", "concurrent", "ctypes", "dataclasses", "enum", "functools"),
    *("hashlib", "json", "math", "os", "pathlib", "shlex", "shutil", "subprocess", "sys"),
    *("tempfile", "time", "tomllib", "types", "typing"),
}


def imported(path: Path) -> Iterator[str]:
    """Every module that a file imports; `__import__` and its like as themselves."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")
        elif isinstance(node, ast.Name) and node.id in ("__import__", "exec", "eval"):
            yield node.id


def test_it_imports_no_equation_of_another_hand() -> None:
    files = sorted(Path(tests.third.__file__).parent.glob("*.py"))
    assert {path.name for path in files} >= {"plant.py", "rigs.py", "asked.py", "recorded.py"}
    for path in files:
        for name in imported(path):
            own = any(name == one or name.startswith(f"{one}.") for one in ALLOWED)
            assert own or name.split(".")[0] in STANDARD, (path.name, name)
