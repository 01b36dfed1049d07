"""Structured logs: one JSON object a line on stderr, which is the journal under systemd.

A log that nobody takes any more is no reason not to stop a rig: what cannot be written is lost.
"""

import logging
import sys
from contextlib import suppress
from typing import Any, TextIO, cast

import structlog
from structlog.typing import Processor

Log = Any
"""structlog's bound logger, whose methods are made at run time."""


class Sink:
    """A stream that takes what it can and never raises; None for a stderr that was closed."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if that can be."""
        if self._stream is not None:
            with suppress(OSError, ValueError):  # ValueError: it is closed
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that can be."""
        if self._stream is not None:
            with suppress(OSError, ValueError):
                self._stream.flush()


def configure() -> None:
    """Send structlog's and the libraries' records to stderr as JSON lines."""
    sink = cast("TextIO", Sink(sys.stderr))
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    structlog.configure(
        processors=[
            *shared,
            structlog.processors.dict_tracebacks,
            structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.PrintLoggerFactory(sink),
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(sink)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.dict_tracebacks,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(logging.WARNING)


def log() -> Log:
    """The daemon's logger."""
    return structlog.get_logger("servo_bench.daemon")
