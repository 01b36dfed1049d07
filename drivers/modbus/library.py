"""Where drive profiles come from: the ones that ship, by name, and anybody's own, by path."""

import tomllib
from functools import cache
from pathlib import Path

from pydantic import ValidationError

from drivers.errors import SettingsError
from drivers.modbus.plan import plan_of
from drivers.modbus.profile import DriveProfile

SHIPPED = Path(__file__).parent.parent / "profiles" / "modbus"
GENERIC = "generic"


def profile_names() -> tuple[str, ...]:
    """The profiles that ship, by name."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


@cache
def load_profile(name: str) -> DriveProfile:
    """A shipped profile by its name, or the one in a TOML file, its blocks checked.

    Raises SettingsError where there is none, or where it says what a profile cannot.
    """
    path = Path(name) if name.endswith(".toml") else SHIPPED / f"{name}.toml"
    try:
        table = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SettingsError(
            f"there is no Modbus drive profile {name!r} ({error.strerror}: {path}). Choose one of "
            f"{', '.join(profile_names())}, or give the path of a TOML file."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path} is not TOML: {error}. Mend that line.") from error
    try:
        profile = DriveProfile.model_validate(table)
        plan_of(profile)
    except ValidationError as error:
        reasons = "; ".join(
            f"{'.'.join(str(part) for part in item['loc']) or '(file)'}: {item['msg']}"
            for item in error.errors(include_url=False)
        )
        raise SettingsError(f"{path} is no Modbus profile: {reasons}. Correct these.") from error
    except ValueError as error:
        raise SettingsError(f"{path} is no Modbus profile: {error}. Correct this.") from error
    return profile
