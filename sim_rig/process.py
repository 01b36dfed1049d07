"""The software rig as a process of its own.

`serve` runs one in the calling process; `spawn` starts one and hands out its bus. The bus hub,
where the rig hosts one, is a further process: nothing else may delay its stamps.

    python -m sim_rig.process      settings as one line of JSON on standard input,
                                   the address as one line of JSON on standard output
"""

import importlib
import json
import logging
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from typing import IO, Any

from sim_rig.canopen.busloop import RigOnBus, open_bus
from sim_rig.canopen.cia402 import State
from sim_rig.counter.box import box_of
from sim_rig.counter.line import in_a_thread
from sim_rig.counter.settings import CounterSettings
from sim_rig.errors import RigSettingsError, SimRigError
from sim_rig.model import Model
from sim_rig.mounted import mounted
from sim_rig.plant import Plant
from sim_rig.realtime import end_with_parent, run_in_real_time
from sim_rig.settings import (
    CANOPEN,
    ENCODER_DEVICE,
    OWN_MODEL,
    BusOptions,
    Nominal,
    RigSettings,
)

PRIORITY = 70
SWITCH_INTERVAL_S = 0.0002
START_TIMEOUT_S = 30.0
END_TIMEOUT_S = 5.0

PlantFactory = Callable[[Nominal, int], Plant]


def plant_of(settings: RigSettings) -> Plant:
    """What moves, as the devices sit on it: the model with its effects, or what a factory makes.

    Raises RigSettingsError or EffectError where there is no such thing.
    """
    if settings.plant == OWN_MODEL:
        model = Model.from_table(settings.nominal, settings.effects)
        return mounted(model.plant(settings.seed), settings)
    try:
        return mounted(plant_factory(settings.plant)(settings.nominal, settings.seed), settings)
    except (TypeError, ValueError) as error:
        raise RigSettingsError(
            f"plant = {settings.plant!r} makes no plant: {error}. "
            "Name a factory that takes (nominal, seed)."
        ) from error


def plant_factory(name: str) -> PlantFactory:
    """What "package.module:factory" names, imported.

    Raises RigSettingsError where there is nothing callable of that name.
    """
    module, _, attribute = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise RigSettingsError(
            f"plant = {name!r} cannot be loaded: {error}. "
            f'Name "{OWN_MODEL}", or "package.module:factory" that Python can import from here.'
        ) from error
    if not callable(factory):
        raise RigSettingsError(f"plant = {name!r} is not callable with (nominal, seed).")
    checked: PlantFactory = factory
    return checked


