"""The page of a catalogue, compiled once and kept: `$XDG_CACHE_HOME/servo-bench/page_HASH.py`.

The hash is of the page's text, and the text holds every law: an edited effect is another file,
with other machine code beside it (see `machine_code`), so that none answers with an old law.
Processes may race: the last whole file stays. Numba is imported to compile, and for nothing else.
"""

import gc
import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from sim_rig.effects import catalogue
from sim_rig.effects.effect import Effect
from sim_rig.model import machine_code
from sim_rig.model.page import memory_names, page_text, parameter_names
from sim_rig.model.skeleton import MEMORY

HELPERS = (
    *("lesser", "greater", "saturated", "propagator"),
    *("sprung", "swung", "oscillate", "twisted", "upward", "left_at", "piece_of", "meet"),
    *("nearer", "reach", "share_pushed"),
)
_SIGNATURE = "b1(f8[::1],f8[::1],f8[::1],f8[::1],f8[::1],f8[:,::1],i8,f8,f8[:,::1])"


_COMPILER = Path(__file__).with_name("compiler.py")


class Engine(NamedTuple):
    """A compiled page, and the order of its arrays."""

    run: Callable[..., bool]
    parameters: tuple[tuple[str, str], ...]
    defaults: tuple[float, ...]
    memory: tuple[tuple[str, str], ...]
    file: Path

    @property
    def state_size(self) -> int:
        """Length of the state's array."""
        return MEMORY + len(self.memory)

    @property
    def plain(self) -> Callable[..., bool]:
        """The page in plain Python, to debug and to compare."""
        return _plain(self.file)


@cache
def engine() -> Engine:
    """The engine of the whole catalogue."""
    return build(catalogue())


def build(effects: Mapping[str, Effect], folder: Path | None = None) -> Engine:
    """Compile the page of `effects`, or take it from the cache in `folder`."""
    file = _written(page_text(effects), folder or cache_folder())
    return Engine(
        run=_kept(file) or _compiled(file),
        parameters=tuple(parameter_names(effects)),
        defaults=tuple(p.default for effect in effects.values() for p in effect.parameters),
        memory=tuple(memory_names(effects)),
        file=file,
    )


def cache_folder() -> Path:
    """Where pages are kept; a folder of this process alone where the home cannot be written."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    folder = base / "servo-bench"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _own_folder()
    return folder if os.access(folder, os.W_OK) else _own_folder()


@cache
def _own_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="servo-bench-"))


def _written(text: str, folder: Path) -> Path:
    file = folder / f"page_{hashlib.sha256(text.encode()).hexdigest()[:20]}.py"
    if file.exists() and file.read_text() == text:
        return file
    handle, name = tempfile.mkstemp(dir=folder, suffix=".part")
    with os.fdopen(handle, "w") as part:
        part.write(text)
    Path(name).replace(file)
    return file


def _module(file: Path, kind: str) -> ModuleType:
    name = f"servo_bench_{file.stem}_{kind}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None  # noqa: S101, PT018 - a .py file has both
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba looks up a page's globals by its name
    spec.loader.exec_module(module)
    return module


@cache
def _plain(file: Path) -> Callable[..., bool]:
    run: Callable[..., bool] = _module(file, "plain").run
    return run


def _kept(file: Path) -> Callable[..., bool] | None:
    made = machine_code.kept(machine_code.file_beside(file, _COMPILER))
    return None if made is None else machine_code.linked(made)


def _compiled(file: Path) -> Callable[..., bool]:
    from sim_rig.model import compiler  # noqa: PLC0415 - numba: a start from the cache needs none

    # A compiler makes many objects and few cycles: collecting is a tenth of its time.
    collected = gc.isenabled()
    gc.disable()
    try:
        module = _module(file, "compiled")
        for name in HELPERS:
            setattr(module, name, compiler.compiled_helper(getattr(module, name)))
        made = compiler.machine_code(module.run, _SIGNATURE)
        run = None if made is None else machine_code.linked(made)
        if made is None or run is None:
            return compiler.compiled_run(module.run, _SIGNATURE)
        machine_code.keep(machine_code.file_beside(file, _COMPILER), made)
        return run
    finally:
        if collected:
            gc.enable()
