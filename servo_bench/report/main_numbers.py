"""The tables at the head of an experiment's report."""

from dataclasses import dataclass

from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.quality import RunQuality
from servo_bench.recording.recording import Recording
from servo_bench.report.wording import DEG, NOT_KNOWN, Row, ceiling, percent, quantity

S_TO_US = 1e6


@dataclass(frozen=True, slots=True)
class Prediction:
    """One line of the table of predictions; `counts` marks the line that judges the kernels."""

    name: str
    remark: str
    order_1: str
    order_3: str
    counts: bool = False


def prediction_rows(analysis: Analysis) -> list[Prediction]:
    """VAF on fresh input, VAF on the input that was fitted, and the error of the load angle."""
    same, validation = analysis.identification, analysis.validation
    fresh = validation.velocity if validation else None
    return [
        Prediction(
            "VAF, fresh",
            "held-out validation that no fit saw: this one counts",
            percent(fresh.vaf_order1_percent) if fresh else NOT_KNOWN,
            percent(fresh.vaf_order3_percent) if fresh else NOT_KNOWN,
            counts=True,
        ),
        Prediction(
            "VAF, same period",
            "agreement with the data used for identification: proves nothing by itself",
            percent(same.vaf_order1_percent),
            percent(same.vaf_order3_percent),
        ),
        Prediction(
            "load angle error, rms",
            "velocities integrated over the whole validation",
            quantity(validation.angle_error_order1_rms_rad, DEG, "deg")
            if validation
            else NOT_KNOWN,
            quantity(validation.angle_error_order3_rms_rad, DEG, "deg")
            if validation
            else NOT_KNOWN,
        ),
    ]


def condition_rows(analysis: Analysis) -> list[Row]:
    """Under which conditions the figures hold."""
    kernels = analysis.kernels
    return [
        Row("noise ceiling of the VAF", ceiling(analysis.noise_ceiling_percent)),
        Row("noise of the velocity", quantity(analysis.noise_rad_s, DEG, "deg/s")),
        Row("sequence", sequence_words(analysis)),
        Row("periods averaged", str(kernels.periods)),
        Row("noise between periods", quantity(analysis.repeat_noise_rad_s, DEG, "deg/s")),
        Row("amplitude A", quantity(kernels.amplitude, DEG, "deg/s", 6)),
        Row("sampling period Δt", quantity(kernels.period_s, 1e3, "ms", 6)),
        Row(
            "memory M", f"{kernels.memory} samples, {kernels.memory * kernels.period_s * 1e3:g} ms"
        ),
        Row("memory that can be resolved", f"{analysis.played.resolvable_memory} samples"),
        Row("command to first answer", f"{analysis.delay_periods} whole periods"),
        Row("time of the samples", f"{analysis.timebase} clock"),
    ]


def sequence_words(analysis: Analysis) -> str:
    """What was played to identify."""
    played = analysis.played
    name = f"f(x) = {played.polynomial}"
    words = f"{name} (octal)" if played.kind != "field" else f"{name} over GF({played.field})"
    if played.kind == "inverse-repeat":
        words += ", inverse repeat"
    if analysis.separated is not None:
        words += f", {analysis.amplitudes} amplitudes"
    bias = analysis.bias_rad_s
    if abs(bias) > 1e-6 * analysis.kernels.amplitude:
        words += f", bias {quantity(bias, DEG, 'deg/s')}"
    return words


def run_rows(quality: RunQuality, recording: Recording) -> list[Row]:
    """How the run went."""
    answers, timed = str(quality.missing_drive_answers), "drive_latency_s" in recording
    return [
        Row("duration", f"{quality.slots * recording.period_s:.1f} s, {quality.slots} slots"),
        *_fast_rows(recording),
        Row("missed slots", str(quality.missed_slots)),
        Row("missing answers of the drive", answers if timed else "not recorded"),
        Row("missing answers of the encoder", str(quality.missing_encoder_answers)),
        Row("answers later than a period", str(quality.late_answers) if timed else "not recorded"),
        Row("lateness p50", _us(quality.lateness_p50_s)),
        Row("lateness p99", _us(quality.lateness_p99_s)),
        Row("lateness max", _us(quality.lateness_max_s)),
        Row("interval of the asks, rms off", _us(quality.ask_jitter_rms_s)),
        Row("interval of the asks, largest off", _us(quality.ask_jitter_max_s)),
        *(
            Row(_ALIGNED[delay.name], f"{_us(delay.median_s)}, p99 {_us(delay.p99_s)}")
            for delay in quality.alignment
            if delay.name in _ALIGNED
        ),
    ]


_ALIGNED = {
    "motor sample": "motor's angle taken after the ask, median",
    "load sample": "load's angle taken after the ask, median",
    "motor answer": "drive's answer after the ask, median",
    "load answer": "encoder's answer after the ask, median",
    "device clock": "device's time of the samples off the asks, median",
}


def _fast_rows(recording: Recording) -> list[Row]:
    """Said where the angles were sampled faster than the command."""
    if not recording.fast:
        return []
    parts = int(recording.fast["part"].max()) + 1
    told = f"{parts} per command; the kernels take the one at the command's SYNC"
    return [Row("samples of the angles", told)]


def _us(value_s: float) -> str:
    return quantity(value_s, S_TO_US, "µs", 4)
