"""Which kernel elements an experiment can identify, as maps."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from servo_bench.kernels.labels import ElementLabels, Label
from servo_bench.report.kernel_figures import TAU_3
from servo_bench.report.style import ACTUAL, ALARM, ORDER_3, UNKNOWN, caption_axes

COLOURS = {Label.IDENTIFIABLE: ORDER_3, Label.SUM_ONLY: UNKNOWN, Label.ALIASED: ALARM}
WORDS = {
    Label.IDENTIFIABLE: "identifiable",
    Label.SUM_ONLY: "sum only",
    Label.ALIASED: "aliased (×)",
}


def draw_labels(figure: Figure, labels: ElementLabels) -> None:
    """g1 as a line of cells, g2, and the section of g3 that is shown."""
    memory = labels.order1.size
    axes = figure.subplots(1, 3)
    section = min(TAU_3, memory - 1)
    for each, cells, title in (
        (axes[0], labels.order1[None, :], "g₁"),
        (axes[1], labels.order2, "g₂"),
        (axes[2], labels.order3[:, :, section], f"g₃, τ₃ = {section}"),
    ):
        _cells(each, cells, title)
    axes[0].set_yticks([])
    axes[0].set_ylabel("")
    figure.legend(
        handles=[Patch(color=COLOURS[label], label=WORDS[label]) for label in Label],
        loc="outside lower center",
        ncols=3,
    )


def _cells(axes: Axes, cells: NDArray[np.int8], title: str) -> None:
    axes.grid(visible=False)
    axes.imshow(
        cells,
        origin="lower",
        interpolation="none",
        cmap=ListedColormap([COLOURS[label] for label in Label]),
        vmin=-0.5,
        vmax=len(Label) - 0.5,
        aspect="auto" if cells.shape[0] == 1 else "equal",
    )
    row, column = np.nonzero(cells == Label.ALIASED)
    axes.plot(column, row, linestyle="", marker="x", markersize=2.5, color=ACTUAL)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    caption_axes(axes, title, "τ₁ (samples)", "τ₂ (samples)")
