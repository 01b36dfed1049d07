"""The figures of an experiment: 7 to 10 of the paper, the energies, and the run itself."""

import numpy as np
from numpy.typing import NDArray

from servo_bench.estimators.figures import KernelFigures
from servo_bench.estimators.study import Study
from servo_bench.kernels.analysis import Analysis, Validation
from servo_bench.recording.recording import Recording
from servo_bench.report.distortion_words import scatter_percent
from servo_bench.report.estimator_tables import label_rows
from servo_bench.report.kernel_figures import (
    EXPERIMENT,
    draw_first_kernel,
    draw_second_kernel,
    draw_separated,
    draw_third_kernel,
    third_kernel_limit,
)
from servo_bench.report.label_figures import draw_labels
from servo_bench.report.plates import Facts, Plate
from servo_bench.report.prediction_figures import (
    WINDOW_SAMPLES,
    draw_angle_error,
    draw_energies,
    draw_validation,
)
from servo_bench.report.quality_figures import draw_punctuality, draw_timeline
from servo_bench.report.style import drawn, symmetric_limit
from servo_bench.report.wording import DEG, percent, quantity, small_percent

Array = NDArray[np.float64]

NONE = "none: the memory holds no such element"

POSTERIOR_WORDS = (
    " Orange: the regularised posterior, with its 95 % band, which has taken the aliases of orders "
    "5 and 7 for themselves."
)


def kernel_plates(analysis: Analysis, posterior: KernelFigures | None = None) -> list[Plate]:
    """Figures 7, 8 and 9, and where the variance lies; `posterior` is drawn beside the first."""
    kernels = analysis.kernels
    limit = third_kernel_limit(kernels, EXPERIMENT)
    return [
        Plate(
            drawn(
                "figure-7",
                2.2,
                lambda figure: draw_first_kernel(
                    figure.subplots(), kernels, EXPERIMENT, posterior=posterior
                ),
                "First Volterra kernel over its lags",
            ),
            "Figure 7 of the paper",
            "First Volterra kernel g₁(τ₁) of the load's velocity. One amplitude A shows it only as "
            "g₁ + A²F. Grey band (where it is wider than the line): ±2 scatter of a coefficient, "
            "that is noise and aliases of orders 5 and above. Per sample; divided by Δt it is the "
            "kernel in continuous time." + (POSTERIOR_WORDS if posterior is not None else ""),
            _first_facts(analysis),
        ),
        Plate(
            drawn(
                "figure-8",
                2.9,
                lambda figure: draw_second_kernel(figure, kernels, EXPERIMENT, limit),
                "Second Volterra kernel as two maps",
            ),
            "Figure 8 of the paper",
            "Second Volterra kernel g₂(τ₁, τ₂), as the height of its term in the response. Left on "
            "the scale of the third kernel, right on its own. A symmetric backlash has none: what "
            "the right map shows is then noise and aliases of higher orders. Grey with a cross: "
            "not identifiable from this sequence.",
            _second_facts(analysis),
        ),
        Plate(
            drawn(
                "figure-9",
                3.1,
                lambda figure: draw_third_kernel(figure, kernels, EXPERIMENT, limit),
                "Cross-section of the third Volterra kernel as surface and map",
            ),
            "Figure 9 of the paper",
            "Cross-section g₃(τ₁, τ₂, τ₃ = 1) of the third Volterra kernel, as the height of its "
            "term in the response. A minus sign marks cells below −10 % of the scale. Grey "
            "with a cross: two lags are alike, not identifiable from this sequence.",
            _third_facts(analysis),
        ),
        Plate(
            drawn(
                "energies",
                1.5,
                lambda figure: draw_energies(figure.subplots(), analysis),
                "Share of the response's variance in each order",
            ),
            "Energy per order",
            "Share of the response's variance in the kernels of each order. In none of these: "
            "orders 5 and above, memory beyond M, and noise.",
            (
                ("odd orders", percent(analysis.odd_percent)),
                ("even order", small_percent(analysis.even_percent)),
            ),
        ),
    ]


def study_plates(study: Study) -> list[Plate]:
    """What the experiment can tell about each element, and orders told apart by amplitudes."""
    plates = [
        Plate(
            drawn(
                "labels",
                2.6,
                lambda figure: draw_labels(figure, study.labels),
                "Which kernel elements are identifiable",
            ),
            "What this sequence can tell",
            "Identifiable: the element itself is measured. Sum only: it is measured together with "
            "others (on one amplitude g₁(i) with A²F(i), the diagonals with lower orders). "
            "Aliased: another element lies on the same shift, and no estimator can split them.",
            tuple((row.name, row.value) for row in label_rows(study)),
        )
    ]
    separated = study.analysis.separated
    if separated is not None:
        amplitudes = ", ".join(f"{DEG * a:.4g}" for a in separated.amplitudes)
        plates.append(
            Plate(
                drawn(
                    "separated",
                    2.2,
                    lambda figure: draw_separated(
                        figure.subplots(), separated, study.analysis.kernels, EXPERIMENT
                    ),
                    "First kernel and folded third kernel, told apart",
                ),
                "Orders told apart by amplitudes",
                f"g₁ and the folded diagonals A³F of the third kernel, each for itself, from the "
                f"amplitudes {amplitudes} deg/s. Bands: ±2 standard errors. Between these "
                f"amplitudes they interpolate; beyond, they do not hold.",
                (("condition of the powers", f"{separated.condition:.3g}"),),
            )
        )
    return plates


