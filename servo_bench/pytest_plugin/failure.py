"""The page of a failed test, under a name that no other test of the session has."""

import re
import zlib
from collections.abc import Sequence
from pathlib import Path

from servo_bench.check.page import failure_page
from servo_bench.recording.recording import Recording

LONGEST_NAME = 80


def write_page(folder: Path, nodeid: str, text: str, recordings: Sequence[Recording]) -> str:
    """Write the page; where it is, or why it could not be written: never an error of its own."""
    page = folder / page_name(nodeid)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        page.write_text(failure_page(nodeid, text, recordings), encoding="utf-8")
    except Exception as error:  # noqa: BLE001 - a page must not end the session it tells of
        return f"the page {page} cannot be written: {type(error).__name__}: {error}"
    return str(page)


def page_name(nodeid: str) -> str:
    """A file name for a test, the same on every worker."""
    shown = re.sub(r"[^A-Za-z0-9.=-]+", "-", nodeid)[-LONGEST_NAME:].strip("-")
    return f"{shown}-{zlib.crc32(nodeid.encode()):08x}.html"
