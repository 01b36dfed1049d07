"""The verdict on a motor that a position loop holds, in words and in the public schema."""

from collections.abc import Iterator

import numpy as np

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.explained import PLAYED, share_explained
from servo_bench.diagnosis.elsewhere.looped import LoopedFinding
from servo_bench.diagnosis.judging.causes import carried_cause, cause_of
from servo_bench.diagnosis.judging.intervals import quantities
from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Verdict

CHECK = (
    "Play it once more with nothing that touches the shaft, and look whether the motion comes "
    "again: else something turns it that was not recorded, or the goal or the loop's gain is "
    "another's."
)


def looped_verdict(found: LoopedFinding) -> Verdict:
    """Named causes with sizes; none where inertia, torque and drag are all that pays, unknown where
    they do not explain the motion."""
    causes = tuple(_causes(found))
    explainable = found.before**2 - found.floor**2
    share = (found.before**2 - found.after**2) / explainable if explainable > 0.0 else 0.0
    error = ErrorFigures(
        before=found.before,
        after=found.after if causes else found.before,
        noise_floor=found.floor,
        share_explained=float(np.clip(share, 0.0, 1.0)) if causes else 0.0,
        signal="motor angle",
        unit="rad",
    )
    model = found.final.model if causes else found.plain.model
    named = {c.effect for c in causes}
    values = zip(found.final.unknowns, found.final.values, strict=True)
    lost = not causes and _is_lost(found)
    split = next((c.splitting_experiment for c in causes if c.splitting_experiment), "")
    return Verdict(
        verdict="named" if causes else "unknown" if lost else "none",
        sentence=_of_the_rest(found) if lost else _sentence(causes, error),
        causes=causes,
        error=error,
        notes=tuple(_notes(found)),
        next_run=CHECK if lost else split,
        nominal={n: float(getattr(model.nominal, n)) for n in model.nominal.__dataclass_fields__},
        effects={name: dict(table) for name, table in model.to_table().items() if table},
        nuisances={u.name: float(v) for u, v in values if u.effect not in named},
    )


def _causes(found: LoopedFinding) -> Iterator[Cause]:
    """With the confidence of data from elsewhere: stated, not calibrated."""
    numbers = quantities(found.final, found.scales)
    there = frozenset(n.effect for n in found.named)
    told = [cause_of(one, numbers, there) for one in found.named]
    told += [carried_cause(effect, z, numbers) for effect, z in found.missed_z.items()]
    for cause in told:
        over = gate.SECURE_Z if cause.over_rival is None else cause.over_rival
        sure = gate.confidence(cause.evidence or 0.0, over)
        yield cause.model_copy(update={"confidence": sure})


def _notes(found: LoopedFinding) -> Iterator[str]:
    yield (
        "The position loop was played whole, with the gains of the map; torques are on the scale "
        f"of the inertia, {found.final.model.nominal.inertia_kg_m2:.3g} kg m2."
    )
    if found.left_out:
        yield (
            f"{found.left_out} recordings were left out: their power stage was off for a part, and "
            "what a motor does then is not commanded."
        )


def _is_lost(found: LoopedFinding) -> bool:
    """Whether the plain motor does not explain the motion, and more is left than noise."""
    explained = share_explained(found.before, found.there)
    return explained < PLAYED and found.before > gate.QUIET * found.floor


def _of_the_rest(found: LoopedFinding) -> str:
    return (
        "Neither inertia, torque and viscous drag nor any effect of the catalogue explains the "
        f"motion: of an angle of {found.there:.3g} rad (rms) on data that no fit saw "
        f"{found.before:.3g} rad are left."
    )


def _sentence(causes: tuple[Cause, ...], error: ErrorFigures) -> str:
    if not causes:
        return (
            "Nothing pays: inertia, torque and viscous drag play the loop as well as any effect of "
            f"the catalogue does ({error.before:.3g} {error.unit} on data that no fit saw)."
        )
    names = ", ".join(c.effect.replace("_", " ") for c in causes)
    return (
        f"The plain motor lacks {names}: its error on data that no fit saw falls from "
        f"{error.before:.3g} to {error.after:.3g} {error.unit}."
    )
