"""Where profiles come from: those that ship, by name; anybody's own, by path. TOML files, all."""

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from drivers.errors import SettingsError

PROFILES = Path(__file__).parent / "profiles"
Profile = TypeVar("Profile")


def shipped_names(folder: Path) -> tuple[str, ...]:
    """The profiles in a folder, by name."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def read_profile(
    name: str, kind: str, folder: Path, made: Callable[[Mapping[str, Any]], Profile]
) -> Profile:
    """The profile that `made` makes of the TOML file called `name`, or of the shipped one.

    `kind` is what such a profile is called, for messages. Raises SettingsError where there is no
    such file, where it is no TOML, and where `made` refuses it by ValidationError or ValueError.
    """
    path = Path(name) if name.endswith(".toml") else folder / f"{name}.toml"
    try:
        table = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SettingsError(
            f"there is no {kind} {name!r} ({error.strerror}: {path}). Choose one of "
            f"{', '.join(shipped_names(folder))}, or give the path of a TOML file."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path} is not TOML: {error}. Mend that line.") from error
    try:
        return made(table)
    except ValidationError as error:
        reasons = "; ".join(
            f"{'.'.join(str(part) for part in item['loc']) or '(file)'}: {item['msg']}"
            for item in error.errors(include_url=False)
        )
        raise SettingsError(f"{path} is no {kind}: {reasons}. Correct these.") from error
    except ValueError as error:
        raise SettingsError(f"{path} is no {kind}: {error}. Correct this.") from error
