"""The daemon without the command line around it: `python -m servo_bench.daemon bench.toml`."""

import sys

from servo_bench.daemon.config import load_bench
from servo_bench.daemon.serve import serve
from servo_bench.errors import BenchError


def main(config: str) -> int:
    """Serve; the exit code of `servo-bench daemon`."""
    try:
        serve(load_bench(config))
    except BenchError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "bench.toml"))
