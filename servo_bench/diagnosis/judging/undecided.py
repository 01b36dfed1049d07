"""When a recording cannot be diagnosed: a verdict all the same, with words on what would decide it.

What stands here is about data that could be read. A rig that is missing, an effect that does not
exist, recordings that do not go together are the operator's to mend, and raise ConfigError.
"""

from collections.abc import Collection, Iterator, Sequence
from difflib import get_close_matches

import numpy as np

from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ChannelError, ConfigError
from servo_bench.recording.recording import Recording
from sim_rig.effects import catalogue

ANGLES = ("motor_position_rad", "load_angle_rad")
EFFORTS = ("current_a", "motor_torque_nm", "motor_current_a", "torque_nm")
COMMAND = "velocity_command_rad_s"
ENOUGH_S = 10.0
"""Below this, few effects show, and what was held out to judge is short too."""
SLOW_PERIOD_S, LOGGERS = 0.004, 2.0
FULL_TURN = 2.0 * np.pi
SAME_SIZE = 0.02
"""Sizes of a command that differ by less are one."""
RECOMMENDED = (
    "Run what `servo-bench design diagnosis --rig RIG.toml -o EXPERIMENT.toml` writes: several "
    "velocities, full turns, a validation of its own."
)

REPEAT = (
    "Play this run once more as it is: what comes again is the rig's own, what does not is the "
    "measurement's, or comes from outside. Then once with one thing changed: the load, or the size."
)

MEND = (
    "Mend the map or the rig's file, and diagnose this recording again: nothing need be recorded "
    "anew for that."
)


def check_effects(*names: Collection[str]) -> None:
    """ConfigError where a name is in no file of the catalogue, or where nothing is left to try."""
    known = catalogue()
    without, only = (*names, (), ())[:2]
    unknown = sorted({name for group in names for name in group} - set(known))
    if unknown:
        near = [name for one in unknown for name in get_close_matches(one, known, n=1)]
        meant = f" {', '.join(near)} would be one." if near else ""
        raise ConfigError(
            f"no effect is called {', '.join(unknown)}.{meant} The catalogue has "
            f"{', '.join(known)}; `servo-bench effects` explains each."
        )
    if only and not set(only) - set(without):
        raise ConfigError(
            f"--only {', '.join(only)} and --without {', '.join(without)} leave nothing to try. "
            "Leave one of them out."
        )


def check_alike(
    recordings: Sequence[Recording],
    held_out: Recording | None = None,
    *,
    one_period: bool = True,
) -> None:
    """ConfigError where recordings of one diagnosis do not bring the same signals and period.

    Data from elsewhere come as fast as their logger was: each has a clock of its own, and a period
    that is no more than its median (`one_period=False`). Signals are compared over so many rows, so
    one may be twice another.
    """
    most = 1.001 if one_period else LOGGERS
    first = recordings[0]
    for name, other in _others(recordings, held_out):
        mine, theirs = _signals(first), _signals(other)
        if mine != theirs:
            raise ConfigError(
                f"recording 1 has {_listed(mine)} and {name} has {_listed(theirs)}: "
                "signals of one diagnosis are compared alike in all of them. Record the same "
                "channels, or diagnose them one by one."
            )
        slower, faster = sorted((first.period_s, other.period_s), reverse=True)
        if slower > most * faster:
            raise ConfigError(
                f"recording 1 has a period of {first.period_s:g} s and {name} of "
                f"{other.period_s:g} s: give recordings of one period"
                f"{'' if one_period else ', or nearly so'}."
            )


