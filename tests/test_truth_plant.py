"""The grown truth plant as a whole: zero is off, strength shows, steps halve, energy goes."""

import ast
import itertools
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import truth
from tests.truth.catalogue import (
    AMBIGUITIES,
    BY_NAME,
    IN_THE_CATALOGUE,
    OUTSIDE_THE_CATALOGUE,
    Ambiguity,
    Hiding,
    Scale,
    same_as,
)
from tests.truth.compiling import fingerprint
from tests.truth.effects import NONE, Effects
from tests.truth.nuisances import QUIET, Nuisances, scattered
from tests.truth.plant import Played, TruthPlant, hidden, make
from tests.truth.rigs import PAPER, drawn
from tests.truth.stepping import LAWS
from tests.truth.toy_plant import hidden as toy
from tests.truth.trying import (
    LOOP_S,
    PERIOD_S,
    VELOCITY_RAD_S,
    J,
    quiet,
    random_commands,
)

ALL = IN_THE_CATALOGUE + OUTSIDE_THE_CATALOGUE
SCALE = Scale(PAPER, VELOCITY_RAD_S)
CHANNELS = ("motor_position_rad", "motor_velocity_rad_s", "motor_current_a", "load_angle_rad")
BIASED = random_commands(2000) + 0.2 * VELOCITY_RAD_S

WANTED = set(
    """
coulomb_friction viscous_friction stribeck presliding asymmetric_friction load_dependent_friction
position_dependent_friction cogging torque_ripple torque_constant_error torque_constant_droop
current_limit current_lag velocity_filter transport_delay command_slew command_deadband
command_scale command_offset integrator_clamp anti_windup backlash_width
position_dependent_backlash contact_stiffness contact_damping coupling_compliance gravity
load_torque encoder_eccentricity encoder_subdivision encoder_quantisation misalignment
friction_drift torque_constant_drift clock_skew missed_samples inertia_error inverter_dead_time
""".split()  # noqa: SIM905 (a list would be a screen long)
)


def extras(hiding: Hiding, last: int = 0) -> dict[str, float]:
    """Phases and choices, as if drawn."""
    return dict.fromkeys(hiding.phases, 1.0) | {
        name: values[last] for name, values in hiding.choices.items()
    }


def effects_at(hiding: Hiding, size: float) -> Effects:
    """This effect at a size."""
    return NONE._replace(**hiding.fields(size, SCALE, extras(hiding)))


def differ(one: Played, other: Played) -> bool:
    return any(not np.array_equal(getattr(one, c), getattr(other, c)) for c in CHANNELS)


def rms(one: Played, other: Played, channel: str) -> float:
    return float(np.sqrt(np.mean((getattr(one, channel) - getattr(other, channel)) ** 2)))


def halved(nuisances: Nuisances, times: int = 2) -> Nuisances:
    """The same axis at a finer step."""
    return nuisances._replace(
        substeps=times * nuisances.substeps, loop_phase=times * nuisances.loop_phase
    )


# --- the table -------------------------------------------------------------------------------


def test_the_catalogue_is_all_there_and_more() -> None:
    names = [hiding.name for hiding in ALL]
    assert len(set(names)) == len(names)
    assert {h.name for h in IN_THE_CATALOGUE} >= WANTED
    assert len(OUTSIDE_THE_CATALOGUE) >= 10


def test_every_strength_belongs_to_one_effect() -> None:
    strengths = [hiding.strength for hiding in ALL]
    assert len(set(strengths)) == len(strengths)
    assert set(strengths) == {name for name, off in NONE._asdict().items() if off == 0.0} - {
        name for hiding in ALL for name in hiding.phases
    }


def test_what_the_table_names_exists() -> None:
    for hiding in ALL:
        assert {hiding.strength, *hiding.phases, *hiding.choices} <= set(Effects._fields)
        assert {*hiding.also, *hiding.resembles} <= {h.name for h in IN_THE_CATALOGUE}
        assert 0.0 < hiding.low < hiding.high
    for ambiguity in AMBIGUITIES:
        assert ambiguity.names <= set(BY_NAME)
    assert same_as("inertia_error") == {"inertia_error", "torque_constant_error"}
    assert same_as("cogging") == {"cogging"}


