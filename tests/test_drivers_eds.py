"""EDS files as they are found in the field."""

from pathlib import Path

import pytest

from drivers.canopen.eds import load_eds
from drivers.errors import SettingsError

GOOD = """
[6041]
ParameterName=Statusword
ObjectType=0x7
DataType=0x0006
AccessType=ro
PDOMapping=1

[1400]
ParameterName=RPDO
ObjectType=0x9
[1400sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x200
"""

MESS = """
[FileInfo]
FileVersion=
[Comments]
Lines=02
[DeviceInfo]
VendorNumber=
ProductNumber=001
BaudRate_1000=09
[DeviceComissioning]
NodeID=
Baudrate=
[6041]
ParameterName=Zustand \xfc ; in German
ObjectType=07
DataType=0006
AccessType=ro
LowLimit=
PDOMapping=01
[6041]
StorageLocation=RAM
"""


def written(folder: Path, text: str, encoding: str = "ascii") -> Path:
    path = folder / "device.eds"
    path.write_bytes(text.encode(encoding))
    return path


def test_a_good_file_gives_its_objects(tmp_path: Path) -> None:
    dictionary = load_eds(written(tmp_path, GOOD), 5, (0x6041,))
    variable = dictionary.get_variable(0x6041)
    assert variable is not None
    assert (len(variable), variable.pdo_mappable, variable.writable) == (16, True, False)
    cob_id = dictionary.get_variable(0x1400, 1)
    assert cob_id is not None
    assert cob_id.default == 0x205


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-8-sig"])
def test_a_file_that_bends_the_rules_is_read(tmp_path: Path, encoding: str) -> None:
    dictionary = load_eds(written(tmp_path, MESS, encoding), 5)
    variable = dictionary.get_variable(0x6041)
    assert variable is not None
    assert (len(variable), variable.pdo_mappable) == (16, True)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"cannot read the EDS .*no\.eds: No such file"):
        load_eds(tmp_path / "no.eds", 1)


@pytest.mark.parametrize(
    "text",
    [
        "this is a letter, not a file",
        GOOD.replace("DataType=0x0006", "DataType=banana"),
        GOOD.replace("ParameterName=Statusword", ""),
        GOOD.replace("[1400]", "[1401]"),
    ],
)
def test_a_broken_file_is_a_settings_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(SettingsError, match=r"device\.eds is (not an|a broken) EDS: .*Give the"):
        load_eds(written(tmp_path, text), 1)


def test_an_eds_of_another_kind_of_device_says_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="lacks the objects 0x6004, 0x60FF"):
        load_eds(written(tmp_path, GOOD), 1, (0x6041, 0x6004, 0x60FF))
