"""Something dies with the motor at speed: does it stop, how soon, and who stopped it?

    python -m tests.kill_campaign --count 10 --json OUT      every way of dying, so many times

A run of `servo-bench run`'s session on a software rig whose motor is watched beside the wire
(`tests.watched_plant`). Killed with SIGKILL, or stopped with SIGSTOP:

    loop        the bus loop: its supervisor stops the rig
    hung        the bus loop hangs: its supervisor kills it and stops the rig
    bench       supervisor, loop, and session, all at once: the drive stops by itself
    network     the way between bench and drive (a TCP relay): the drive stops by itself

Times are from the signal to the motor's last motion. The bound is the drive's own time-out where
nothing else is left, limits.blind_s where the supervisor has to notice a loop that hangs.
"""

import argparse
import json
import logging
import math
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from drivers.clock import SYSTEM_CLOCK
from servo_bench.clock import monotonic_ns
from servo_bench.devices import ModbusDriveConfig
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.rig import RigConfig, load_rig
from sim_rig.process import spawn
from tests.watched_plant import FILE, PLANT, Motion, Witness

SPEED_RAD_S = 4.0
SLOTS_AT_SPEED = 60
PATIENCE_S = 120.0
"""For a bench that has stopped the rig and is short of processor time for its recording."""
LOOKS, LOOK_EVERY_S = 1000, 0.005
DEATHS = ("loop", "hung", "bench", "network")
RIGS = {
    "canopen": "rigs/paper.toml",
    "modbus-tcp": "rigs/modbus-tcp.toml",
    "modbus-rtu": "rigs/modbus-rtu.toml",
}
CASES = tuple(
    (protocol, death)
    for protocol in RIGS
    for death in DEATHS
    if (protocol, death) != ("modbus-rtu", "network")
)


@dataclass(frozen=True, slots=True)
class Death:
    """What became of one run: seconds from the signal to the last motion, and the bench's words.

    `hole_s` is the longest that the machine kept the witness itself from looking.
    """

    protocol: str
    death: str
    stopped_s: float
    bound_s: float
    hole_s: float
    speed_rad_s: float
    words: str
    status: int
    last: Motion

    @property
    def kept(self) -> bool:
        """Whether the motor stood within the configured time, and what the machine took away."""
        return self.stopped_s <= self.bound_s + self.hole_s


def at_speed() -> Experiment:
    """A minute of a velocity that never falls under three quarters of `SPEED_RAD_S`."""
    small = SPEED_RAD_S / 8
    return Experiment(
        name="at speed",
        rig="none",
        period_s=0.008,
        memory=1,
        standstill_s=0.08,
        lead_in=8,
        identification=MSequence(
            polynomial="2327", amplitude_rad_s=small, bias_rad_s=SPEED_RAD_S, length=7500
        ),
        validation=RandomBinary(kind="random-binary", seed=2, amplitude_rad_s=small, length=8),
    )


def die(protocol: str, death: str, folder: Path, drive: dict[str, float] | None = None) -> Death:
    """One run, one death."""
    rig = load_rig(RIGS[protocol]).on_a_free_port()
    limits = rig.limits.model_copy(update={"travel_rad": 1e4})
    rig = rig.model_copy(
        update={"limits": limits, "drive": rig.drive.model_copy(update=drive or {})}
    )
    os.environ[FILE] = str(folder / "motion")
    with ExitStack() as stack:
        witness = stack.enter_context(Witness(folder / "motion"))
        settings = replace(rig.simulation_settings(), plant=PLANT)
        rig = rig.with_bus(**stack.enter_context(spawn(settings)).bus)
        relay, reached = None, rig
        if death == "network":
            relay, port = stack.enter_context(_relay(int(rig.bus["port"])))
            reached = rig.with_bus(port=port)
        bench = stack.enter_context(_bench(reached, folder))
        killed_ns = _kill(death, bench, relay)
        speed_rad_s = abs(witness.look().velocity_rad_s)
        hole_s = _until_it_stands(witness)
        motion = witness.look()
        bench.wait(PATIENCE_S)
        assert bench.stderr is not None
        words = bench.stderr.read().strip().splitlines()[-1:]
    stopped_s = (motion.moved_ns - killed_ns) * 1e-9 if motion.stands else math.inf
    return Death(
        protocol,
        death,
        max(stopped_s, 0.0),
        bound_s(rig, death),
        hole_s,
        speed_rad_s,
        " ".join(words),
        bench.returncode,
        motion,
    )


