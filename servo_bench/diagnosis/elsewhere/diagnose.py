"""`diagnose_open`: recordings from elsewhere in, verdict out; `judge_open` with its picture."""

import time
from collections.abc import Collection, Sequence
from typing import NamedTuple

from servo_bench.diagnosis.elsewhere.locked import judge_locked
from servo_bench.diagnosis.elsewhere.locked_verdict import locked_verdict
from servo_bench.diagnosis.elsewhere.looped import judge_looped
from servo_bench.diagnosis.elsewhere.looped_verdict import looped_verdict
from servo_bench.diagnosis.elsewhere.mechanics import judge_mechanics
from servo_bench.diagnosis.elsewhere.mechanics_verdict import mechanics_verdict
from servo_bench.diagnosis.elsewhere.shown import Shown
from servo_bench.diagnosis.fitting.foreign_channels import can_be_looped, kind_of
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.recording import Recording


class JudgedOpen(NamedTuple):
    """The verdict, and what its picture shows."""

    verdict: Verdict
    shown: Shown


def diagnose_open(
    recordings: Sequence[Recording],
    *,
    held_out: Recording | None = None,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Verdict:
    """The verdict of `judge_open`."""
    return judge_open(recordings, held_out=held_out, without=without, only=only).verdict


def judge_open(
    recordings: Sequence[Recording],
    *,
    held_out: Recording | None = None,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> JudgedOpen:
    """What a plain motor (or, with a locked output, a plain spring) gets wrong about these data.

    `without` takes effects out of the catalogue, `only` leaves nothing but these. Gains are
    measured on `held_out`, else on parts that the fit did not see. Raises FitError where the
    channels do not suffice, ConfigError where the recordings are not alike.
    """
    if not recordings:
        raise ConfigError("no recording was given: give at least one to diagnose.")
    began = time.perf_counter()
    kinds = {kind_of(one) for one in (*recordings, *((held_out,) if held_out else ()))}
    if len(kinds) > 1:
        raise ConfigError(
            "some recordings have a locked output or lack an effort, and others do not: diagnose "
            "alike ones together."
        )
    if kinds == {"locked"}:
        if len(recordings) > 1:
            raise ConfigError(
                f"{len(recordings)} recordings of a locked output: every one is a specimen of its "
                "own. Give one, with its runs in it."
            )
        locked = judge_locked(recordings[0], held_out)
        verdict = locked_verdict(locked, without, only)
        shown = locked.shown
    elif all(can_be_looped(one) for one in (*recordings, *((held_out,) if held_out else ()))):
        looped = judge_looped(recordings, held_out, without=without, only=only)
        verdict, shown = looped_verdict(looped), looped.shown
    elif kinds == {"mechanics"}:
        finding = judge_mechanics(recordings, held_out, without=without, only=only)
        verdict, shown = mechanics_verdict(finding), finding.shown
    else:
        raise FitError(
            "neither an effort with its motion, nor a position loop of known gain, nor a locked "
            f"output is among {', '.join(sorted(recordings[0].channels))}. Map a current, torque "
            "or voltage, and the motor's position or velocity."
        )
    told = _sober(Verdict(**{**dict(verdict), "seconds": time.perf_counter() - began}))
    return JudgedOpen(told, shown)


def _sober(verdict: Verdict) -> Verdict:
    """The verdict, unless what it names makes the error on unseen data larger."""
    error = verdict.error
    if verdict.verdict != "named" or error is None or error.after < error.before:
        return verdict
    tried = " and ".join(verdict.names)
    numbers = verdict.model_copy(
        update={
            "verdict": "unknown",
            "causes": (),
            "limit": (),
            "sentence": (
                "Something is missing from a plain motor, and no effect of the catalogue mends it "
                f"on data that no fit saw: with {tried} the error there grows from "
                f"{error.before:.3g} to {error.after:.3g} {error.unit}."
            ),
        }
    )
    return Verdict(**dict(numbers))