def serve(
    settings: RigSettings,
    *,
    ready: Callable[[dict[str, Any]], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Be the rig until SIGTERM, SIGINT, or `stop()`, which is asked at least every 0.05 s.

    `ready` is called once, with the bus options for `can.Bus` (the port is the real one), after
    both nodes have booted. Signals are heard in the main thread only.
    Raises RigSettingsError for settings that cannot be, SimRigError when the bus fails.
    """
    plant = plant_of(settings)
    if settings.protocol != CANOPEN:
        _serve_modbus(settings, plant, ready, stop)
        return
    with ExitStack() as leaving:
        ended = leaving.enter_context(_ending_by_signal())
        bus_options = leaving.enter_context(_hosted(settings))
        bus = open_bus(bus_options)
        leaving.callback(bus.shutdown)
        loop = RigOnBus(replace(settings, faults=settings.wire_faults), plant, bus)
        loop.rig.boot()
        address = dict(bus_options) | leaving.enter_context(_counter(settings, loop))
        if ready is not None:
            ready(address)
        run_in_real_time(PRIORITY)
        loop.run(lambda: ended() or stop())


@contextmanager
def _counter(settings: RigSettings, loop: RigOnBus) -> Iterator[dict[str, Any]]:
    """The rig's serial counter, where it has one; yields where it is."""
    if settings.counter is None:
        yield {}
        return
    drive = loop.rig.drive
    box = box_of(settings, loop.load_counts, lambda: drive.state is State.OPERATION_ENABLED)

    def prepare() -> None:
        sys.setswitchinterval(SWITCH_INTERVAL_S)  # neither thread waits long for the other
        run_in_real_time(PRIORITY)

    with in_a_thread(box, settings.counter, prepare) as device:
        yield {ENCODER_DEVICE: device}


def _serve_modbus(
    settings: RigSettings,
    plant: Plant,
    ready: Callable[[dict[str, Any]], None] | None,
    stop: Callable[[], bool],
) -> None:
    from sim_rig.modbus.serve import serve as serve_modbus  # noqa: PLC0415 - costs 0.3 s to import

    def begun(bus: dict[str, Any]) -> None:
        run_in_real_time(PRIORITY)  # first: it takes longer than a drive may to answer
        if ready is not None:
            ready(bus)

    with _ending_by_signal() as ended:
        serve_modbus(settings, plant, begun, lambda: ended() or stop())


@contextmanager
def _ending_by_signal() -> Iterator[Callable[[], bool]]:
    """Whether SIGTERM or SIGINT has come; the handlers from before come back at the end."""
    signalled = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield signalled.is_set
        return
    before = {
        number: signal.signal(number, lambda *_: signalled.set())
        for number in (signal.SIGTERM, signal.SIGINT)
    }
    try:
        yield signalled.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _hosted(settings: RigSettings) -> Iterator[BusOptions]:
    """The bus options to open, with a hub behind them where the settings ask for one."""
    options: dict[str, Any] = dict(settings.bus)
    if options.get("interface") != "socketcand" or not settings.host_hub:
        yield options
        return
    for name, value in {
        "host": "127.0.0.1",
        "port": 0,
        "channel": "can0",
        "tcp_tune": True,
    }.items():
        options.setdefault(name, value)
    command = [sys.executable, "-m", "sim_rig.canopen.hub"]
    command += ["--host", str(options["host"]), "--port", str(options["port"])]
    command += ["--parent", str(os.getpid())]
    with _child(command, b"", "bus hub") as (_, address):
        yield options | {"host": address["host"], "port": address["port"]}


@dataclass(frozen=True, slots=True)
class SpawnedRig:
    """A rig in a process of its own: the options for `can.Bus`, and the process."""

    bus: dict[str, str | int | float | bool]
    process: subprocess.Popen[bytes]


@contextmanager
def spawn(settings: RigSettings) -> Iterator[SpawnedRig]:
    """Start the rig, wait until both nodes have booted, and end it on leaving.

    It also ends when the thread that started it does. It sits in a session of its own: Ctrl-C
    reaches the master alone, which still needs the rig to stop it.
    Raises SimRigError, with the rig's own last words, when it does not come up, and on leaving
    without another error when it had ended by itself.
    """
    line = json.dumps({**asdict(settings), "bus": dict(settings.bus)}).encode() + b"\n"
    command = [sys.executable, "-m", "sim_rig.process", "--parent", str(os.getpid())]
    with _child(command, line, "software rig") as (process, address):
        yield SpawnedRig(address, process)


@contextmanager
def _child(
    command: list[str], line: bytes, name: str
) -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    """Start a program of ours, give it `line`, and yield it with the JSON it says first."""
    importable = os.pathsep.join(path for path in sys.path if path)
    # A file, not a pipe, takes its errors: nobody reads them while it runs, and a full pipe blocks.
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": importable},
        ) as process,
    ):
        try:
            yield process, _first_words(process, line, errors, name)
            if process.poll() is not None:
                raise SimRigError(f"The {name} ended while it was needed: {_last_words(errors)}")
        finally:
            _end(process)


def _first_words(
    process: subprocess.Popen[bytes], line: bytes, errors: IO[bytes], name: str
) -> dict[str, Any]:
    assert process.stdin is not None  # noqa: S101 - both are pipes
    assert process.stdout is not None  # noqa: S101
    with suppress(BrokenPipeError):  # its last words will say why
        process.stdin.write(line)
        process.stdin.close()
    readable, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
    words = process.stdout.readline() if readable else b""
    if not words:
        _end(process)
        ended = f"it ended with status {process.returncode}"
        silent = f"it said nothing within {START_TIMEOUT_S:g} s"
        said = _last_words(errors) or (ended if readable else silent)
        raise SimRigError(f"The {name} did not start: {said}")
    address: dict[str, Any] = json.loads(words)
    return address


def _last_words(errors: IO[bytes]) -> str:
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def settings_from_json(line: str) -> RigSettings:
    """The settings that `spawn` wrote. Raises RigSettingsError for anything else."""
    try:
        table: Mapping[str, Any] = json.loads(line)
        nominal = Nominal(**table["nominal"])
        faults = tuple(table.get("faults", ()))
        counter = table.get("counter") and CounterSettings(**table["counter"])
        return RigSettings(**{**table, "nominal": nominal, "faults": faults, "counter": counter})
    except (ValueError, TypeError, KeyError) as error:
        raise RigSettingsError(
            f"The rig's settings are one line of JSON with the fields of RigSettings: {error!r}"
        ) from error


def main(arguments: list[str]) -> int:
    """The rig's process; returns its exit code."""
    if arguments[:1] == ["--parent"] and not end_with_parent(int(arguments[1])):
        return 1

    # python-can warns of every TCP read that ends within a message; that is no news.
    logging.getLogger("can").setLevel(logging.ERROR)

    def ready(bus: dict[str, Any]) -> None:
        sys.stdout.write(json.dumps(bus) + "\n")
        sys.stdout.flush()

    try:
        serve(settings_from_json(sys.stdin.readline()), ready=ready)
    except SimRigError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