def check_one_rig(recordings: Sequence[Recording], held_out: Recording | None = None) -> None:
    """ConfigError where recordings tell of rigs whose nominal values differ: the model of the first
    one's would be asked to be all of them."""
    first = recordings[0].rig
    for name, other in _others(recordings, held_out):
        if first is None or other.rig is None:
            continue
        mine, theirs = first.nominal.model_dump(), other.rig.nominal.model_dump()
        differ = next((n for n in mine if mine[n] != theirs[n]), None)
        if differ is not None:
            raise ConfigError(
                f"the rig of recording 1 has {differ} = {mine[differ]:g} and that of {name} "
                f"{theirs[differ]:g}: one diagnosis is of one rig. Give recordings of one, or say "
                "with --rig RIG.toml or --model MODEL.toml what is believed of all of them."
            )


def _others(
    recordings: Sequence[Recording], held_out: Recording | None
) -> Iterator[tuple[str, Recording]]:
    """All but the first, each with what an error calls it."""
    for number, other in enumerate(recordings[1:], 2):
        yield f"recording {number}", other
    if held_out is not None:
        yield "the held-out recording", held_out


def _signals(recording: Recording) -> tuple[str, ...]:
    """The channels that count, of which anything came."""
    return _came(recording, COMMAND, *ANGLES, *EFFORTS)


def _came(recording: Recording, *names: str) -> tuple[str, ...]:
    """Those of the channels of which anything came."""
    named = [n for n in names if n in recording]
    return tuple(n for n in named if np.isfinite(np.asarray(recording[n], np.float64)).any())


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "no channel that a diagnosis can use"


def undecided(error: Exception, recordings: Sequence[Recording]) -> Verdict:
    """The verdict "unknown" of data that were read and cannot be judged, in the failure's words."""
    first = recordings[0]
    lacks = tuple(_lacking(recordings))
    is_misread = isinstance(error, ChannelError)
    short = tuple(few_seconds(recordings))
    why = " ".join((lacks[0] if lacks else _sentence(error), *short))
    next_run = f"Record what is missing. {RECOMMENDED}" if lacks else RECOMMENDED
    return Verdict(
        verdict="unknown",
        sentence=f"Nothing can be decided from this recording: "
        f"{_sentence(error) if is_misread else why}",
        undecided=(*lacks, *open_questions(first), *short),
        next_run=MEND if is_misread else next_run,
        notes=(f"The diagnosis ended before any fit: {_sentence(error)}",),
    )


