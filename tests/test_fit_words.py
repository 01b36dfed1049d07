"""What a fit refuses, and how a search that failed says so; names, units, files."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.diagnosis.fitting.fit import fit
from servo_bench.diagnosis.fitting.free import UNITS, free_parameters, unit_of
from servo_bench.diagnosis.fitting.model_file import load_model, model_text
from servo_bench.errors import ConfigError, FitError
from servo_bench.files import find
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.recording import Recording
from sim_rig.effects import catalogue
from sim_rig.effects.units import SUFFIXES
from sim_rig.model import Model
from tests import fit_recordings as made

MODEL = Model(made.NOMINAL)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mass", "Choose from K_T, J, K_P, K_I, gap"),
        ("friction.torque_nm", "no effect is called 'friction'; there are"),
        ("coulomb.torque", "coulomb has no parameter 'torque': it has torque_nm"),
        ("cogging.phase_rad", "changes nothing while cogging is off: free one of"),
        ("missed_samples.draw_seed", "no quantity with a usual range"),
    ],
)
def test_a_name_that_cannot_be_free(name: str, says: str) -> None:
    with pytest.raises((ConfigError, FitError)) as caught:
        fit(made.recorded(MODEL, 1), MODEL, (name,))
    assert says in str(caught.value)


@pytest.mark.parametrize("names", [(), ("J", "inertia_kg_m2")])
def test_nothing_free_or_one_number_twice(names: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError):
        free_parameters(MODEL, names)


def test_every_quantity_of_the_catalogue_can_be_free() -> None:
    for effect in catalogue().values():
        model = MODEL.with_effect(effect.name, **effect.sample)
        for parameter in effect.parameters:
            if not math.isfinite(parameter.prior.high) or parameter.name.endswith("seed"):
                continue
            (free,) = free_parameters(model, (f"{effect.name}.{parameter.name}",))
            assert free.spread > 0.0
            assert free.low <= free.of(model) <= free.high
            assert free.of(free.put(model, free.of(model))) == free.of(model)
            assert math.isfinite(free.surprise(free.of(model)))


def test_every_unit_of_the_catalogue_has_its_words() -> None:
    assert {suffix for suffix in SUFFIXES if suffix.startswith("_")} <= set(UNITS)
    assert unit_of("damping_nm_s_per_rad") == "N m s/rad"
    assert unit_of("limit_per_a") == "1/A"
    assert unit_of("error_fraction") == "1"


def test_a_recording_that_is_too_short() -> None:
    with pytest.raises(FitError, match=r"is too short: [0-9]+ points to fit"):
        fit(made.rows(made.recorded(MODEL, 1), np.arange(110)), MODEL, ("J",))


def test_a_recording_in_which_nothing_moves() -> None:
    recording = made.recorded(MODEL, 1)
    still = np.random.default_rng(0).normal(0.0, 1e-4, (2, len(recording)))
    frozen = made.with_channels(
        recording,
        velocity_command_rad_s=np.zeros(len(recording)),
        load_angle_rad=still[0],
        motor_position_rad=still[1],
        motor_torque_nm=np.zeros(len(recording)),
    )
    with pytest.raises(FitError, match="nothing moves in this recording"):
        fit(frozen, MODEL, ("J",))


def test_a_short_cut_of_a_motion_without_rest_is_not_said_to_stand_still() -> None:
    """A sensor's noise is then told from its third difference, in which a quick motion is too."""
    recording = made.recorded(MODEL, 1)
    way = np.random.default_rng(0).normal(0.0, 0.1, len(recording))
    moving = made.with_channels(recording, load_angle_rad=way, motor_position_rad=way)
    moving = made.with_channels(moving, phase=np.maximum(moving["phase"], 2))
    with pytest.raises(FitError, match="nothing rests in it"):
        fit(moving, MODEL, ("J",))


def test_channels_that_allow_no_block() -> None:
    recording = made.recorded(MODEL, 1)
    bare = {k: v for k, v in recording.channels.items() if k not in made.RUN}
    with pytest.raises(FitError, match="no block of the rig can be fitted from"):
        fit(replace(recording, channels=bare), MODEL, ("J",))


def test_windows_need_a_state_that_somebody_measured() -> None:
    with pytest.raises(ConfigError, match="an integrator whose state nobody measured"):
        fit(made.recorded(MODEL, 1), MODEL, ("J",), window_s=1.0)


def test_a_number_at_its_bound_is_no_success() -> None:
    """An inertia of 1.8 times the nominal one, which an error of 30 % cannot be."""
    true = Model(made.nominal_with(inertia_kg_m2=1.8))
    found = fit(made.recorded(true, 1), MODEL, ("inertia_error.error_fraction",))
    assert not found.converged
    assert "inertia_error.error_fraction stopped at its bound, 0.3" in found.reason


def test_a_number_that_the_recording_does_not_show() -> None:
    """A phase beside a torque far below the noise."""
    model = MODEL.with_effect("cogging", torque_nm=1e-7)
    found = fit(made.recorded(MODEL, 1), model, ("cogging.phase_rad",))
    assert not found.converged
    assert "cogging.phase_rad is not seen in this recording" in found.reason


