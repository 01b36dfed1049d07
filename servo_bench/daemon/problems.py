"""Errors as problem+json (RFC 9457): ours with their own words, HTTP's with better ones.

| error          | status | because                                              |
|----------------|--------|------------------------------------------------------|
| ConfigError    | 422    | the request asks for something impossible            |
| LimitError     | 422    | it would leave the rig's limits                      |
| BusyError      | 409    | the rig is in somebody's hands                       |
| RecordingError | 422    | the recording does not do what it must               |
| FitError       | 422    | the data do not allow it                             |
| WireError      | 502    | the bus or a node does not answer                    |
| DriveError     | 502    | the drive refused                                    |
| RigError       | 502    | the software rig failed                              |
| any of them    | 507    | a full disk is behind it                             |
"""

from http import HTTPStatus
from typing import Any

from servo_bench.errors import (
    BenchError,
    BusyError,
    ConfigError,
    DriveError,
    FitError,
    LimitError,
    RecordingError,
    RigError,
    WireError,
    disk_is_full,
)

MEDIA_TYPE = "application/problem+json"
STATUS: dict[type[BenchError], int] = {
    ConfigError: 422,
    LimitError: 422,
    BusyError: 409,
    RecordingError: 422,
    FitError: 422,
    WireError: 502,
    DriveError: 502,
    RigError: 502,
}


DISK_FULL = (507, "disk-full")
"""Status and slug, wherever it is met."""


class ApiError(BenchError):
    """A request that cannot be answered as it is meant: status, a short slug, and the words."""

    def __init__(self, status: int, slug: str, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.slug = slug


def problem(status: int, slug: str, detail: str, instance: str = "") -> dict[str, Any]:
    """The body of an answer that is an error."""
    body = {
        "type": f"urn:servo-bench:problem:{slug}",
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
    }
    return {**body, "instance": instance} if instance else body


def problem_of(error: BenchError) -> tuple[int, str]:
    """Status and slug of one of our errors."""
    if isinstance(error, ApiError):
        return error.status, error.slug
    if disk_is_full(error):
        return DISK_FULL
    for kind in type(error).__mro__:
        if kind in STATUS:
            name = kind.__name__.removesuffix("Error").lower()
            return STATUS[kind], name
    return 500, "bench"