def _until_it_stands(witness: Witness) -> float:
    """Look until it does, so many times (a machine that stops altogether takes no looks away); the
    longest time between two looks, less the pause that was meant."""
    before_ns, longest_ns = monotonic_ns(), 0
    for _ in range(LOOKS):
        if witness.look().stands:
            break
        SYSTEM_CLOCK.sleep_s(LOOK_EVERY_S)
        now_ns = monotonic_ns()
        longest_ns, before_ns = max(longest_ns, now_ns - before_ns), now_ns
    return max(0.0, longest_ns * 1e-9 - LOOK_EVERY_S)


def bound_s(rig: RigConfig, death: str) -> float:
    """When the motor must stand: who stops it, when that one knows, the ramp, and the looks.

    The velocity loop needs ln(4 / 0.05) / (zeta wn) = 0.18 s from 4 rad/s to what is called rest.
    """
    ramp_and_look_s = 0.3
    drive = rig.drive
    own_s = (
        rig.modbus_settings(0.008).own_stop_s or math.inf
        if isinstance(drive, ModbusDriveConfig)
        else drive.heartbeat_timeout_s
    )
    knows_s = {"loop": 0.0, "hung": rig.limits.blind_s}.get(death, own_s)
    return min(knows_s, own_s) + ramp_and_look_s


@contextmanager
def _relay(port: int) -> Iterator[tuple["subprocess.Popen[bytes]", int]]:
    """A process that carries bytes between bench and drive, on a port of its own."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        own = listener.getsockname()[1]
    ends = (
        f"TCP-LISTEN:{own},bind=127.0.0.1,nodelay,reuseaddr,fork",
        f"TCP:127.0.0.1:{port},nodelay",
    )
    row = f"0100007F:{own:04X} 00000000:0000 0A"
    with subprocess.Popen(["socat", *ends], start_new_session=True) as process:
        until_ns = monotonic_ns() + 10_000_000_000
        while row not in Path("/proc/net/tcp").read_text():
            assert monotonic_ns() < until_ns, "socat did not listen"
        try:
            yield process, own
        finally:
            _kill_group(process)


def _kill_group(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def _bench(rig: RigConfig, folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """The session in a process of its own; yielded when the motor is at speed."""
    job = folder / "job.json"
    plan = at_speed().model_dump(mode="json")
    job.write_text(json.dumps({"experiment": plan, "rig": rig.model_dump(mode="json")}))
    command = [sys.executable, "-m", "tests.played_run", str(job), str(folder / "run.mcap")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line.split()[1]) >= SLOTS_AT_SPEED:
                break
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    return [int(it) for it in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _kill(
    death: str, bench: "subprocess.Popen[str]", relay: "subprocess.Popen[bytes] | None"
) -> int:
    """Send the signal; when."""
    (loop,) = children(bench.pid)
    (supervisor,) = children(loop)
    killed_ns = monotonic_ns()
    if death == "loop":
        os.kill(loop, signal.SIGKILL)
    elif death == "hung":
        os.kill(loop, signal.SIGSTOP)
    elif death == "bench":
        for pid in (supervisor, loop, bench.pid):
            os.kill(pid, signal.SIGKILL)
    else:
        assert relay is not None
        _kill_group(relay)
    return killed_ns


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.kill_campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    logging.getLogger("can").setLevel(logging.ERROR)
    deaths: list[Death] = []
    for _ in range(options.count):
        for protocol, death in CASES:
            with tempfile.TemporaryDirectory() as folder:
                deaths.append(die(protocol, death, Path(folder)))
    figures = judged(deaths)
    text = json.dumps(figures, indent=1)
    if options.json:
        options.json.write_text(text + "\n")
    sys.stdout.write(text + "\n")
    return 0 if figures["stopped_in_time"] == figures["deaths"] else 1


def judged(deaths: list[Death]) -> dict[str, object]:
    """The figures of a campaign."""
    rows = {}
    for protocol, death in CASES:
        mine = [it for it in deaths if (it.protocol, it.death) == (protocol, death)]
        times_s = sorted(it.stopped_s for it in mine)
        if times_s:
            rows[f"{protocol}, {death}"] = {
                "runs": len(mine),
                "in_time": sum(it.kept for it in mine),
                "bound_s": round(mine[0].bound_s, 3),
                "median_s": round(times_s[len(times_s) // 2], 3),
                "worst_s": round(times_s[-1], 3),
                "longest_hole_s": round(max(it.hole_s for it in mine), 3),
            }
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} CPUs, shared, {platform.system()}, {platform.machine()}",
        "speed_rad_s": SPEED_RAD_S,
        "deaths": len(deaths),
        "stopped_in_time": sum(it.kept for it in deaths),
        "cases": rows,
        "late": [asdict(it) for it in deaths if not it.kept],
    }


if __name__ == "__main__":
    sys.exit(main())
