"""Causes that cannot be told apart on given channels, and what would split them.

Fixed before any campaign, by argument and not by what a detector happens to confuse:

    torque_constant_error, inertia_error    the motion shows K_T/J only; a drive's torque is K_T i
    asymmetric_friction, load_torque        the same torque while the shaft turns

Others that a record cannot tell apart are found for that record, as near rivals (`judgement`).
"""

from collections.abc import Iterable

AT_REST = frozenset({"asymmetric_friction", "load_torque"})
"""A class whose members differ where the shaft rests or turns back: the one that fits all of a
recording better is told first."""
CLASSES: tuple[frozenset[str], ...] = (
    frozenset({"torque_constant_error", "inertia_error"}),
    AT_REST,
)
SPLITS: dict[frozenset[str], str] = {
    frozenset({"torque_constant_error", "inertia_error"}): (
        "Hang a known weight on an arm, or add a disc of known inertia, and record once more: the "
        "motion alone shows K_T/J only."
    ),
    frozenset({"asymmetric_friction", "load_torque"}): (
        "Record a dwell at zero speed with the drive enabled, 2 s from either side: a load torque "
        "must be held, a friction takes what comes."
    ),
    frozenset({"cogging", "torque_ripple"}): (
        "Turn slowly at constant speed with and without load: cogging stays, ripple follows the "
        "current."
    ),
    frozenset({"coulomb", "viscous"}): (
        "Play the same sequence at a third of the amplitude: Coulomb friction stays, viscous "
        "friction shrinks with the speed."
    ),
    frozenset({"coulomb", "stribeck"}): (
        "Ramp slowly through zero, 0.02 to 2 rad/s: the Stribeck part falls off within 1 rad/s."
    ),
    frozenset({"coulomb", "pre_sliding"}): (
        "Play a micro-amplitude sequence (less than a tenth of a milliradian a chip): before "
        "sliding, friction is a spring."
    ),
    frozenset({"coulomb", "load_friction"}): (
        "Record motor current at two directions of a slow turn with the load uncoupled: what stays "
        "is the motor's."
    ),
    frozenset({"encoder_eccentricity", "gravity_imbalance"}): (
        "Turn slowly over full turns with current recorded: eccentricity needs no torque."
    ),
    frozenset({"backlash_width", "contact"}): (
        "Reverse slowly under a known preload: the gap's width does not depend on torque, the "
        "contact's give does."
    ),
    frozenset({"current_loop_lag", "velocity_filter_lag"}): (
        "Command and log at 1 kHz: a lag of the current delays torque, a filter delays what the "
        "loop sees."
    ),
    frozenset({"proportional_gain_error", "viscous"}): (
        "Read the gains in the drive itself; or record the motor's current as well: a gain changes "
        "what the loop asks for, friction what it needs."
    ),
    frozenset({"integral_gain_error", "current_loop_lag"}): (
        "Read the gains in the drive itself; or command and log at 1 kHz: a lag shows within "
        "milliseconds of a step, an integral gain in its tail."
    ),
    frozenset({"current_limit", "command_slew"}): (
        "Play half and double the amplitude: a current limit caps the acceleration, a slew limit "
        "the command."
    ),
}
BETTER_DATA = "Record motor position and torque as well, over full turns at two amplitudes or more."


def class_of(effect: str) -> frozenset[str]:
    """Everything that nobody could tell from `effect`, itself among them."""
    return frozenset({effect}).union(*(c for c in CLASSES if effect in c))


def siblings_of(effect: str) -> frozenset[str]:
    """Others of its class that some of a recording may tell from it."""
    return AT_REST - {effect} if effect in AT_REST else frozenset()


def splitting(effects: Iterable[str]) -> str:
    """The run that would tell these apart."""
    names = frozenset(effects)
    for pair, words in SPLITS.items():
        if pair <= names:
            return words
    return BETTER_DATA
