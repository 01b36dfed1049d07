"""`bench.toml`: what the daemon serves, where it keeps it, and who may reach it.

    rig = "rigs/paper.toml"            # a shipped one, or a path (relative to this file)
    recordings = "recordings"          # this folder and `state` are made where they are missing
    experiments = ["experiments/*.toml"]

    [network]                          # all of it optional: 127.0.0.1:8420, this machine only
    host = "0.0.0.0"
    token_file = "token"
    certificate = "bench.crt"
    key = "bench.key"
    hosts = ["bench.lab"]

Only what stands here can be played, on the one rig that stands here, within that rig's limits.
"""

import ipaddress
import os
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from servo_bench.daemon.stopping import HOST, PORT, STATE
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, load_experiment
from servo_bench.files import SHIPPED, Value, find, read_toml, validated
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.realtime import PRIORITY

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
MIN_TOKEN = 16


class NetworkConfig(Value):
    """`[network]`: where the daemon listens, and for whom.

    Beyond loopback a token is required, and TLS, or the words `allow_plain_http = true`.
    """

    host: str = HOST
    """Address to listen on; beyond loopback only with a token."""
    port: int = Field(default=PORT, ge=0, le=65535)
    """TCP port; 0 for a free one, which the log names."""
    hosts: tuple[str, ...] = ()
    """Names by which browsers reach it, besides the loopback names and `host`."""
    token_file: str | None = None
    """File with the secret, at least 16 characters, that whoever asks must show."""
    certificate: str | None = None
    """TLS certificate (PEM); with `key`."""
    key: str | None = None
    """The certificate's private key (PEM)."""
    allow_plain_http: bool = False
    """Allows a host beyond loopback without TLS: whoever can listen reads the token."""
    requests_per_second: PositiveFloat = 50.0
    """Requests a second that one peer may make for long; a stop is never refused."""
    request_burst: PositiveInt = 200
    """Requests that one peer may make at once."""
    max_body_bytes: PositiveInt = 65536
    """Largest body of a request, bytes."""


class RunConfig(Value):
    """`[run]`: how runs are played."""

    priority: int = Field(default=PRIORITY, ge=0, le=99)
    """SCHED_FIFO priority of the bus loop; 0 for none."""
    cpu: int | None = Field(default=None, ge=0)
    """CPU to pin the bus loop to; by default none."""
    without_daemon: Literal["finish", "stop"] = "finish"
    """What a run does when its daemon has died: "finish" it (a daemon that comes back finds it), or
    "stop" the rig."""
    without_daemon_s: PositiveFloat = 5.0
    """With "stop": how long after the daemon's death, s."""
    analyse: bool = True
    """Whether report and figures are written after each run."""
    max_queue: PositiveInt = 100
    """How many runs may wait."""


class BenchConfig(Value):
    """The whole file."""

    rig: str
    """The rig file: one that ships, or a path beside this file."""
    simulated: bool = False
    """Starts a software rig for every run, on a bus of its own."""
    recordings: str = "recordings"
    """Folder of the recordings, beside this file; made where it is missing."""
    state: str = STATE
    """Folder of the queue and the runs under way, beside this file; made where it is missing."""
    experiments: tuple[str, ...] = ("experiments/*.toml",)
    """Which experiment files can be played: names or patterns, beside this file or among those that
    ship."""
    network: NetworkConfig = NetworkConfig()
    """Where the daemon listens, and for whom."""
    run: RunConfig = RunConfig()
    """How runs are played."""


class Bench(Value):
    """The file, read and resolved: everything that the daemon needs, absolute and checked."""

    rig: RigConfig
    simulated: bool
    recordings: Path
    state: Path
    experiments: dict[str, Experiment]
    """By the name that requests use: the file's name without `.toml`."""
    texts: dict[str, str]
    network: NetworkConfig
    run: RunConfig
    token: str | None = Field(default=None, repr=False)
    certificate: Path | None = None
    key: Path | None = None

    @property
    def beyond_loopback(self) -> bool:
        """Whether other machines can reach it."""
        return not is_loopback(self.network.host)

    @property
    def scheme(self) -> str:
        """http or https."""
        return "https" if self.certificate else "http"


