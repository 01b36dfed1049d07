"""Recordings for the API: by the catalogue's ids, never by a path from a request."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from servo_bench.catalogue import Catalogue, Run
from servo_bench.catalogue.beside import FIGURE, beside, has_figures, read_json
from servo_bench.catalogue.run import plain
from servo_bench.clock import NS_PER_S
from servo_bench.daemon.problems import ApiError
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import RecordingError
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import MISSING, Recording

MOST_EVENTS = 1000
MOST_POINTS = 20_000


def run_of(catalogue: Catalogue, run_id: str) -> Run:
    """The run of that id; ApiError where there is none (any more)."""
    try:
        return catalogue.get(run_id)
    except RecordingError as error:
        raise ApiError(404, "no-such-run", str(error)) from error


def path_of(catalogue: Catalogue, run_id: str) -> Path:
    """The recording's file, within the recordings folder; ApiError where there is none."""
    try:
        path = catalogue.path(run_id).resolve(strict=True)
    except (RecordingError, OSError) as error:
        raise ApiError(404, "no-such-run", str(error)) from error
    if not path.is_relative_to(catalogue.folder):
        raise ApiError(404, "no-such-run", f"{path.name} leads out of the recordings folder.")
    return path


def companion(catalogue: Catalogue, run_id: str, kind: str) -> Path:
    """A file that an analysis or a diagnosis made beside the recording; ApiError without one."""
    places = beside(path_of(catalogue, run_id))
    found: Path = getattr(places, kind)
    own = kind.startswith("diagnosis") or has_figures(places.figures)
    if not own or not found.is_file() or found.is_symlink():
        work = "diagnose" if kind.startswith("diagnosis") else "analyse"
        slug = f"no-{kind.replace('_', '-')}"
        words = f"{found.name} is not there: {work} the run first, then ask again."
        raise ApiError(404, slug, words)
    return found


def verdict_of(catalogue: Catalogue, run_id: str) -> Verdict:
    """The verdict beside a recording. ApiError without one, RecordingError where it is none."""
    path = companion(catalogue, run_id, "diagnosis")
    try:
        return Verdict.model_validate(read_json(path))
    except ValidationError as error:
        raise RecordingError(
            f"{path.name} is no verdict of this version ({error.error_count()} keys do not fit). "
            "Diagnose the run again."
        ) from error


def detail(catalogue: Catalogue, run_id: str) -> dict[str, Any]:
    """The run's line with figures, sentences, and events, as far as they can be had."""
    run = run_of(catalogue, run_id)
    path = path_of(catalogue, run_id)
    places = beside(path)
    figures = _table(places.figures)
    figures = plain(figures) if FIGURE in figures else {}
    flags, quality = figures.get("flags"), figures.get("run")
    return {
        **run.row(),
        "sentences": [str(flag) for flag in flags] if isinstance(flags, list) else [],
        "quality": quality if isinstance(quality, dict) else None,
        "kernels": {key: value for key, value in figures.items() if key not in ("flags", "run")}
        or None,
        "diagnosis": _verdict(places.diagnosis),
        "events": _events(path),
        "has_report": bool(figures) and places.report.is_file(),
        "has_diagnosis_page": places.diagnosis_page.is_file(),
    }


def _table(path: Path) -> dict[str, Any]:
    try:
        return read_json(path) or {}
    except RecordingError:
        return {}  # the run's own line says what cannot be read


def _verdict(path: Path) -> Verdict | None:
    try:
        return Verdict.model_validate(_table(path))
    except ValidationError:
        return None  # none beside it, or none of this version: asked for by itself it says so


def _events(path: Path) -> list[dict[str, Any]]:
    try:
        events = load(path, allow_cut=True).events
    except RecordingError:
        return []
    begun_ns = events[0].time_ns if events else 0
    return [
        {
            "at_s": (event.time_ns - begun_ns) / NS_PER_S,
            "kind": plain(event.kind),
            "text": plain(event.text),
            "data": plain(dict(event.data)),
        }
        for event in events[:MOST_EVENTS]
    ]


def samples(path: Path, channels: tuple[str, ...], points: int) -> dict[str, Any]:
    """Channels in at most `points` blocks: each block's first time, least and largest values.

    ApiError for a channel that the recording does not have, RecordingError where it is none.
    """
    recording = load(path, allow_cut=True)
    unknown = [name for name in channels if name not in recording]
    if unknown:
        raise ApiError(
            422,
            "no-such-channel",
            f"the recording has no channel {unknown[0][:80]!r}; it has "
            f"{', '.join(recording.channels)}.",
        )
    rows = len(recording)
    edges = np.unique(np.linspace(0, rows, min(points, max(rows, 1)) + 1).astype(np.intp))
    begins = edges[:-1]
    return {
        "rows": rows,
        "t_s": _time_s(recording)[begins].tolist() if rows else [],
        "columns": {
            name: _least_and_largest(_as_float(recording[name]), begins) if rows else _NOTHING
            for name in channels
        },
    }


_NOTHING: Mapping[str, list[float | None]] = {"min": [], "max": []}


def _time_s(recording: Recording) -> NDArray[np.float64]:
    if "slot" in recording:
        slots = recording["slot"]
        return np.asarray((slots - slots[0]) * recording.period_s)
    return np.asarray(recording["t_s"] - recording["t_s"][0])


def _as_float(values: NDArray[Any]) -> NDArray[np.float64]:
    floats = values.astype(np.float64)
    if values.dtype.kind == "i":
        floats[values == MISSING] = np.nan
    return floats


def _least_and_largest(
    values: NDArray[np.float64], begins: NDArray[np.intp]
) -> dict[str, list[float | None]]:
    known = np.isfinite(values)
    least = np.minimum.reduceat(np.where(known, values, np.inf), begins)
    largest = np.maximum.reduceat(np.where(known, values, -np.inf), begins)
    return {"min": _listed(least), "max": _listed(largest)}


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