def test_what_the_command_sizes_is_sized_by_it() -> None:
    peak_a = 2.0 * VELOCITY_RAD_S * PAPER.proportional_gain_a_s_per_rad
    limit, slew, droop, dead = (
        effects_at(BY_NAME[name], size)
        for name, size in (
            ("current_limit", 2.0),
            ("command_slew", 4e-3),
            ("torque_constant_droop", 0.2),
            ("command_deadband", 0.1),
        )
    )
    assert 1.0 / limit.current_limit_per_a == pytest.approx(peak_a / 2.0)
    assert 2.0 * VELOCITY_RAD_S * slew.command_slew_s2_per_rad == pytest.approx(4e-3)
    assert droop.torque_constant_droop_per_a2 * peak_a**2 == pytest.approx(0.2)
    assert dead.command_deadband_rad_s == pytest.approx(0.1 * VELOCITY_RAD_S)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_stays_friction(sign: float) -> None:
    """Whatever swings or differs stays within the Coulomb friction that stands beside it."""
    for name in ("asymmetric_friction", "position_dependent_friction"):
        effects = effects_at(BY_NAME[name], sign * BY_NAME[name].high)
        assert effects.coulomb_nm >= 2.0 * abs(effects.friction_asymmetry_nm)
        assert effects.coulomb_nm >= 2.0 * abs(effects.friction_swing_nm)


# --- zero and strength -----------------------------------------------------------------------

SHORT = random_commands(150, seed=3)


@pytest.fixture(scope="module")
def nothing_hidden() -> Played:
    return TruthPlant(PAPER, 4).play(SHORT, PERIOD_S)


@pytest.mark.parametrize("hiding", ALL, ids=lambda hiding: hiding.name)
def test_zero_strength_changes_nothing_whatever_its_phases(
    hiding: Hiding, nothing_hidden: Played
) -> None:
    assert hiding.fields(0.0, SCALE, extras(hiding)) == {}
    for last in (0, -1):
        idle = NONE._replace(**extras(hiding, last))
        assert not differ(TruthPlant(PAPER, 4, idle).play(SHORT, PERIOD_S), nothing_hidden)


@pytest.fixture(scope="module")
def null_biased() -> Played:
    return TruthPlant(PAPER, 1).play(BIASED, PERIOD_S)


@pytest.mark.parametrize("hiding", ALL, ids=lambda hiding: hiding.name)
def test_more_strength_shows_more_and_far_above_the_integrators_error(
    hiding: Hiding, null_biased: Played
) -> None:
    nuisances = scattered(1)
    strong = effects_at(hiding, hiding.high)
    played = TruthPlant(PAPER, 1, strong, nuisances).play(BIASED, PERIOD_S)
    finer = TruthPlant(PAPER, 1, strong, halved(nuisances)).play(BIASED, PERIOD_S)
    shown = rms(played, null_biased, "load_angle_rad")
    assert np.isfinite(played.load_angle_rad).all()
    assert shown > 50e-6
    assert rms(played, finer, "load_angle_rad") < shown / 10
    if not hiding.name.startswith(("command_resampling", "missed", "current_limit", "slip")):
        weak = TruthPlant(PAPER, 1, effects_at(hiding, hiding.low), nuisances)
        assert rms(weak.play(BIASED, PERIOD_S), null_biased, "load_angle_rad") < 1.02 * shown


LOOK_ALIKES = {
    "inertia_error": ({"inertia_error": 1 / 1.1 - 1.0}, {"torque_constant_error": 0.1}),
    "asymmetric_friction": (
        {"coulomb_nm": 10e-3, "friction_asymmetry_nm": 3e-3},
        {"coulomb_nm": 10e-3, "load_torque_nm": 3e-3},
    ),
    "command_deadband": (
        {"command_deadband_rad_s": 0.1 * VELOCITY_RAD_S},
        {"command_scale_error": -0.1},
    ),
}


@pytest.mark.parametrize("ambiguity", AMBIGUITIES, ids=lambda a: " ".join(sorted(a.names)))
def test_what_is_called_the_same_looks_the_same_to_the_motor(ambiguity: Ambiguity) -> None:
    (name,) = ambiguity.names & set(LOOK_ALIKES)
    turning = np.full(500, VELOCITY_RAD_S)  # friction and load are alike only while it moves
    commands = turning if name == "asymmetric_friction" else random_commands(500)
    none, one, other = (quiet(**s).play(commands, PERIOD_S) for s in ({}, *LOOK_ALIKES[name]))
    for channel in ("motor_velocity_rad_s", "motor_current_a"):
        a, b, c = (getattr(played, channel)[100:] for played in (none, one, other))
        effect, difference = (float(np.sqrt(np.mean((b - x) ** 2))) for x in (a, c))
        assert difference < max(0.1 * effect, 0.02)  # or an eighth of a count, by the gain


