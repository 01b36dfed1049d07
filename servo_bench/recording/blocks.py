"""Which of the rig's three blocks a recording can judge: its measured input and output are there.

controller    command and motor motion -> current, torque or voltage
mechanics     current, torque or voltage -> motor motion
transmission  motor position -> load angle; with a locked output: torque -> twist
loop          command -> load angle, else motor motion: the whole, where no block is open
"""

from typing import Literal, NamedTuple

import numpy as np

from servo_bench.recording.recording import Recording

Name = Literal["controller", "mechanics", "transmission", "loop"]

COMMANDS = ("velocity_command_rad_s", "position_command_rad", "torque_command_nm")
EFFORTS = ("current_a", "motor_torque_nm", "motor_current_a", "torque_nm", "voltage_v")
MOTIONS = ("motor_position_rad", "motor_velocity_rad_s")
LOADS = ("load_angle_rad", "load_velocity_rad_s")


class Block(NamedTuple):
    """One block and the channels from which it can be judged, the best of each kind first."""

    name: Name
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def blocks_of(recording: Recording) -> tuple[Block, ...]:
    """The blocks whose input and output were both measured; empty where none is complete."""

    def there(*names: str) -> tuple[str, ...]:
        return tuple(name for name in names if name in recording and _came(recording, name))

    commands, efforts = there(*COMMANDS), there(*EFFORTS)
    motions, loads = there(*MOTIONS), there(*LOADS)
    moved = there("velocity_command_rad_s", "position_command_rad")
    locked = recording.plant is not None and recording.plant.output_locked
    candidates = (
        Block("controller", moved + motions if moved and motions else (), efforts),
        Block("mechanics", () if locked else efforts, motions),
        Block("transmission", efforts if locked else motions, motions if locked else loads),
        Block("loop", commands, loads + motions),
    )
    return tuple(block for block in candidates if block.inputs and block.outputs)


def _came(recording: Recording, name: str) -> bool:
    values = recording[name]
    return values.dtype.kind != "f" or bool(np.isfinite(values).any())
