"""How punctual a recording is: lateness, missed slots, answers that came late or not at all."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.response import slot_numbers
from servo_bench.recording.alignment import Delay, alignment
from servo_bench.recording.recording import MISSING, Recording

NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class RunQuality:
    """Figures of one run. NaN where the recording has no such channel.

    A missed slot was skipped or has no row; a missing answer is a row in which the device's value
    did not come; a late answer took longer than a period. Ask jitter is the deviation of the time
    between the asks of neighbouring slots from the nominal period. `alignment`: when the samples
    of a slot were, against its ask.
    """

    slots: int
    missed_slots: int
    missing_drive_answers: int
    missing_encoder_answers: int
    late_answers: int
    lateness_p50_s: float
    lateness_p99_s: float
    lateness_max_s: float
    drive_latency_p99_s: float
    encoder_latency_p99_s: float
    ask_jitter_rms_s: float
    ask_jitter_max_s: float
    events: dict[str, int]
    alignment: tuple[Delay, ...] = ()

    def numbers(self) -> dict[str, Any]:
        """The figures, ready for JSON; None for what is not known."""
        delays = {delay.name: asdict(delay) for delay in self.alignment}
        return {**_known(asdict(self)), "alignment": {n: _known(d) for n, d in delays.items()}}


def _known(figures: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in figures.items()
    }


def run_quality(recording: Recording) -> RunQuality:
    """The figures of any recording; nothing is raised."""
    slot = slot_numbers(recording)
    asked = recording["asked_ns"] if "asked_ns" in recording else np.zeros(0, np.int64)
    latencies = [_floats(recording, f"{device}_latency_s") for device in ("drive", "encoder")]
    lateness = _floats(recording, "lateness_s")
    jitter = _jitter_s(slot, asked, recording.period_s) if asked.size else np.zeros(0)
    return RunQuality(
        slots=int(slot[-1] - slot[0] + 1) if slot.size else 0,
        missed_slots=int(slot[-1] - slot[0] + 1 - slot.size) if slot.size else 0,
        missing_drive_answers=int(np.isnan(latencies[0]).sum()),
        missing_encoder_answers=int(np.isnan(_floats(recording, "load_angle_rad")).sum()),
        late_answers=sum(int((latency > recording.period_s).sum()) for latency in latencies),
        lateness_p50_s=_percentile(lateness, 50),
        lateness_p99_s=_percentile(lateness, 99),
        lateness_max_s=_percentile(lateness, 100),
        drive_latency_p99_s=_percentile(latencies[0], 99),
        encoder_latency_p99_s=_percentile(latencies[1], 99),
        ask_jitter_rms_s=float(np.sqrt(np.mean(jitter**2))) if jitter.size else float("nan"),
        ask_jitter_max_s=_percentile(np.abs(jitter), 100),
        events=dict(Counter(event.kind for event in recording.events)),
        alignment=alignment(recording.channels),
    )


def _floats(recording: Recording, channel: str) -> NDArray[np.float64]:
    return recording[channel].astype(np.float64) if channel in recording else np.zeros(0)


def _jitter_s(
    slot: NDArray[np.int64], asked_ns: NDArray[np.int64], period_s: float
) -> NDArray[np.float64]:
    neighbours = (np.diff(slot) == 1) & (asked_ns[1:] != MISSING) & (asked_ns[:-1] != MISSING)
    gaps: NDArray[np.float64] = np.diff(asked_ns)[neighbours] / NS_PER_S - period_s
    return gaps


def _percentile(values: NDArray[np.float64], percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else float("nan")