def _sentence(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return text if text.endswith(".") else f"{text}."


def _lacking(recordings: Sequence[Recording]) -> Iterator[str]:
    """What every diagnosis needs, and these recordings have not."""
    first = recordings[0]
    there = _signals(first)
    driving = _came(first, COMMAND, "position_command_rad", *EFFORTS, "voltage_v")
    if not driving:
        yield (
            "Neither a velocity command nor a current, torque or voltage was recorded: what moved "
            "the rig is not known, so no model can be played beside it. Record "
            "velocity_command_rad_s."
        )
    efforts = [name for name in driving if name in (*EFFORTS, "voltage_v")]
    if COMMAND not in driving and efforts and not _changes(recordings, efforts):
        yield (
            f"{_listed(efforts)} never changed while the motor did: what moved it is not known. "
            "Log the channel that holds it, or mend the map."
        )
    if not set(ANGLES) & set(there):
        yield (
            "Neither the motor's nor the load's angle was recorded: there is nothing to compare a "
            "simulation with. Record load_angle_rad, and motor_position_rad where the drive has it."
        )


def few_seconds(recordings: Sequence[Recording]) -> Iterator[str]:
    """What is open because little was recorded, whatever the verdict."""
    duration_s = sum(len(recording) * recording.period_s for recording in recordings)
    if duration_s < ENOUGH_S:
        yield (
            f"No more than {duration_s:.1f} s were recorded: so few tell little, and what is small "
            "or rare was not seen. Record 40 s or more."
        )


def _changes(recordings: Sequence[Recording], names: Sequence[str]) -> bool:
    """Whether any of these took a second value anywhere."""
    there = [one[name] for one in recordings for name in names if name in one]
    every = [np.asarray(values, np.float64) for values in there]
    return any(np.unique(values[np.isfinite(values)]).size > 1 for values in every)


def open_questions(recording: Recording) -> Iterator[str]:
    """What this excitation cannot decide, whatever the rig, and what would."""
    yield from _of_the_excitation(recording)
    if recording.period_s > SLOW_PERIOD_S:
        yield (
            f"At a period of {recording.period_s * 1e3:g} ms short delays and lags in the drive, "
            "below some 0.2 ms, look alike. Command and log at 1 kHz where the drive allows it."
        )


def _of_the_excitation(recording: Recording) -> Iterator[str]:
    """What another excitation would show."""
    if COMMAND in _signals(recording):
        yield from _of_the_command(np.asarray(recording[COMMAND], np.float64))
    if "load_angle_rad" in recording and 0.0 < _travel(recording["load_angle_rad"]) < FULL_TURN:
        yield (
            "The load made less than a full turn: what repeats with its angle (eccentricity, "
            "weight, misalignment) cannot be told from what does not. Add a bias to the excitation."
        )


def _travel(angle: np.ndarray) -> float:
    known = angle[np.isfinite(angle)]
    return float(np.ptp(known)) if known.size else 0.0


def what_next(verdict: Verdict, recording: Recording) -> str:
    """The run that would decide more: that which splits what is named; else one that excites what
    this one did not; else, where nothing explains it, the same once more. Empty for none."""
    if verdict.next_run:
        return verdict.next_run
    if any(_of_the_excitation(recording)):
        return RECOMMENDED
    return REPEAT if verdict.verdict == "unknown" else ""


def without_the_load_s_angle(recording: Recording) -> Iterator[str]:
    """What nothing is known of where that did not come."""
    if not _came(recording, "load_angle_rad"):
        yield (
            "The load's angle did not come: of what is behind the motor (gap, coupling, load) "
            "nothing is known but what the motor feels. Look at the encoder's line; record "
            "load_angle_rad."
        )


def without_the_motor_s_angle(recording: Recording) -> Iterator[str]:
    """What is told apart by less where that did not come, and what would have to be recorded."""
    if _came(recording, "motor_position_rad"):
        return
    also = "its torque and by " if _came(recording, *EFFORTS) else ""
    missing = "angle" if also else "angle and current"
    yield (
        f"Without the motor's {missing}, causes in the motor and in its drive are told apart by "
        f"{also}what reaches the load only."
    )
    if not also:
        yield (
            "The drive's integrator holds whatever torque is constant while the motor turns, so "
            "friction that differs by direction reaches the load where a motion starts, and "
            "hardly after: record the current, or play many starts from rest."
        )
    if _came(recording, "motor_velocity_rad_s"):
        yield (
            "The drive's own speed is filtered as the drive likes, and is compared with nothing: "
            "record its position (motor_position_rad, 0x6064)."
        )


def _of_the_command(command: np.ndarray) -> Iterator[str]:
    known = command[np.isfinite(command)]
    moving = np.abs(known[np.abs(known) > 0.0])
    if not moving.size:
        yield (
            "The command stayed at zero: nothing that needs motion can be decided. Play any "
            "excitation that moves the axis."
        )
        return
    largest = float(moving.max())
    centred = moving
    levels = np.unique(known[known != 0.0])
    if levels.size == 2:
        centre, half = levels.mean(), np.ptp(levels) / 2.0
        centred = np.array([half if half > abs(centre) else largest])
    sizes = np.unique(np.round(centred / (SAME_SIZE * largest)))
    if sizes.size == 1:
        yield (
            "The command has a single size: a deadband looks like a scale, and Coulomb like "
            "viscous friction. Play five levels, or a second amplitude."
        )
    if not np.any((known[1:] == known[:-1]) & (known[1:] != 0.0)):
        yield (
            "No command lasted for two periods: what happens long after a change was not seen. "
            "Hold some commands longer."
        )
