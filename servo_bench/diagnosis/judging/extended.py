"""The rig extended by a verdict: the same rig file, its model that of the verdict.

    servo-bench rig --config EXTENDED.toml      plays it as it is

Everything of the rig is kept but what its software stand-in had hidden (`[simulated]`: plant,
effects, backlash_gap_rad): it would act beside what was found.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ConfigError
from servo_bench.rig import NominalConfig, RigConfig, SimulatedConfig
from sim_rig.model import Model
from sim_rig.settings import Nominal

HIDDEN = ("plant", "effects", "backlash_gap_rad")


def extended_rig(rig: RigConfig, verdict: Verdict) -> RigConfig:
    """The rig with the verdict's nominal values and effects; ConfigError where it fitted none."""
    if not verdict.nominal:
        raise ConfigError(
            "the verdict holds no model, for nothing could be fitted: there is no rig to extend. "
            "See its next_run."
        )
    simulated = rig.simulated
    if simulated is not None:
        plain = SimulatedConfig()
        simulated = simulated.model_copy(update={name: getattr(plain, name) for name in HIDDEN})
    return rig.model_copy(
        update={
            "nominal": NominalConfig(**verdict.nominal),
            "effects": dict(verdict.effects),
            "simulated": simulated,
        }
    )


def found_model(verdict: Verdict) -> Model:
    """The verdict's model alone; ConfigError where it fitted none."""
    if not verdict.nominal:
        raise ConfigError("the verdict holds no model, for nothing could be fitted.")
    return Model.from_table(Nominal(**verdict.nominal), verdict.effects)


def rig_text(rig: RigConfig) -> str:
    """The TOML text from which `load_rig` makes the same rig; numbers keep all their digits."""
    table = rig.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    return "\n".join(toml_lines("", table)) + "\n"


def toml_lines(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """A table's lines, its own values before the tables in it."""
    if name:
        yield f"\n[{name}]"
    for key, value in table.items():
        if not isinstance(value, dict):
            # JSON's strings, numbers, booleans and flat lists are TOML's.
            yield f"{_key(key)} = {json.dumps(value, ensure_ascii=False)}"
    for key, value in table.items():
        if isinstance(value, dict):
            yield from toml_lines(f"{name}.{_key(key)}" if name else _key(key), value)


def _key(key: str) -> str:
    plain = key.replace("_", "").replace("-", "")
    bare = plain.isascii() and plain.isalnum()
    return key if bare else json.dumps(key, ensure_ascii=False)
