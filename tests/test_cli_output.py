"""What a command writes is whole, or not there: a disk that is full leaves no half of it."""

import errno
from pathlib import Path
from typing import Any

import pytest

from servo_bench.cli.output import check_outputs, write_bytes
from servo_bench.errors import ConfigError


def test_a_name_that_no_file_can_have_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: File name too long"):
        check_outputs(tmp_path / ("a" * 300))


def test_a_full_disk_leaves_no_half_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.open

    class Full:
        """A file that takes ten bytes."""

        def __init__(self, file: Any) -> None:
            self._file = file

        def __enter__(self) -> "Full":
            return self

        def __exit__(self, *_: object) -> None:
            self._file.close()

        def write(self, content: bytes) -> int:
            self._file.write(content[:10])
            raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "report.html"
    with monkeypatch.context() as full:
        full.setattr(Path, "open", lambda path, mode: Full(real(path, mode)))
        with pytest.raises(ConfigError, match=r"the disk is full\. Make room"):
            write_bytes(target, b"x" * 1000)
    assert not target.exists()
    check_outputs(target)
    write_bytes(target, b"whole")
    with pytest.raises(ConfigError, match="exists already"):
        write_bytes(target, b"another")
    assert target.read_bytes() == b"whole"
