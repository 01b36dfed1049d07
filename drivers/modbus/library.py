"""Where drive profiles come from: the ones that ship, by name, and anybody's own, by path."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from drivers.modbus.plan import plan_of
from drivers.modbus.profile import DriveProfile
from drivers.profile_file import PROFILES, read_profile, shipped_names

SHIPPED = PROFILES / "modbus"
GENERIC = "generic"


def profile_names() -> tuple[str, ...]:
    """The profiles that ship, by name."""
    return shipped_names(SHIPPED)


@cache
def load_profile(name: str) -> DriveProfile:
    """A shipped profile by its name, or the one in a TOML file, its blocks checked.

    Raises SettingsError where there is none, or where it says what a profile cannot.
    """
    return read_profile(name, "Modbus drive profile", SHIPPED, _checked)


def _checked(table: Mapping[str, Any]) -> DriveProfile:
    profile = DriveProfile.model_validate(table)
    plan_of(profile)
    return profile
