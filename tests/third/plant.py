"""The axis of plant.c, compiled where it is first played, and played from commands to samples.

    play(axis, arrival_s, command_rad_s, sample_s)

Compiled by the system's C compiler (`cc`, or what CC names) into a folder of this user's below the
system's temporary one, by the name of a hash of source and command: an edited source is compiled
anew, and nothing else is.
"""

import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SOURCE = Path(__file__).with_name("plant.c")
FLAGS = ("-O2", "-shared", "-fPIC")
COLUMNS = (
    *("motor_rad", "motor_rad_s", "load_rad", "load_rad_s"),
    *("current_a", "counted_rad_s", "reference_a", "disc_rad"),
)
"""Of a sample, in the order of plant.c."""


class NoCompilerError(RuntimeError):
    """There is no C compiler, or it refused plant.c."""


class Link(IntEnum):
    """What is between motor and load."""

    RIGID = 0
    COUPLING = 1
    FACES = 2


class Axis(NamedTuple):
    """Everything that an axis is, in the order of plant.c, whose head has the equations.

    What is zero is not there; of `detent_nm` every motor has some, `cogging_nm` is what may be
    hidden.
    """

    inertia_kg_m2: float
    torque_constant_nm_per_a: float
    current_lag_s: float = 0.0
    coulomb_nm: float = 0.0
    stribeck_nm: float = 0.0
    stribeck_rad_s: float = 1.0
    bristle_rad: float = 2e-5
    viscous_nm_s_per_rad: float = 0.0
    detent_nm: float = 0.0
    detent_order: float = 24.0
    detent_phase_rad: float = 0.0
    cogging_nm: float = 0.0
    cogging_order: float = 0.0
    cogging_phase_rad: float = 0.0
    ripple_fraction: float = 0.0
    ripple_order: float = 0.0
    ripple_phase_rad: float = 0.0
    inertia_wave_fraction: float = 0.0
    inertia_wave_order: float = 0.0
    inertia_wave_phase_rad: float = 0.0
    supply_fraction: float = 0.0
    supply_hz: float = 0.0
    supply_phase_rad: float = 0.0
    link: int = Link.RIGID
    load_inertia_kg_m2: float = 0.0
    stiffness_nm_per_rad: float = 0.0
    coupling_damping_nm_s_per_rad: float = 0.0
    face_damping_s_per_rad: float = 0.0
    face_exponent: float = 1.3
    gap_rad: float = 0.0
    load_friction_nm: float = 0.0
    load_bristle_rad: float = 5e-5
    gravity_nm: float = 0.0
    gravity_phase_rad: float = 0.0
    load_torque_nm: float = 0.0
    tick_s: float = 125e-6
    substeps: int = 16
    proportional_gain_a_s_per_rad: float = 0.0
    integral_gain_a_per_rad: float = 0.0
    current_limit_a: float = 1e3
    motor_count_rad: float = 2.0 * np.pi / (1 << 20)
    filter_lag_s: float = 0.0
    disc_slip_rad_s2: float = 0.0
    motor_start_rad: float = 0.0
    load_start_rad: float = 0.0

    @property
    def total_inertia_kg_m2(self) -> float:
        """What the motor turns where nothing gives way, kg m2."""
        return self.inertia_kg_m2 + self.load_inertia_kg_m2


class Energy(NamedTuple):
    """Of a whole run, J: work of all torques, losses, and how much more is stored than before."""

    work_j: float
    friction_loss_j: float
    link_loss_j: float
    stored_j: float


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """What was sampled, arrays of shape (rows,): no noise and no counts but the drive's own."""

    motor_rad: Array
    motor_rad_s: Array
    load_rad: Array
    load_rad_s: Array
    current_a: Array
    counted_rad_s: Array
    reference_a: Array
    disc_rad: Array
    energy: Energy
    clamped_ticks: int


class _Axis(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_long if kind is int else ctypes.c_double)
        for name, kind in Axis.__annotations__.items()
    ]


class _Energy(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in Energy._fields]


def play(axis: Axis, arrival_s: Array, command_rad_s: Array, sample_s: Array) -> Played:
    """Play commands from rest; the drive has each at `arrival_s`, samples are of `sample_s`.

    All three have shape (rows,), times in s from zero on and ascending. NoCompilerError where
    plant.c cannot be compiled.
    """
    arrival, command, sample = (
        np.ascontiguousarray(array, np.float64) for array in (arrival_s, command_rad_s, sample_s)
    )
    if not arrival.size == command.size == sample.size:
        raise ValueError(
            f"{arrival.size} arrivals, {command.size} commands and {sample.size} samples: give one "
            "of each to a row"
        )
    samples, energy = np.empty((sample.size, len(COLUMNS))), _Energy()
    clamped = _library().play(
        ctypes.byref(_Axis(*axis)),
        sample.size,
        *map(_pointer, (arrival, command, sample, samples)),
        ctypes.byref(energy),
    )
    figures = Energy(*(getattr(energy, name) for name in Energy._fields))
    columns = {name: samples[:, k].copy() for k, name in enumerate(COLUMNS)}
    return Played(**columns, energy=figures, clamped_ticks=int(clamped))


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(str(compiled()))
    library.play.restype = ctypes.c_long
    library.play.argtypes = (ctypes.c_void_p, ctypes.c_long, *(ctypes.c_void_p,) * 5)
    return library


def has_compiler() -> bool:
    """Whether there is a program to compile with."""
    command = _compiler()
    return bool(command) and shutil.which(command[0]) is not None


def _compiler() -> list[str]:
    return shlex.split(os.environ.get("CC", "cc"))


def compiled(folder: Path | None = None) -> Path:
    """The shared library, compiled unless `folder` has it; NoCompilerError where none can be."""
    command = _compiler()
    if not has_compiler():
        raise NoCompilerError(
            f"there is no C compiler {' '.join(command)!r}, and tests/third/plant.c needs one: "
            "install one (Debian: apt-get install gcc libc6-dev), or name it in CC"
        )
    words = [*command, *FLAGS]
    digest = hashlib.sha256(" ".join(words).encode() + SOURCE.read_bytes()).hexdigest()[:16]
    where = _cache_folder() if folder is None else folder
    library = where / f"plant-{digest}.so"
    if not library.exists():
        _compile(words, library)
    return library


def _cache_folder() -> Path:
    """This user's alone, because what lies there is run."""
    folder = Path(tempfile.gettempdir()) / f"servo-bench-third-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise NoCompilerError(f"{folder} is another user's: remove it, or set TMPDIR")
    return folder


def _compile(words: list[str], library: Path) -> None:
    """Compile beside its place, and move it there: another process may be loading it."""
    with tempfile.TemporaryDirectory(dir=library.parent) as beside:
        made = Path(beside) / library.name
        done = subprocess.run(
            [*words, "-o", made, SOURCE, "-lm"], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise NoCompilerError(f"{' '.join(words)} refused plant.c: {done.stderr.strip()}")
        made.replace(library)
