"""A model as a TOML file: `[nominal]`, and one `[effects.NAME]` for every effect.

What a fit writes, and what the next fit starts from. Numbers keep all their digits.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from pydantic import Field

from servo_bench.errors import gathered
from servo_bench.files import Value, find, read_toml, validated
from servo_bench.rig import NominalConfig
from sim_rig.model import Model
from sim_rig.settings import Nominal


class ModelConfig(Value):
    """The file."""

    nominal: NominalConfig
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)


def load_model(name: str | Path) -> Model:
    """Read a model; ConfigError where it is missing or says something impossible."""
    path = find(name)
    config = validated(ModelConfig, read_toml(path), str(path))
    with gathered():
        return Model.from_table(Nominal(**config.nominal.model_dump()), config.effects)


def model_text(model: Model) -> str:
    """The TOML text from which `load_model` makes the same model."""
    effects = {f"effects.{name}": table for name, table in model.to_table().items()}
    tables: Mapping[str, Mapping[str, float]] = {"nominal": asdict(model.nominal), **effects}
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {float(value)!r}\n" for key, value in table.items())
        for name, table in tables.items()
    )
