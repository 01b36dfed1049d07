"""The figures of the paper's simulation: 2, 3 and 4, for both readings of its plant."""

import numpy as np

from servo_bench.kernels.paper_simulation import PaperResult, PlantSimulation
from servo_bench.report.kernel_figures import (
    SIMULATION,
    draw_first_kernel,
    draw_third_kernel,
    third_kernel_limit,
)
from servo_bench.report.plates import Plate
from servo_bench.report.prediction_figures import WINDOW_SAMPLES, draw_comparison
from servo_bench.report.style import drawn
from servo_bench.report.wording import percent

PLANTS = {
    "zero": "G(s) with the zero (equation 14)",
    "no_zero": "G(s) without the zero",
}


def paper_plates(result: PaperResult) -> list[Plate]:
    """Figures 2, 3 and 4 of the plant with the zero, then of the one without."""
    return [
        plate
        for key, plant in (("zero", result.zero), ("no_zero", result.no_zero))
        for plate in _plant_plates(key, plant)
    ]


def _plant_plates(key: str, plant: PlantSimulation) -> list[Plate]:
    kernels = plant.kernels
    limit = third_kernel_limit(kernels, SIMULATION)
    figures = plant.numbers()
    samples = min(WINDOW_SAMPLES, plant.period.measured.size)
    time_s = np.arange(samples, dtype=np.float64) * kernels.period_s
    return [
        Plate(
            drawn(
                f"{key}-figure-2",
                2.0,
                lambda figure: draw_first_kernel(figure.subplots(), kernels, SIMULATION),
                "First Volterra kernel over its lags",
            ),
            "Figure 2 of the paper",
            f"First Volterra kernel g₁(τ₁) in the simulation, {PLANTS[key]}. Per sample; divided "
            f"by Δt = {kernels.period_s:g} s it is the kernel in continuous time.",
        ),
        Plate(
            drawn(
                f"{key}-figure-3",
                2.9,
                lambda figure: draw_third_kernel(figure, kernels, SIMULATION, limit),
                "Cross-section of the third Volterra kernel as surface and map",
            ),
            "Figure 3 of the paper",
            f"Cross-section g₃(τ₁, τ₂, τ₃ = 1) of the third Volterra kernel in the simulation, "
            f"{PLANTS[key]}. Grey with a cross: two lags are alike, not identifiable from binary "
            f"input.",
        ),
        Plate(
            drawn(
                f"{key}-figure-4",
                2.2,
                lambda figure: draw_comparison(
                    figure.subplots(), time_s, plant.period, 1.0, ("", "time (s)", "output (1)")
                ),
                "Actual output and the output calculated from the kernels",
            ),
            "Figure 4 of the paper",
            f"Actual output (line) and the output calculated from the kernels of order 1 (x) and "
            f"of orders 1 to 3 (+), {PLANTS[key]}: the first {samples} samples of the "
            f"identification period itself, as in the paper. The fresh figures are the ones that "
            f"count.",
            (
                ("VAF fresh, order 1", percent(figures["order1_fresh"])),
                ("VAF fresh, orders 1 to 3", percent(figures["order3_fresh"])),
                ("VAF same period, orders 1 to 3", percent(figures["order3_same"])),
            ),
        ),
    ]
