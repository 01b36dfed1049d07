"""The page of a catalogue, compiled once and kept: `$XDG_CACHE_HOME/servo-bench/page_HASH.py`.

The hash is of the page's text, and the text holds every law: an edited effect is another file,
so that numba's cache beside it cannot answer with an old law. Processes may race: the first whole
file stays. Numba is imported with the first compilation, not before.
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
from sim_rig.model.page import memory_names, page_text, parameter_names
from sim_rig.model.skeleton import MEMORY

HELPERS = (
    *("lesser", "greater", "propagator"),
    *("oscillate", "twisted", "upward", "meet", "reach", "share_pushed"),
)
_SIGNATURE = "b1(f8[::1],f8[::1],f8[::1],f8[::1],f8[::1],f8[:,::1],i8,f8,f8[:,::1])"


class Engine(NamedTuple):
    """A compiled page, the same in plain Python, and the order of its arrays."""

    run: Callable[..., bool]
    plain: Callable[..., bool]
    parameters: tuple[tuple[str, str], ...]
    defaults: tuple[float, ...]
    memory: tuple[tuple[str, str], ...]
    file: Path

    @property
    def state_size(self) -> int:
        """Length of the state's array."""
        return MEMORY + len(self.memory)


@cache
def engine() -> Engine:
    """The engine of the whole catalogue."""
    return build(catalogue())


def build(effects: Mapping[str, Effect], folder: Path | None = None) -> Engine:
    """Compile the page of `effects`, or take it from the cache in `folder`."""
    file = _written(page_text(effects), folder or cache_folder())
    return Engine(
        run=_compiled(_module(file, "compiled")),
        plain=_module(file, "plain").run,
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
    sys.modules[name] = module  # numba finds the page by its name when it loads from its cache
    spec.loader.exec_module(module)
    return module


def _compiled(module: ModuleType) -> Callable[..., bool]:
    from sim_rig.model import compiler  # noqa: PLC0415 - numba: many commands never need it

    # A compiler makes many objects and few cycles: collecting is a tenth of its time.
    collected = gc.isenabled()
    gc.disable()
    try:
        for name in HELPERS:
            setattr(module, name, compiler.compiled_helper(getattr(module, name)))
        return compiler.compiled_run(module.run, _SIGNATURE)
    finally:
        if collected:
            gc.enable()