def test_a_model_that_cannot_be_simulated_at_the_start() -> None:
    """Commands that are on their way for four minutes: no queue holds so many."""
    late = MODEL.with_effect("transport_delay", delay_s=240.0)
    with pytest.raises(FitError, match="the model cannot be simulated with the values"):
        fit(made.recorded(MODEL, 1), late, ("J",))


def test_a_model_file_gives_the_same_model(tmp_path: Path) -> None:
    model = MODEL.with_effect("coulomb", torque_nm=1.0 / 3.0e2).with_effect("viscous")
    path = tmp_path / "model.toml"
    path.write_text(model_text(model))
    loaded = load_model(path)
    assert loaded.nominal == model.nominal
    assert loaded.effects["coulomb"] == model.effects["coulomb"]


def test_a_key_that_nobody_reads_is_guessed_among_those_that_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(model_text(MODEL).replace("inertia_kg_m2", "inertia"))
    with pytest.raises(ConfigError, match=r"nominal\.inertia: .*Is nominal\.inertia_kg_m2 meant\?"):
        load_model(path)


def from_elsewhere(true: Model, path: Path) -> Path:
    """A recording from elsewhere, with the loop's channels."""
    recording = made.recorded(true, 3)
    channels = dict(recording.channels)
    t_s = (channels.pop("asked_ns") - 0) * 1e-9
    foreign = Recording(
        {"t_s": t_s, **channels}, recording.period_s, None, None, {"source_file": "a.csv"}
    )
    save_measured(foreign, path)
    return path


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording, and the model that is to be fitted."""
    folder = tmp_path_factory.mktemp("fit")
    (folder / "start.toml").write_text(model_text(MODEL))
    true = Model(made.nominal_with(inertia_kg_m2=1.2))
    return from_elsewhere(true, folder / "a.mcap"), folder / "start.toml"


def test_the_command_prints_and_writes_what_it_found(
    saved: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, start = saved
    out, model = tmp_path / "fit.json", tmp_path / "model.toml"
    words = ["fit", str(recording), "--model", str(start), "--free", "J, gap"]
    done = CliRunner().invoke(cli.app, [*words, "--json", str(out), "--model-out", str(model)])
    assert done.exit_code == 0, done.output
    numbers = json.loads(out.read_text())
    inertia = numbers["estimates"]["inertia_kg_m2"]["value"]
    assert inertia == pytest.approx(1.2 * 2.5e-4, rel=0.01)
    assert load_model(model).nominal.inertia_kg_m2 == inertia
    assert f"{inertia:.6g}" in done.output
    assert "kg m2" in done.output
    assert np.array(numbers["correlation"]).shape == (2, 2)


def test_what_the_rigs_file_has_is_there_while_others_are_fitted(tmp_path: Path) -> None:
    """A friction that is known, or an inertia would take its place."""
    true = Model(made.nominal_with(inertia_kg_m2=1.2)).with_effect("coulomb", torque_nm=0.03)
    recording = from_elsewhere(true, tmp_path / "a.mcap")
    rig, out = tmp_path / "rig.toml", tmp_path / "model.toml"
    known = find("rigs/paper.toml").read_text()
    rig.write_text(f"{known}\n[effects.coulomb]\ntorque_nm = 0.03\n")
    words = ["fit", recording, "--rig", rig, "--free", "J", "--model-out", out]
    done = CliRunner().invoke(cli.app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    found = load_model(out)
    assert found.nominal.inertia_kg_m2 == pytest.approx(1.2 * 2.5e-4, rel=0.005)
    assert found.effects["coulomb"].torque_nm == pytest.approx(0.03)


def test_the_command_says_what_failed(saved: tuple[Path, Path], tmp_path: Path) -> None:
    recording, start = saved
    out = tmp_path / "fit.json"
    call = ["fit", str(recording), "--free", "J", "--json", str(out)]
    assert isinstance(CliRunner().invoke(cli.app, call).exception, ConfigError)
    both = [*call, "--rig", "rigs/paper.toml", "--model", str(start)]
    assert "given both" in str(CliRunner().invoke(cli.app, both).exception)
    out.write_text("")
    there = CliRunner().invoke(cli.app, [*call, "--model", str(start)]).exception
    assert "exists already" in str(there)


def test_a_model_that_is_none_of_the_recordings_is_told_beside_its_standard_errors() -> None:
    """Another rig's file: a hundred times the inertia, of which only K_T is free."""
    seen = made.recorded(MODEL, 5, slots=400)
    heavy = Model(replace(made.NOMINAL, inertia_kg_m2=100.0 * made.NOMINAL.inertia_kg_m2))
    found = fit(seen, heavy, ["K_T"])
    assert any("does not describe this recording" in note for note in found.notes)
    right = fit(seen, MODEL, ["K_T"])
    assert not any("does not describe" in note or "grew" in note for note in right.notes)
