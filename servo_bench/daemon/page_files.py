"""The page's files: what lies in `page/` and nothing else, found by a list, not by a path."""

from functools import cache
from pathlib import Path

from servo_bench.daemon.problems import ApiError

FOLDER = Path(__file__).parent / "page"
SERVED = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".txt": "text/plain",
}
"""Endings and their media types: the machine's own table of them is not asked."""


@cache
def _files() -> dict[str, Path]:
    return {
        path.relative_to(FOLDER).as_posix(): path
        for path in FOLDER.rglob("*")
        if path.is_file() and not path.is_symlink() and path.suffix in SERVED
    }


def page_file(path: str) -> tuple[Path, str]:
    """The file that a browser asks for, the page itself for "/", and its media type.

    ApiError where there is none.
    """
    found = _files().get(path or "index.html")
    if found is None:
        raise ApiError(404, "no-such-page", f"there is no page {path[:80]!r} here. Begin at /.")
    return found, SERVED[found.suffix]
