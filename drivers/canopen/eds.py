"""Reading a device's EDS, also one that bends the rules of CiA 306.

Only the objects are wanted, so whatever describes the file, the device, or its commissioning is
left out, and with it the numbers that real files get wrong there (empty, or '001').
"""

import io
from configparser import Error as ConfigError
from configparser import NoOptionError, NoSectionError, RawConfigParser
from pathlib import Path

import canopen
from canopen.objectdictionary import ObjectDictionary, ObjectDictionaryError

from drivers.errors import SettingsError

_NOT_OBJECTS = frozenset({"fileinfo", "deviceinfo", "comments", "devicecomissioning", "tools"})
_NEXT = "Give the EDS that came with the device."


class _NamedText(io.StringIO):
    """Text with the file name by which canopen tells an EDS from other formats."""

    name = "device.eds"


class _CasedParser(RawConfigParser):
    """Option names keep their case, as canopen expects them."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


def load_eds(path: Path, node_id: int, required: tuple[int, ...] = ()) -> ObjectDictionary:
    """The object dictionary of a device, `$NODEID` resolved.

    Raises SettingsError where the file is missing, is no EDS, or lacks one of the `required`
    objects.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise SettingsError(f"cannot read the EDS {path}: {error.strerror}. {_NEXT}") from error
    try:
        dictionary = canopen.import_od(_NamedText(_cleaned(_decoded(raw))), node_id)
    except (ConfigError, NoOptionError, NoSectionError, ObjectDictionaryError) as error:
        raise SettingsError(f"{path} is not an EDS: {_one_line(error)}. {_NEXT}") from error
    except (KeyError, ValueError) as error:
        raise SettingsError(f"{path} is a broken EDS: {_one_line(error)}. {_NEXT}") from error
    missing = [f"0x{index:04X}" for index in required if index not in dictionary]
    if missing:
        raise SettingsError(
            f"{path} lacks the object{'s' * (len(missing) > 1)} {', '.join(missing)}: it does not "
            f"describe the device that is needed here. {_NEXT}"
        )
    return dictionary


def _decoded(raw: bytes) -> str:
    """EDS files should be ASCII; many are not."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _cleaned(text: str) -> str:
    """The objects' sections, without empty entries, leading zeros taken as CiA 306's octal."""
    parser = _CasedParser(inline_comment_prefixes=(";",), strict=False)
    parser.read_string(text)
    for section in parser.sections():
        if section.lower() in _NOT_OBJECTS:
            parser.remove_section(section)
            continue
        for option, value in parser.items(section):
            if not value:
                parser.remove_option(section, option)
            elif value[0] == "0" and value.isdecimal():
                parser.set(section, option, str(_octal(value)))
    parser.add_section("DeviceInfo")
    cleaned = io.StringIO()
    parser.write(cleaned)
    return cleaned.getvalue()


def _octal(value: str) -> int:
    return int(value, 8 if set(value) <= set("01234567") else 10)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
