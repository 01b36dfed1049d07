"""The figures of a campaign, from its lines alone.

Shares come as {"of", "share", "interval"}, the interval after Clopper and Pearson (95 %).
Calibration is over every cause that any verdict named, in trials of all kinds: its confidence, and
whether it was right (a companion, or a nuisance no larger than it is, is right).
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import binomtest

from tests.trials.parameters import LAX, WITHOUT

Line = Mapping[str, Any]

BINS = 10
LAX_ERROR, STRICT_ERROR = 0.10, 0.03


def figures(lines: Sequence[Line]) -> dict[str, Any]:
    """Everything that a campaign reports; groups without a trial are left out."""
    found: dict[str, Any] = {"trials": len(lines), "failed": _failures(lines)}
    for channels in ("all", "load"):
        group = [line for line in lines if line["question"]["channels"] == channels]
        if group:
            found[channels] = _of_channels(group)
    return found | {"cost": _cost(lines)}


def _of_channels(lines: Sequence[Line]) -> dict[str, Any]:
    of = _by_kind(lines)
    ranged = [line for line in of["one"] if line["question"]["multiple"] is None]
    found: dict[str, Any] = {"confusion": confusion(lines)}
    if ranged:
        found["one"] = {
            "top_1": share(line["score"]["right"] for line in ranged),
            "in_ambiguity_set": share(line["score"]["in_set"] for line in ranged),
            "nothing_spurious": share(line["score"]["spurious"] == 0 for line in ranged),
            "effects": _effects(ranged),
        }
    sized = [line for line in of["one"] if line["question"]["multiple"] is not None]
    if sized:
        found["multiples_of_the_limit"] = _multiples(sized)
    if of["none"]:
        found["none"] = _nulls(of["none"])
    for kind in ("outside", "removed"):
        if of[kind]:
            found[kind] = _unknowns(of[kind])
    if of["pair"]:
        found["pair"] = {
            "both_named": share(line["score"]["found"] == 2 for line in of["pair"]),
            "one_named": share(line["score"]["found"] >= 1 for line in of["pair"]),
            "nothing_spurious": share(line["score"]["spurious"] == 0 for line in of["pair"]),
        }
    found["parameters"] = parameters(lines)
    found["gain"] = gains(lines)
    found["confidence"] = calibration(stated(lines))
    return found


def share(outcomes: Iterable[bool]) -> dict[str, Any]:
    """How many of how many, the share, and its interval after Clopper and Pearson."""
    counted = [bool(outcome) for outcome in outcomes]
    if not counted:
        return {"of": 0, "share": None, "interval": None}
    hits = sum(counted)
    interval = binomtest(hits, len(counted)).proportion_ci(0.95, method="exact")
    return {
        "of": len(counted),
        "share": hits / len(counted),
        "interval": [float(interval.low), float(interval.high)],
    }


def confusion(lines: Sequence[Line]) -> dict[str, dict[str, int]]:
    """True cause (or kind) and what was named first, counted; pairs are left out."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for line in lines:
        if line["question"]["kind"] != "pair":
            counts[row_of(line)][line["score"]["top"]] += 1
    return {row: dict(counts[row].most_common()) for row in sorted(counts)}


def row_of(line: Line) -> str:
    """The row of the confusion matrix."""
    kind, causes = line["question"]["kind"], line["hidden"]["causes"]
    if kind == "none":
        return "(none)"
    return str(causes[0]) if kind == "one" else f"({kind}) {causes[0]}"


def _by_kind(lines: Sequence[Line]) -> dict[str, list[Line]]:
    kinds: dict[str, list[Line]] = {k: [] for k in ("one", "none", "outside", "pair", "removed")}
    for line in lines:
        kinds[line["question"]["kind"]].append(line)
    return kinds


def _effects(lines: Sequence[Line]) -> dict[str, Any]:
    grouped: defaultdict[str, list[Line]] = defaultdict(list)
    for line in lines:
        grouped[line["hidden"]["causes"][0]].append(line)
    return {
        name: {
            "trials": len(group),
            "top_1": _mean(line["score"]["right"] for line in group),
            "in_ambiguity_set": _mean(line["score"]["in_set"] for line in group),
        }
        for name, group in sorted(grouped.items())
    }


def _multiples(lines: Sequence[Line]) -> dict[str, Any]:
    """For each multiple the share named right, over all and by effect."""
    grouped: defaultdict[float, list[Line]] = defaultdict(list)
    for line in lines:
        grouped[line["question"]["multiple"]].append(line)
    return {
        f"{multiple:g}": {
            "top_1": share(line["score"]["right"] for line in group),
            "effects": {n: e["top_1"] for n, e in _effects(group).items()},
        }
        for multiple, group in sorted(grouped.items())
    }


def _nulls(lines: Sequence[Line]) -> dict[str, Any]:
    """A name on a null is a false alarm, whatever its size; beside it, those that were untrue."""
    return {
        "false_alarms": share(line["score"]["verdict"] == "named" for line in lines),
        "false_alarms_without_nuisances_named": share(
            line["score"]["spurious"] > 0 for line in lines
        ),
        "unknown": share(line["score"]["verdict"] == "unknown" for line in lines),
        "named": dict(Counter(n["effect"] for line in lines for n in line["score"]["named"])),
    }


