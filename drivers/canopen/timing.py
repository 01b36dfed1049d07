"""How a drive learns its period: SYNC (0x1005, 0x1006), interpolation time (0x60C2), and limits."""

import math

from drivers.canopen.node import SYNC, Node
from drivers.canopen.settings import CanopenSettings
from drivers.errors import DriveError, SettingsError

_SYNC_PRODUCER = 1 << 30


def check_period(settings: CanopenSettings) -> None:
    """Raise SettingsError for a period that the drive's profile rules out."""
    profile = settings.drive.profile
    shortest_s, longest_s = profile.timing.period_s
    period_s = settings.period_s
    if not (_at_least(period_s, shortest_s) and _at_least(longest_s, settings.command_period_s)):
        raise SettingsError(
            f"a command every {settings.command_period_s * 1e3:g} ms on a SYNC every "
            f"{period_s * 1e3:g} ms is not for {profile.title}: its profile allows "
            f"{shortest_s * 1e3:g} to {longest_s * 1e3:g} ms. Choose a period in this range."
        )
    if profile.timing.command_is_sync and settings.command_every != 1:
        raise SettingsError(
            f"one command for {settings.command_every} SYNCs is not for {profile.title}: its "
            "profile wants 0x60C2 and the SYNC period equal (command_is_sync). Sample once per "
            "command."
        )
    if settings.sync_by_drive and not profile.timing.sync_producer:
        raise SettingsError(
            f"SYNC by the drive is not for {profile.title}: its profile does not say that it can "
            'produce one (sync_producer, bit 30 of 0x1005). Set drive.sync = "master", or complete '
            "the profile by the drive's manual."
        )


def prepare_sync(node: Node, period_s: float | None, *, needed: bool = False) -> None:
    """The node consumes SYNC on COB-ID 0x80 and knows its period where it asks for one."""
    if node.has(0x1005):
        cob_id = node.read(0x1005)
        if cob_id & (_SYNC_PRODUCER | 0x7FF) != SYNC:
            node.configure(0x1005, 0, SYNC, "This master sends SYNC on 0x80.")
    if period_s is None:
        return
    if node.writable(0x1006):
        node.configure(0x1006, 0, round(period_s * 1e6))
    elif needed:
        raise DriveError(
            f"{node.name}: it needs the SYNC period (0x1006), by its profile or because it is to "
            "produce SYNC, and its EDS has no 0x1006 to write. Use the EDS of this very device, or "
            "correct the profile or drive.sync."
        )


def produce_sync(node: Node) -> None:
    """The node begins to produce SYNC, every 0x1006; DriveError where it will not."""
    advice = 'The drive produces no SYNC: set drive.sync = "master".'
    node.configure(0x1005, 0, _SYNC_PRODUCER | SYNC, advice)


def set_interpolation_time(node: Node, settings: CanopenSettings) -> None:
    """Write 0x60C2 as the profile says; raises as `interpolation_time`, or DriveError."""
    timing = settings.drive.profile.timing
    if timing.interpolation_time == "none":
        return
    sync = timing.interpolation_time == "sync"
    period_s = settings.period_s if sync else settings.command_period_s
    value, exponent = interpolation_time(period_s, timing.interpolation_exponent)
    if not (node.writable(0x60C2, 1) and node.writable(0x60C2, 2)):
        return
    advice = f"The drive cannot run at period_s = {period_s:g}: choose a period that it allows."
    node.configure(0x60C2, 2, exponent, advice)
    node.configure(0x60C2, 1, value, advice)


def interpolation_time(period_s: float, only_exponent: int | None = None) -> tuple[int, int]:
    """0x60C2 for a period: (value, exponent), value · 10^exponent s, value at most 255.

    Raises SettingsError for a period that has no such form.
    """
    exponents = (-3, -4, -5, -6) if only_exponent is None else (only_exponent,)
    for exponent in exponents:
        value = round(period_s * 10**-exponent)
        if 1 <= value <= 255 and abs(value - period_s * 10**-exponent) < 1e-6:
            return value, exponent
    allowed = ", ".join(f"{10.0**exponent:g} s" for exponent in exponents)
    raise SettingsError(
        f"period_s = {period_s:g} is no whole number up to 255 of {allowed}, so 0x60C2 cannot say "
        "it. Choose such a period, e.g. 0.008."
    )


def _at_least(value: float, bound: float) -> bool:
    return value > bound or math.isclose(value, bound, rel_tol=1e-9)
