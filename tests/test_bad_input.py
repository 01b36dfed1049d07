"""Experiment and rig files that cannot be: each is refused in one sentence, before any memory."""

from pathlib import Path
from typing import Any

import pytest

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import load_experiment
from servo_bench.files import find, read_toml
from servo_bench.rig import load_rig

SHIPPED = Path(find("experiments/demo.toml"))

BAD_EXPERIMENTS = [
    ("period_s = 0.008", "period_s = 1e-9", "standstill_s = 2"),
    ("period_s = 0.008", "period_s = nan", "finite"),
    ("standstill_s = 2.0", "standstill_s = 1e300", "standstill_s"),
    ("lead_in = 128", "lead_in = 1000000000000", "lead_in"),
    ("lead_in = 128", "lead_in = 4", "shorter than the kernels' memory"),
    ("length = 1024", "length = 1000000000", "length"),
    ('polynomial = "15341"', 'polynomial = "15341"\nperiods = 1000000000', "fewer periods"),
    ('polynomial = "15341"', 'polynomial = "15343"', "not primitive"),
    ('kind = "random-binary"', 'kind = "x"', "random-binary"),
    ("name", f"a = {'[' * 3000}{']' * 3000}\nname", "nested too deeply"),
]


@pytest.mark.parametrize(
    ("good", "bad", "words"), BAD_EXPERIMENTS, ids=[row[1][:30] for row in BAD_EXPERIMENTS]
)
def test_an_experiment_that_cannot_be_is_refused_in_words(
    tmp_path: Path, good: str, bad: str, words: str
) -> None:
    text = SHIPPED.read_text()
    assert good in text
    file = tmp_path / "bad.toml"
    file.write_text(text.replace(good, bad, 1))
    with pytest.raises(ConfigError, match=words):
        load_experiment(file).schedule()


BAD_RIGS: list[tuple[str, str, Any]] = [
    ("drive", "heartbeat_timeout_s", 1e9),
    ("drive", "enable_timeout_s", 1e300),
    ("drive", "sdo_timeout_s", 0),
    ("drive", "node_id", 128),
    ("limits", "run_time_s", "inf"),
    ("nominal", "inertia_kg_m2", -1),
    ("simulated", "seed", -1),
    ("simulated", "nonsense", 1),
]


@pytest.mark.parametrize(("table", "key", "value"), BAD_RIGS)
def test_a_rig_that_cannot_be_is_refused_by_the_name_of_its_key(
    tmp_path: Path, table: str, key: str, value: object
) -> None:
    lines = Path(find("rigs/paper.toml")).read_text().splitlines()
    without = [line for line in lines if not line.startswith(f"{key} ")]
    place = without.index(f"[{table}]") + 1
    file = tmp_path / "bad.toml"
    file.write_text("\n".join([*without[:place], f"{key} = {value}", *without[place:]]))
    with pytest.raises(ConfigError, match=rf"{table}\.{key}"):
        load_rig(file)


@pytest.mark.parametrize("name", ["", "/", "a\0b", "x" * 5000])
def test_a_name_that_no_file_can_have_is_not_found(name: str) -> None:
    with pytest.raises(ConfigError, match="there is no file"):
        find(name)


def test_bytes_that_are_no_text_are_no_toml(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(b"\xff\xfe\0")
    with pytest.raises(ConfigError, match="not TOML"):
        read_toml(file)
