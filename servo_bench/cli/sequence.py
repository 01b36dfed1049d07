"""`servo-bench sequence …`: choose what to play, and see what it can tell."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json
from servo_bench.excitation.amplitude import MARGIN, advise_amplitude
from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.msequence import m_sequence
from servo_bench.excitation.search import SequenceSearch
from servo_bench.excitation.search import search as search_polynomials
from servo_bench.kernels.slices import Slice, described, sequence_slices
from servo_bench.rig import load_rig

COLUMNS = 64
SHADES = " .:+*#"
"""From no element in a column of shifts to the most that any column holds."""

LEAD_IN = int(Experiment.model_fields["lead_in"].default)
"""Chips of an experiment that says nothing of it."""

app = typer.Typer(no_args_is_help=True, help="Choose an M-sequence, and see what it can tell.")
Json = Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")]
MOST_MEMORY = 100
"""Slices of order 3 are M^3/6."""
InverseRepeat = Annotated[
    bool, typer.Option("--inverse-repeat", help="Played as u, -u: odd and even orders apart.")
]


@app.command()
def search(
    *,
    degree: Annotated[int, typer.Option(help="Degree n: periods of 2^n - 1 chips.")],
    memory: Annotated[int, typer.Option(help="Memory of the kernels in samples.")],
    order: Annotated[int, typer.Option(help="Highest order of the kernels, 2 or 3.")] = 3,
    inverse_repeat: InverseRepeat = False,
    json: Json = None,
) -> None:
    """Every primitive polynomial of a degree, judged for kernels of that memory and order."""
    check_outputs(json)
    found = search_polynomials(degree, memory, order, inverse_repeat=inverse_repeat)
    if json is not None:
        write_json(json, asdict(found))
    _show_search(found)


@app.command()
def show(
    polynomial: Annotated[str, typer.Argument(help="Octal, highest power first, as in 15341.")],
    *,
    memory: Annotated[
        int, typer.Option(min=1, max=MOST_MEMORY, help="Memory of the kernels in samples.")
    ] = 18,
    order: Annotated[int, typer.Option(min=1, max=3, help="Highest order of the kernels.")] = 3,
    inverse_repeat: InverseRepeat = False,
    json: Json = None,
) -> None:
    """Where the kernels' slices lie in the correlation, and what the sequence can identify."""
    check_outputs(json)
    slices = sequence_slices(polynomial, memory, order)
    sentences = described(polynomial, memory, order, inverse_repeat=inverse_repeat)
    if json is not None:
        write_json(
            json,
            {
                "polynomial": polynomial,
                "memory": memory,
                "order": order,
                "slices": [asdict(part) for part in slices],
                "sentences": sentences,
            },
        )
    _draw(slices, m_sequence(polynomial).size)
    for sentence in sentences:
        Console().print(sentence, highlight=False)


@app.command()
def amplitude(
    polynomial: Annotated[str, typer.Argument(help="Octal, highest power first, as in 40473.")],
    *,
    rig: Annotated[str, typer.Option(help="Rig file: its gap, loop, and limits are used.")],
    period_s: Annotated[float, typer.Option(help="Period of the chips.")] = 0.008,
    json: Json = None,
) -> None:
    """The range of velocities that shows a rig's backlash within its limits.

    What travels is the period and the usual lead-in; of the travel limit 5 % are kept.
    """
    check_outputs(json)
    loaded = load_rig(rig)
    nominal, limits = loaded.nominal, loaded.limits
    bandwidth = np.sqrt(
        nominal.integral_gain_a_per_rad * nominal.torque_constant_nm_per_a / nominal.inertia_kg_m2
    )
    chips = m_sequence(polynomial).astype(np.int64)
    led_in = np.concatenate([np.resize(chips[::-1], LEAD_IN)[::-1], chips])
    travel = np.abs(np.cumsum(led_in)).max()
    advice = advise_amplitude(
        backlash_gap_rad=nominal.backlash_gap_rad,
        period_s=period_s,
        bandwidth_rad_s=float(bandwidth),
        peak_travel_periods=float(travel),
        travel_limit_rad=MARGIN * limits.travel_rad,
        velocity_limit_rad_s=limits.velocity_rad_s,
    )
    if json is not None:
        write_json(json, {**asdict(advice), "recommended_rad_s": advice.recommended_rad_s})
    console = Console()
    for sentence in advice.sentences:
        console.print(sentence, highlight=False)
    console.print(
        f"[bold]Recommended: {np.degrees(advice.recommended_rad_s):.3g} deg/s.[/] An ideal axis "
        f"then travels at most {np.degrees(advice.recommended_rad_s * travel * period_s):.3g} deg "
        f"from its start (limit {np.degrees(limits.travel_rad):.3g} deg).",
        highlight=False,
    )


def _show_search(found: SequenceSearch) -> None:
    console = Console()
    kind = " as inverse-repeat sequence" if found.inverse_repeat else ""
    console.print(
        f"{found.primitives} primitive polynomials of degree {found.degree} "
        f"({found.chips} chips){kind}; {found.reaching} keep kernels up to order {found.order} "
        f"apart in a memory of {found.memory}. The best reaches {found.largest_memory}, the median "
        f"{found.median_memory:g}.",
        highlight=False,
    )
    table = Table("polynomial (octal)", show_edge=False, pad_edge=False)
    for name in ("memory, order 2", "order 3", "inverse repeat", "alias of orders 5 and 7"):
        table.add_column(name, justify="right")
    for candidate in found.candidates:
        table.add_row(
            candidate.polynomial,
            str(candidate.memory_order2),
            str(candidate.memory_order3),
            str(candidate.memory_inverse_repeat),
            f"{candidate.alias_percent:.2f} %",
        )
    console.print(table)
    console.print(
        f"[bold]Recommended: {found.recommended.polynomial}[/] "
        f"(see it with: servo-bench sequence show {found.recommended.polynomial} "
        f"--memory {found.memory} --order {found.order}"
        f"{' --inverse-repeat' if found.inverse_repeat else ''})",
        highlight=False,
    )


def _draw(slices: tuple[Slice, ...], chips: int) -> None:
    console = Console()
    for order in (1, 2, 3):
        parts = [part for part in slices if part.order == order]
        if parts:
            counts = _column_counts(parts, chips)
            scale = (len(SHADES) - 1) / max(int(counts.max()), 1)
            line = "".join(SHADES[int(np.ceil(count * scale))] for count in counts.tolist())
            console.print(f"order {order} |{line}|", markup=False, highlight=False)
    console.print(f"shift    0{'':{COLUMNS - len(str(chips))}}{chips}", highlight=False)


def _column_counts(parts: list[Slice], chips: int) -> NDArray[np.int64]:
    shifts = np.concatenate([(part.first_shift + np.arange(part.length)) % chips for part in parts])
    return np.bincount(shifts * COLUMNS // chips, minlength=COLUMNS).astype(np.int64)
