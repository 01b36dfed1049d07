"""What is fuzzed: for each kind of input its cases, what is done with one, and what may come out.

Only errors of our own tree may. `tests.test_fuzz` plays ten thousand cases in the test command,
`python -m tests.fuzz` as many as are asked for, of the same.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

from drivers.errors import DriverError
from servo_bench.errors import BenchError
from sim_rig.canopen.socketcand import ProtocolError
from sim_rig.errors import SimRigError
from tests import fuzz_files, fuzz_wire

OURS = (BenchError, DriverError, SimRigError, ProtocolError)


@dataclass(frozen=True)
class Target:
    """One kind of input; of a thousand cases `weight` are its."""

    cases: st.SearchStrategy[Any]
    play: Callable[[Any], None]
    weight: int

    def __call__(self, case: Any) -> None:
        """Play a case; whatever is raised is a fault of ours."""
        with suppress(*OURS):
            self.play(case)


TARGETS: Mapping[str, Target] = {
    "frames: socketcand": Target(fuzz_wire.SOCKETCAND, fuzz_wire.socketcand, 170),
    "frames: counter": Target(fuzz_wire.COUNTER, fuzz_wire.counter, 150),
    "frames: Modbus TCP answers": Target(fuzz_wire.TCP_ANSWERS, fuzz_wire.tcp_answers, 90),
    "frames: Modbus RTU answers": Target(fuzz_wire.RTU_ANSWERS, fuzz_wire.rtu_answers, 90),
    "frames: CANopen, to the slaves": Target(fuzz_wire.TO_SLAVES, fuzz_wire.to_slaves, 8),
    "frames: CANopen, to the master": Target(fuzz_wire.TO_MASTER, fuzz_wire.to_master, 3),
    "registers: of a drive": Target(fuzz_wire.REQUESTS, fuzz_wire.requests, 30),
    "registers: in a plan": Target(fuzz_wire.WORDS, fuzz_wire.words, 260),
    "EDS": Target(fuzz_files.EDS, fuzz_files.eds, 80),
    "TOML: rigs": Target(fuzz_files.RIGS, fuzz_files.rigs, 25),
    "TOML: experiments": Target(fuzz_files.EXPERIMENTS, fuzz_files.experiments, 20),
    "TOML: profiles": Target(fuzz_files.PROFILES, fuzz_files.profiles, 40),
    "MCAP": Target(fuzz_files.MCAP, fuzz_files.mcap, 34),
}
SHARE = sum(target.weight for target in TARGETS.values())


def examples(target: Target, count: int) -> int:
    """How many of `count` cases are a target's."""
    return -(-count * target.weight // SHARE)
