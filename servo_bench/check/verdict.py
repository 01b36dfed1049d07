"""The diagnosis, called in one place: what the simulation of a rig gets wrong."""

from collections.abc import Sequence

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.recording.recording import Recording
from sim_rig.model import Model


def verdict_of(
    recordings: Sequence[Recording],
    *,
    model: Model | None = None,
    held_out: Recording | None = None,
) -> Verdict:
    """Diagnose recordings of one rig against its model, by default the rig's own.

    Data that cannot be judged are "unknown", and the verdict says why; ConfigError where they do
    not go together, or judge what was fitted to them.
    """
    return conclude(recordings, model=model, held_out=held_out).verdict


def words_of(verdict: Verdict) -> tuple[str, ...]:
    """The names of the causes, or "none", or "unknown"."""
    if verdict.verdict == "named":
        return tuple(cause.effect for cause in verdict.causes)
    return (verdict.verdict,)