def is_loopback(host: str) -> bool:
    """Whether a host is this machine and nobody else; who listens on "::" sees IPv4's mapped."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host == "localhost"
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def load_bench(name: str | Path) -> Bench:
    """Read `bench.toml`; ConfigError where it, or anything that it names, cannot be used."""
    path = find(name)
    config = validated(BenchConfig, read_toml(path), str(path))
    beside = path.parent
    experiments, texts = _experiments(config.experiments, beside)
    network = config.network
    bench = Bench(
        rig=load_rig(config.rig, beside),
        simulated=config.simulated,
        recordings=_folder(beside / config.recordings, "recordings"),
        state=_folder(beside / config.state, "state", mode=0o700),
        experiments=experiments,
        texts=texts,
        network=network,
        run=config.run,
        token=_token(network, beside),
        certificate=_file(network.certificate, beside, "network.certificate"),
        key=_file(network.key, beside, "network.key"),
    )
    _check_reach(bench)
    return bench


def _check_reach(bench: Bench) -> None:
    network = bench.network
    if (bench.certificate is None) != (bench.key is None):
        raise ConfigError("network.certificate and network.key go together: give both, or none.")
    if not bench.beyond_loopback:
        return
    if bench.token is None:
        raise ConfigError(
            f'network.host = "{network.host}" lets other machines move the rig, and nothing asks '
            "who they are. Give network.token_file (a file with a secret of at least "
            f'{MIN_TOKEN} characters), or host = "127.0.0.1".'
        )
    if bench.certificate is None and not network.allow_plain_http:
        raise ConfigError(
            f'network.host = "{network.host}" without TLS would send the token in clear: whoever '
            "listens on that network could then move the rig. Give network.certificate and "
            "network.key, or write allow_plain_http = true if the network is yours alone."
        )


def _experiments(
    patterns: tuple[str, ...], beside: Path
) -> tuple[dict[str, Experiment], dict[str, str]]:
    found: dict[str, Path] = {}
    for pattern in patterns:
        places = [path for folder in (beside, *SHIPPED) for path in _matches(folder, pattern)]
        if not places:
            raise ConfigError(
                f'experiments: nothing is called "{pattern}" beside the file, or among those that '
                "ship. Correct the name."
            )
        for path in places:
            found.setdefault(path.stem, path)
    experiments = {name: load_experiment(path) for name, path in sorted(found.items())}
    return experiments, {name: found[name].read_text() for name in experiments}


def _matches(folder: Path, pattern: str) -> list[Path]:
    if Path(pattern).is_absolute():
        return [Path(pattern)] if Path(pattern).is_file() else []
    return sorted(path for path in folder.glob(pattern) if path.is_file())


def _folder(path: Path, what: str, mode: int = 0o755) -> Path:
    try:
        path.mkdir(mode=mode, parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ConfigError(
            f"{what} = {str(path)!r} cannot be made a folder: {error}. Name another."
        ) from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise ConfigError(f'{what} = "{path}" may not be written to. Name another, or allow it.')
    return path.resolve()


def _file(name: str | None, beside: Path, key: str) -> Path | None:
    if name is None:
        return None
    path = beside / name
    if not path.is_file():
        raise ConfigError(f'{key} = "{name}": there is no file {path}. Correct the path.')
    return path.resolve()


def _token(network: NetworkConfig, beside: Path) -> str | None:
    path = _file(network.token_file, beside, "network.token_file")
    if path is None:
        return None
    try:
        token = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as a token: {error}.") from error
    if len(token) < MIN_TOKEN:
        raise ConfigError(
            f"{path} holds a token of {len(token)} characters, and at least {MIN_TOKEN} are "
            "needed. Make one with: openssl rand -hex 32"
        )
    return token


def accepted_hosts(bench: Bench) -> frozenset[str]:
    """The names that a request's Host may have, in lower case."""
    own: tuple[Any, ...] = (*LOOPBACK_NAMES, bench.network.host, *bench.network.hosts)
    return frozenset(str(name).lower().strip("[]") for name in own)