def _unknowns(lines: Sequence[Line]) -> dict[str, Any]:
    kinds: defaultdict[str, list[bool]] = defaultdict(list)
    for line in lines:
        kinds[line["hidden"]["causes"][0]].append(line["score"]["right"])
    return {
        "unknown": share(line["score"]["verdict"] == "unknown" for line in lines),
        "wrong_name": share(line["score"]["verdict"] == "named" for line in lines),
        "none": share(line["score"]["verdict"] == "none" for line in lines),
        "kinds": {name: _mean(right) for name, right in sorted(kinds.items())},
    }


def parameters(lines: Sequence[Line]) -> dict[str, Any]:
    """Relative errors (median for each cause and parameter) and the intervals' coverage."""
    grouped: defaultdict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for line in lines:
        for one in line["score"]["measured"]:
            grouped[one["cause"], f"{one['effect']}.{one['parameter']}"].append(one)
    every = [one for group in grouped.values() for one in group]
    lax = [one["relative_error"] for one in every if one["cause"] in LAX]
    strict = [one["relative_error"] for one in every if one["cause"] not in LAX]
    return {
        "median_error": median(strict) if strict else None,
        "median_error_of_contact_compliance_lag": median(lax) if lax else None,
        "coverage": share(one["covered"] for one in every),
        "causes": {
            f"{cause}: {parameter}": {
                "of": len(group),
                "median_error": median(one["relative_error"] for one in group),
                "allowed": LAX_ERROR if cause in LAX else STRICT_ERROR,
                "coverage": _mean(one["covered"] for one in group),
            }
            for (cause, parameter), group in sorted(grouped.items())
        },
        "without_a_counterpart": dict(WITHOUT),
    }


def gains(lines: Sequence[Line]) -> dict[str, Any]:
    """Held-out error: before over after, share explained, and after over the true model's."""
    named = [line["score"]["gain"] for line in lines if line["score"]["verdict"] == "named"]
    found = [gain for gain in named if gain is not None]
    factors = [gain["before"] / gain["after"] for gain in found if gain["after"] > 0.0]
    forced = [gain["after"] / gain["forced"] for gain in found if gain["forced"] not in {None, 0.0}]
    return {
        "of": len(found),
        "median_factor": median(factors) if factors else None,
        "median_share_explained": _median(gain["share_explained"] for gain in found),
        "share_explained": _explained(lines),
        "after_over_true_model": {
            "of": len(forced),
            "median": median(forced) if forced else None,
            "how": "the diagnosis with the true causes forced, fitted to the same recording",
        },
    }


def _explained(lines: Sequence[Line]) -> dict[str, float]:
    """For each cause that was hidden alone, the median share of the explainable error removed."""
    grouped: defaultdict[str, list[float]] = defaultdict(list)
    for line in lines:
        gain = line["score"]["gain"]
        if line["question"]["kind"] == "one" and gain is not None:
            grouped[line["hidden"]["causes"][0]].append(gain["share_explained"])
    return {name: median(shares) for name, shares in sorted(grouped.items())}


def stated(lines: Sequence[Line]) -> list[tuple[float, bool]]:
    """Every stated confidence, and whether its name was right."""
    return [
        (float(named["confidence"]), named["worth"] != "wrong")
        for line in lines
        for named in line["score"]["named"]
    ]


def calibration(pairs: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Calibration curve, expected calibration error, Brier score, and the best constant's.

    ECE: the mean over stated confidences of |share right - mean confidence| of their bin, of ten
    equal ones. The best constant confidence is the share right itself, p, and scores p (1 - p).
    """
    if not pairs:
        return {
            "of": 0,
            "ece": None,
            "brier": None,
            "brier_of_the_best_constant": None,
            "curve": [],
        }
    confidence = np.array([c for c, _ in pairs])
    right = np.array([float(r) for _, r in pairs])
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    curve = [
        {
            "of": int((bins == k).sum()),
            "confidence": float(confidence[bins == k].mean()),
            "right": float(right[bins == k].mean()),
        }
        for k in range(BINS)
        if (bins == k).any()
    ]
    off = sum(b["of"] * abs(b["confidence"] - b["right"]) for b in curve) / len(pairs)
    constant = float(right.mean())
    return {
        "of": len(pairs),
        "ece": off,
        "brier": float(((confidence - right) ** 2).mean()),
        "brier_of_the_best_constant": constant * (1.0 - constant),
        "curve": curve,
    }


def _cost(lines: Sequence[Line]) -> dict[str, Any]:
    if not lines:
        return {}
    wall = [line["wall_s"] for line in lines]
    return {
        "median_wall_s": median(wall),
        "longest_wall_s": max(wall),
        "median_cpu_s": median(line["cpu_s"] for line in lines),
        "largest_memory_mib": max(line["peak_bytes"] for line in lines) / 2**20,
    }


def _failures(lines: Sequence[Line]) -> dict[str, Any]:
    texts = [line["failure"] for line in lines if line["failure"]]
    return {"of": len(texts), "said": sorted(set(texts))[:5]}


def _mean(values: Iterable[bool]) -> float:
    counted = [float(value) for value in values]
    return sum(counted) / len(counted) if counted else math.nan


def _median(values: Iterable[float]) -> float | None:
    known = list(values)
    return median(known) if known else None