# --- the Plant protocol ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "strengths",
    [
        {},
        {"transport_delay_s": 5e-3, "clock_skew": 1e-4, "command_jitter_s": 1e-3},
        {"missed_probability": 0.1, "bit_errors_per_s": 5.0, "quantum_rad": 1e-3},
        {"creep_rad_per_nm": 0.1, "vibration_rad": 1e-3, "command_resampling_s": 3e-3},
    ],
    ids=lambda strengths: " ".join(strengths) or "nothing",
)
def test_a_whole_schedule_is_its_slots_one_by_one(strengths: dict[str, float]) -> None:
    commands = random_commands(200)
    whole = hidden(**strengths)(PAPER, 5).play(commands, PERIOD_S)
    plant, load, current = hidden(**strengths)(PAPER, 5), [], []
    for command in commands.tolist():
        outputs = plant.outputs()
        assert plant.outputs() == outputs
        load.append(outputs.load_angle_rad)
        current.append(outputs.motor_current_a)
        plant.advance(command, PERIOD_S)
    assert load == pytest.approx(whole.load_angle_rad, abs=1e-9)
    assert current == pytest.approx(whole.motor_current_a, abs=1e-9)


def test_how_time_is_cut_does_not_matter() -> None:
    whole, cut = make(PAPER, 1), make(PAPER, 1)
    for command in random_commands(20).tolist():
        whole.advance(command, PERIOD_S)
        for part in (0.1, 0.37, 0.33, 0.2):
            cut.advance(command, part * PERIOD_S)
    assert cut.outputs().load_angle_rad == pytest.approx(whole.outputs().load_angle_rad, abs=1e-12)


def test_the_seed_decides() -> None:
    first, again, other = (TruthPlant(PAPER, seed).play(SHORT, PERIOD_S) for seed in (1, 1, 2))
    assert not differ(first, again)
    assert first.load_angle_rad[0] != other.load_angle_rad[0]


def test_nuisances_differ_from_rig_to_rig_and_stay_below_every_effect() -> None:
    rigs = [scattered(seed) for seed in range(50)]
    assert len(set(rigs)) == 50
    for rig in rigs:
        assert rig.motor_friction_nm + rig.load_friction_nm < BY_NAME["coulomb_friction"].low
        assert rig.detent_nm + rig.bearing_nm < BY_NAME["cogging"].low
        assert abs(rig.torque_constant_error) < BY_NAME["torque_constant_error"].low
        assert abs(rig.inertia_error) < BY_NAME["inertia_error"].low
        assert rig.motor_viscous_nm_s_per_rad < BY_NAME["viscous_friction"].low
        assert rig.current_lag_s < BY_NAME["current_lag"].low


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_answers_as_the_loop_is_tuned(seed: int) -> None:
    """Against G(s) of the nominal values in closed form; lags and nuisances take a few percent."""
    rig = drawn(seed)
    per_inertia = rig.torque_constant_nm_per_a / rig.inertia_kg_m2
    wn = math.sqrt(rig.integral_gain_a_per_rad * per_inertia)
    zeta = rig.proportional_gain_a_s_per_rad * per_inertia / (2.0 * wn)
    seen = TruthPlant(rig, seed).play(np.full(2000, 5.0), LOOP_S).motor_velocity_rad_s
    time_s = LOOP_S * np.arange(2000)
    sigma, wd = zeta * wn, wn * math.sqrt(1.0 - zeta**2)
    wave = np.cos(wd * time_s) - sigma / wd * np.sin(wd * time_s)
    expected = 5.0 * (1.0 - np.exp(-sigma * time_s) * wave)
    assert np.abs(seen - expected).max() < 0.05 * 5.0


