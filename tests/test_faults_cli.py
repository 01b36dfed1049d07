"""Profiles and faults on the command line."""

import pytest
from typer.testing import CliRunner, Result

from drivers.canopen.profile import profile_names
from servo_bench.cli.app import app
from servo_bench.errors import BenchError, ConfigError
from servo_bench.rig import load_rig
from sim_rig.faults.catalogue import KINDS


def invoke(*words: str) -> Result:
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "200"})


def test_drives_lists_every_profile_that_ships() -> None:
    result = invoke("drives")
    assert result.exit_code == 0
    assert all(name in result.output for name in profile_names())


def test_drives_describes_one_with_its_sources() -> None:
    result = invoke("drives", "maxon-epos4")
    assert "0x605A = 6" in result.output
    assert "source: " in result.output


def test_an_unknown_profile_names_those_that_are_there() -> None:
    result = invoke("drives", "acme")
    assert isinstance(result.exception, BenchError)
    assert "Choose one of delta-asda-a2" in str(result.exception)


def test_the_rig_lists_the_faults_that_it_can_be_told() -> None:
    result = invoke("rig", "--list-faults")
    assert result.exit_code == 0
    assert all(name in result.output for name in KINDS)


def test_a_fault_that_cannot_be_is_a_config_error_before_anything_starts() -> None:
    result = invoke("rig", "--fault", "gremlins")
    assert isinstance(result.exception, ConfigError)
    assert "no such kind" in str(result.exception)


def test_faults_of_the_file_and_of_the_command_line_add_up() -> None:
    rig = load_rig("rigs/paper.toml").with_faults("reset at=5").with_faults("lost")
    assert rig.simulation_settings().faults == ("reset at=5", "lost")
    with pytest.raises(ConfigError, match="name=value"):
        rig.with_faults("lost x").simulation_settings()
