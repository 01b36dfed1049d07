"""A short run with a known truth, and its page taken apart, for the tests of the reports."""

import json
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from typing import Any

import numpy as np

from servo_bench.recording.recording import Event, Recording
from servo_bench.rig import load_rig
from tests.played_rig import Rig, experiment

HOSTILE = "<script>alert('1')</script>\"&$x^2$"
NOT_CLOSED = frozenset({"meta", "path", "use", "image", "br"})


@cache
def short_run() -> Recording:
    """One period of 15341 and a held-out second of play, late now and then, on a named rig."""
    plan = experiment("15341", memory=18, fresh=512)
    played = Rig(noise_rad=1e-4).record(plan)
    late = np.random.default_rng(3).lognormal(np.log(6e-5), 0.4, len(played))
    channels = dict(played.channels) | {
        "lateness_s": late,
        "drive_latency_s": late + 3e-4,
        "encoder_latency_s": late + 4e-4,
    }
    return replace(
        played,
        channels=channels,
        rig=load_rig("rigs/paper.toml"),
        provenance={"servo_bench": "0", "command": "servo-bench run"},
        events=(Event(0, "playing", "the drive is enabled", {"start_ns": 0}),),
    )


def hostile_run() -> Recording:
    """The same run with markup in every text that a recording brings."""
    run = short_run()
    assert run.experiment is not None
    assert run.rig is not None
    bad_bus = {**run.rig.bus, "channel": HOSTILE}
    return replace(
        run,
        experiment=run.experiment.model_copy(update={"name": HOSTILE, "rig": HOSTILE}),
        rig=run.rig.model_copy(update={"name": HOSTILE, "bus": bad_bus}),
        provenance={HOSTILE: HOSTILE},
        events=(Event(1, HOSTILE, HOSTILE, {HOSTILE: [HOSTILE]}),),
    )


class Page(HTMLParser):
    """The elements, attributes and texts of a page, as a browser finds them."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.cells: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag in {"th", "td"}:
            self.cells.append("")

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.cells:
            self.cells[-1] += data

    def figures(self) -> dict[str, Any]:
        """The table of exact figures, read back: dotted name -> value."""
        cells = [cell.strip() for cell in self.cells]
        start = next(i for i, cell in enumerate(cells) if cell in {"polynomial", FIRST_OF_PAPER})
        names, values = cells[start::2], cells[start + 1 :: 2]
        return dict(zip(names, map(_read, values), strict=True))


FIRST_OF_PAPER = "simulation.zero.order1_same"


def _read(cell: str) -> Any:
    return json.JSONDecoder().raw_decode(cell)[0]


def flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested figures with dotted names."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, dict)
        found |= flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return found
