"""One look for all figures, and the way from a matplotlib figure to inline SVG.

Figures are `matplotlib.figure.Figure` objects drawn by Agg and written as SVG with their text kept
as text, so that it can be searched, scales with the page, and takes the page's typeface. No pyplot.
Every series differs from the others in marker, dash or lightness, so that it survives a grey print.
"""

import io
import re
from collections.abc import Callable, Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

WIDTH_IN = 6.85
"""The text width of an A4 page with 18 mm margins."""

ACTUAL = "#111111"
ORDER_1 = "#c2570c"
ORDER_3 = "#0b5394"
MUTED = "#7a7a7a"
BAND = "#d5d5d5"
UNKNOWN = "#bdbdbd"
ALARM = "#b00020"
SIGNED_MAP = LinearSegmentedColormap.from_list(
    "signed", ["#08306b", "#4a86c5", "#ffffff", "#e08a3c", "#7f2f00"]
)
"""White is nothing; negative cells of a map carry a minus sign, so that grey prints tell it."""

STYLE: Mapping[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "servo-bench",
    "font.family": ["DejaVu Sans"],
    "font.size": 8.5,
    "text.parse_math": False,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#444444",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
}

_ID = re.compile(r' id="([^"]+)"')
_REFERENCE = re.compile(r'("#|\burl\(#)([^")]+)')
_PROLOGUE = re.compile(r"^.*?(?=<svg)", re.DOTALL)
_ABSENT = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def drawn(name: str, height_in: float, draw: Callable[[Figure], object], title: str) -> Markup:
    """What `draw` puts on a figure of the page's width, as SVG markup to be set inline.

    `name` is unique on its page: ids of inline SVGs share one space, so each carries it. `title`
    is read out by screen readers.
    """
    with mpl.rc_context(dict(STYLE)):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata=_ABSENT)
    text = _PROLOGUE.sub("", buffer.getvalue(), count=1)
    text = _with_own_ids(text.removeprefix("<svg "), name)
    label = Markup('<svg role="img" aria-label="{}" ').format(title)
    return label + Markup(text)  # noqa: S704 - matplotlib escapes its text


def _with_own_ids(svg: str, name: str) -> str:
    """The ids that something refers to prefixed with `name`, the others (not all unique) gone."""
    referred = {found[2] for found in _REFERENCE.finditer(svg)}
    kept = _ID.sub(lambda m: f' id="{name}-{m[1]}"' if m[1] in referred else "", svg)
    return _REFERENCE.sub(rf"\g<1>{name}-\g<2>", kept)


def caption_axes(axes: Axes, title: str, x: str, y: str) -> None:
    """Title and labels; a label says quantity and unit."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def symmetric_limit(values: NDArray[np.float64]) -> float:
    """The largest finite magnitude, for a scale that is alike to both sides; 1 without any."""
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) or 1.0