def test_friction_holds_a_resting_axis() -> None:
    nuisances = Nuisances()._replace(torque_noise_nm=0.0, bearing_nm=0.0, detent_nm=0.0)
    plant = TruthPlant(PAPER, 1, NONE, nuisances)
    before = plant.outputs()
    plant.advance(0.0, 0.5)
    assert plant.outputs() == before


# --- numerics --------------------------------------------------------------------------------


def test_halving_the_step_hardly_moves_anything_and_less_each_time() -> None:
    nuisances = scattered(1)
    played = [
        TruthPlant(PAPER, 1, NONE, halved(nuisances, times)).play(BIASED, PERIOD_S)
        for times in (1, 2, 4)
    ]
    first, second = (rms(a, b, "load_angle_rad") for a, b in itertools.pairwise(played))
    assert first < 8e-6
    assert second < first / 2
    assert rms(played[0], played[1], "motor_position_rad") < 1e-6
    assert np.abs(played[0].load_angle_rad - played[1].load_angle_rad).max() < 1e-4


def test_two_inertias_on_a_spring_converge_with_the_square_of_the_step() -> None:
    """Linear, the power stage off: nothing but the integrator is left."""
    effects = NONE._replace(coupling_compliance_rad_per_nm=1 / 50.0)
    ends = []
    for times in (1, 2, 4):
        plant = TruthPlant(PAPER, 1, effects, QUIET._replace(start_in_gap=0.0))
        plant.advance(5.0, 4 * LOOP_S)
        plant.advance(None, 2e-3)  # the current is gone; from here on at another step
        finer = TruthPlant(PAPER, 1, effects, halved(QUIET, times))
        finer.put(plant.state._replace(step=0))
        finer.advance(None, 0.004)
        ends.append(finer.state.rotor.rad)
    errors = np.abs(np.diff(ends))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(
    "strengths",
    [
        {},
        {"load_inertia_kg_m2": 2e-5},
        {"coupling_compliance_rad_per_nm": 1 / 100.0, "load_inertia_kg_m2": 1e-5},
        {"gravity_nm": 20e-3, "load_inertia_kg_m2": 1e-5},
        {"load_torque_nm": 10e-3, "load_inertia_kg_m2": 1e-5},
        {"contact_damping_s_per_rad": 5.0, "contact_softness_rad15_per_nm": 5e-3},
        {"air_drag_nm_s2_per_rad2": 1e-3, "stribeck_nm": 5e-3, "backlash_error_rad": 5e-3},
    ],
    ids=lambda strengths: " ".join(strengths) or "nothing",
)
@pytest.mark.parametrize("reversed_for_s", [0.012, 0.020])
def test_coasting_never_gains_energy(strengths: dict[str, float], reversed_for_s: float) -> None:
    nuisances = Nuisances()._replace(bearing_nm=0.0, detent_nm=0.0)
    plant = TruthPlant(PAPER, 1, NONE._replace(**strengths), nuisances)
    plant.advance(5.0, 0.3)
    plant.advance(-5.0, reversed_for_s)
    plant.advance(None, 20 * nuisances.current_lag_s)
    energies_j = []
    for _ in range(1600):
        energies_j.append(plant.energy_j())
        plant.advance(None, nuisances.step_s)
    kinetic_j = 0.5 * J * 25.0
    # What a symplectic step swings by, at the stiffest contact.
    assert np.diff(energies_j).max() <= 1e-4 * kinetic_j
    assert np.diff(energies_j[::40]).max() <= 1e-6 * kinetic_j
    assert energies_j[-1] < energies_j[0]


def test_two_hands_of_the_same_school_agree_where_nothing_is_hidden() -> None:
    """The toy plant is another code: same laws, at its own loop's rate and its own step."""
    commands = random_commands(400)
    values = {
        "loop_period_s": LOOP_S,
        "substeps": 5,
        "torque_noise_nm": 0.0,
        "contact_stiffness_nm_per_rad15": 4000.0,
        "contact_damping_s_per_rad": 0.3,
    }
    small = toy(**values)(PAPER, 1)
    load = []
    for command in commands.tolist():
        load.append(small.outputs().load_angle_rad)
        small.advance(command, PERIOD_S)
    nuisances = Nuisances()._replace(torque_noise_nm=0.0, bearing_nm=0.0, detent_nm=0.0)
    rest = load[0] / (PAPER.backlash_gap_rad / 2)
    grown = TruthPlant(PAPER, 1, NONE, nuisances._replace(start_in_gap=rest))
    difference = grown.play(commands, PERIOD_S).load_angle_rad - np.array(load)
    assert np.sqrt(np.mean(difference**2)) < 10e-6


