"""The API against its own OpenAPI description: whatever is asked, the answer is one it promises.

    python -m tests.extended.daemon_fuzz --examples 100 --seed 1

Schemathesis makes requests that fit the description and requests that do not; no answer may be a
fault of the daemon, and each must be as described. Ends with status 1 at the first that is not.
"""

import argparse
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.daemon_process import Daemon, write_bench

RECORDINGS = Path(__file__).parent.parent.parent / "recordings"
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
NETWORK = "port = 0\nrequests_per_second = 100000.0\nrequest_burst = 100000"


def ask_everything(daemon: Daemon, examples: int, number: int) -> int:
    """Every operation, `examples` requests of each kind; how many were asked.

    Raises what schemathesis finds.
    """
    description = httpx.get(f"{daemon.url}/openapi.json").json()
    asked = 0
    for found in schemathesis.openapi.from_dict(description).get_all_operations():
        operation = found.ok()
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            strategy = operation.as_strategy(generation_mode=mode)

            @seed(number)
            @settings(
                max_examples=examples,
                deadline=None,
                database=None,
                phases=[Phase.generate],
                suppress_health_check=list(HealthCheck),
            )
            @given(case=strategy)
            def ask(case: Any) -> None:
                nonlocal asked
                asked += 1
                answer = case.call(base_url=daemon.url)
                case.validate_response(answer, checks=CHECKS)

            with suppress(Unsatisfiable):  # what has no parameters cannot be asked wrongly
                ask()
            assert daemon.process.poll() is None, "the daemon has ended"
            sys.stdout.write(f"{operation.label} ({mode.value}): well\n")
            sys.stdout.flush()
    return asked


def main() -> None:
    """Read the options, start a daemon, ask."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = write_bench(folder, seconds={"short": 1.0}, network=NETWORK)
        (folder / "recordings").mkdir()
        shutil.copy(RECORDINGS / "nominal.mcap", folder / "recordings")
        with Daemon(bench) as daemon:
            asked = ask_everything(daemon, options.examples, options.seed)
    sys.stdout.write(f"{asked} requests, every answer as promised\n")


if __name__ == "__main__":
    main()