def validation_plates(validation: Validation) -> list[Plate]:
    """Figure 10, and the angle error over the whole validation."""
    velocity = validation.velocity
    samples = min(WINDOW_SAMPLES, velocity.measured.size)
    return [
        Plate(
            drawn(
                "figure-10",
                4.0,
                lambda figure: draw_validation(figure, validation),
                "Measured and predicted load velocity and load angle",
            ),
            "Figure 10 of the paper",
            f"Actual output (line) and the output calculated from the kernels of order 1 (x) and "
            f"of orders 1 to 3 (+), on commands that the fit never saw: the first {samples} of "
            f"{velocity.measured.size} samples of the validation.",
            (
                ("VAF fresh, order 1", percent(velocity.vaf_order1_percent)),
                ("VAF fresh, orders 1 to 3", percent(velocity.vaf_order3_percent)),
            ),
        ),
        Plate(
            drawn(
                "angle-error",
                1.9,
                lambda figure: draw_angle_error(figure.subplots(), validation),
                "Error of the predicted load angle over the validation",
            ),
            "Load angle over the whole validation",
            "Predicted less measured load angle. The prediction integrates velocities from the "
            "first measured angle and is never corrected, so its errors add up.",
            (
                ("rms, order 1", quantity(validation.angle_error_order1_rms_rad, DEG, "deg")),
                (
                    "rms, orders 1 to 3",
                    quantity(validation.angle_error_order3_rms_rad, DEG, "deg"),
                ),
            ),
        ),
    ]


def run_plates(analysis: Analysis, recording: Recording) -> list[Plate]:
    """How punctual the run was."""
    quality = analysis.quality
    return [
        Plate(
            drawn(
                "punctuality",
                2.3,
                lambda figure: draw_punctuality(figure, recording, quality),
                "Histograms of lateness and of the interval between asks",
            ),
            "Punctuality",
            "Left: how late the bus loop woke in each slot. Right: how far the time between the "
            "asks (CANopen: the SYNC) of neighbouring slots was off the period. Both axes are "
            "logarithmic; the first bar holds everything below 1 µs.",
        ),
        Plate(
            drawn(
                "timeline",
                2.2,
                lambda figure: draw_timeline(figure.subplots(), recording),
                "Lateness and mishaps over the run",
            ),
            "Timeline",
            "Largest and median lateness over the run, and the slots that were missed or whose "
            "answers were missing or late (their height means nothing).",
            (
                ("missed slots", f"{quality.missed_slots} of {quality.slots}"),
                ("answers late", str(quality.late_answers)),
            ),
        ),
    ]


def _first_facts(analysis: Analysis) -> Facts:
    kernels = analysis.kernels
    peak = int(np.argmax(np.abs(kernels.g1)))
    height = quantity(float(kernels.c1[peak]), DEG, "deg/s")
    return (
        ("peak A g₁", f"{height} at {kernels.lags_s[peak] * 1e3:g} ms"),
        ("sum of g₁ (static gain)", f"{float(kernels.g1.sum()):.4f}"),
        ("scatter", quantity(kernels.scatter, DEG, "deg/s")),
        ("energy share", percent(analysis.energy_percent[0])),
        (
            "memory",
            f"{kernels.memory} samples; {analysis.played.resolvable_memory} can be resolved",
        ),
    )


def _second_facts(analysis: Analysis) -> Facts:
    kernels = analysis.kernels
    return (
        ("energy share", small_percent(analysis.energy_percent[1])),
        ("scatter alone gives", small_percent(scatter_percent(analysis, 2))),
        ("largest 2 A² |g₂|", _largest(2.0 * kernels.amplitude**2 * kernels.g2_matrix)),
        ("largest A |g₁|", quantity(symmetric_limit(kernels.c1), DEG, "deg/s")),
    )


def _third_facts(analysis: Analysis) -> Facts:
    kernels = analysis.kernels
    sections = [kernels.g3_section(k) for k in range(kernels.memory)]
    g3 = 6.0 * kernels.amplitude**3 * np.stack(sections)
    largest = _largest(g3)
    if largest != NONE:
        largest += f" at {_lags(g3)}"
    return (
        ("energy share", small_percent(analysis.energy_percent[2])),
        ("scatter alone gives", small_percent(scatter_percent(analysis, 3))),
        ("largest 6 A³ |g₃|", largest),
        ("elements", f"{_elements(g3)}"),
    )


def _largest(kernel: Array) -> str:
    """Of the elements that were identified, as they are drawn; `NONE` where none was."""
    if not np.isfinite(kernel).any():
        return NONE
    return quantity(symmetric_limit(kernel), DEG, "deg/s")


def _elements(kernel: Array) -> int:
    """How many of a symmetric kernel's elements were identified, each once."""
    places = np.argwhere(np.isfinite(kernel))
    return int(np.count_nonzero(np.all(np.diff(places, axis=1) >= 0, axis=1)))


def _lags(kernel: Array) -> str:
    """Where the third kernel is largest."""
    known = np.nan_to_num(np.abs(kernel))
    place = sorted(int(lag) for lag in np.unravel_index(int(np.argmax(known)), kernel.shape))
    return "τ = " + ", ".join(str(lag) for lag in place)