# --- compiled --------------------------------------------------------------------------------

PLAIN = """
import numpy as np
from tests.truth.effects import NONE
from tests.truth.plant import TruthPlant
from tests.truth.rigs import PAPER
from tests.truth.trying import PERIOD_S, random_commands
import tests.test_truth_plant as here
played = TruthPlant(PAPER, 4, here.MANY).play(random_commands(12), PERIOD_S)
print(repr(played.load_angle_rad.tolist()), repr(played.motor_current_a.tolist()), sep="\\n")
"""

MANY = NONE._replace(
    coulomb_nm=5e-3,
    presliding_rad=1e-4,
    cogging_nm=3e-3,
    torque_ripple=0.03,
    current_limit_per_a=1.0,
    anti_windup_per_s=200.0,
    dead_time_v=0.5,
    velocity_filter_s=0.5e-3,
    notch_depth=0.5,
    command_slew_s2_per_rad=1 / 2000.0,
    backlash_swing_rad=2e-3,
    coupling_compliance_rad_per_nm=1 / 200.0,
    slip_per_nm=1 / 30e-3,
    load_inertia_kg_m2=1e-5,
    load_friction_nm=5e-3,
    gravity_nm=5e-3,
    creep_rad_per_nm=0.1,
    hysteresis_brake_nm=3e-3,
    friction_drift=0.3,
    torque_constant_drift=0.05,
)


def test_compiled_and_plain_python_give_the_same() -> None:
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", PLAIN],
        cwd=Path(truth.__file__).parents[2],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    load, current = (ast.literal_eval(line) for line in done.stdout.splitlines())
    compiled = TruthPlant(PAPER, 4, MANY).play(random_commands(12), PERIOD_S)
    assert load == pytest.approx(compiled.load_angle_rad, abs=1e-12)
    assert current == pytest.approx(compiled.motor_current_a, abs=1e-10)


def test_another_text_has_another_fingerprint(tmp_path: Path) -> None:
    file = tmp_path / "law.py"
    file.write_text("a = 1\n")
    before = fingerprint([file])
    assert fingerprint([file]) == before > 0
    file.write_text("a = 2\n")
    assert fingerprint([file]) != before


EDITED = """
from pathlib import Path
from tests.truth.compiling import fingerprint, kernel
from inner import inside
def build(files_fingerprint):
    @kernel
    def outer(x):
        return inside(x) + 0 * files_fingerprint
    return outer
outer = build(fingerprint([Path(__file__).parent / "inner.py"]))
"""

INNER = """
from tests.truth.compiling import law
@law
def inside(x):
    return {factor} * x
"""


@pytest.mark.long
def test_the_disk_cache_never_answers_for_an_edited_law(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(EDITED)
    paths = [str(tmp_path), str(Path(truth.__file__).parents[2])]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    say = "import outer; print(outer.outer(1.0), sum(outer.outer.stats.cache_hits.values()))"
    answers = []
    for factor in (2.0, 2.0, 3.0):
        (tmp_path / "inner.py").write_text(INNER.format(factor=factor))
        done = subprocess.run(
            [sys.executable, "-B", "-c", say],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        answers.append(done.stdout.split())
    assert answers == [["2.0", "0"], ["2.0", "1"], ["3.0", "0"]]


def test_the_fingerprint_covers_every_law() -> None:
    folder = Path(truth.__file__).parent
    reached, todo = set(), ["stepping.py"]
    while todo:
        name = todo.pop()
        reached.add(name)
        for node in ast.walk(ast.parse((folder / name).read_text(encoding="utf-8"))):
            module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
            file = f"{module.removeprefix('tests.truth.')}.py"
            if module.startswith("tests.truth.") and file not in reached:
                todo.append(file)
    assert reached - {"compiling.py"} == set(LAWS)


def test_a_long_schedule_needs_no_more_than_its_edges() -> None:
    plant = TruthPlant(replace(PAPER, backlash_gap_rad=math.radians(0.72)), 3)
    for command in random_commands(50).tolist():
        plant.advance(command, PERIOD_S)
    assert plant.waiting <= 1
