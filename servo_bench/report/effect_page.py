"""One effect on one page: its file's words, and its computed signature; HTML or PNG."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from servo_bench.diagnosis.judging.domains import Domains
from servo_bench.diagnosis.judging.signature import CHANNELS, Rival, Signature
from servo_bench.report.effect_figures import draw_domains, draw_judgement, draw_window
from servo_bench.report.effect_words import (
    docstring,
    kind_of,
    place_of,
    range_of,
    sample_words,
)
from servo_bench.report.html import rendered
from servo_bench.report.plates import Plate
from servo_bench.report.style import STYLE, WIDTH_IN, drawn
from sim_rig.effects.effect import Effect

WINDOW_IN, DOMAINS_IN = 3.0, 2.1
DOTS_PER_INCH = 160


def effect_html(
    effect: Effect, signature: Signature, found: Domains, alike: Sequence[Rival]
) -> str:
    """The page, self-contained."""
    return rendered(
        "effect.html.j2",
        name=effect.name,
        summary=effect.summary,
        text=docstring(effect),
        place=place_of(effect),
        shows=effect.shows,
        confused_with=", ".join(effect.confused_with),
        source=effect.source,
        parameters=[(p.name, p.default, range_of(p), kind_of(p.prior)) for p in effect.parameters],
        plates=_plates(effect, signature, found, alike),
        shares=list(found.shares.items()),
        rivals=alike,
        channels=CHANNELS,
    )


def _plates(
    effect: Effect, signature: Signature, found: Domains, alike: Sequence[Rival]
) -> list[Plate]:
    return [
        Plate(
            drawn(
                "window",
                WINDOW_IN,
                lambda figure: draw_window(figure, signature),
                f"Residuals of {effect.name} over time",
            ),
            "When it shows",
            "Simulated with the effect less simulated without, in the 0.4 s in which the load's "
            f"velocity is most in error. Drawn for {sample_words(effect)}.",
        ),
        Plate(
            drawn(
                "domains",
                DOMAINS_IN,
                lambda figure: draw_domains(figure, signature, found),
                f"Residuals of {effect.name} by velocity, by position, and after an edge",
            ),
            "Where it shows",
            "All 33 s. By velocity: mean and scatter in bins. By position: the share of the "
            "variance in a line of that order, as it is, times the direction of turning, or times "
            "the current, whichever is strongest. After an edge: mean change in its direction.",
        ),
        Plate(
            drawn(
                "judgement",
                judgement_height_in(alike),
                lambda figure: draw_judgement(figure, found, alike),
                f"What explains the residuals of {effect.name}, and what looks like them",
            ),
            "What it is told by",
            "Left: the share of the variance that each domain alone explains. Right: the cosine "
            "between this effect's residual and those of others, all 33 s, nothing projected out, "
            "the encoder's zero and the other's phase free; a star: declared in the effect's "
            "file, the others are the likest of the catalogue; bar: the largest.",
        ),
    ]


def judgement_height_in(alike: Sequence[Rival]) -> float:
    """Room for every row."""
    return max(2.0, 0.75 + 0.19 * len(alike))


def effect_png(
    effect: Effect, signature: Signature, found: Domains, alike: Sequence[Rival]
) -> bytes:
    """The three figures, one under another, on white."""
    heights = (WINDOW_IN, DOMAINS_IN, judgement_height_in(alike))
    style: dict[Any, Any] = {**STYLE, "savefig.facecolor": "white"}
    with mpl.rc_context(style):
        figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.3), layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(f"{effect.summary}\n{sample_words(effect)}", fontsize=9, x=0.01, ha="left")
        grid = figure.add_gridspec(3, 1, height_ratios=heights)
        draw_window(figure.add_subfigure(grid[0]), signature)
        draw_domains(figure.add_subfigure(grid[1]), signature, found)
        draw_judgement(figure.add_subfigure(grid[2]), found, alike)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()
