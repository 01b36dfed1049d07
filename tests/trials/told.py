"""A diagnoser that finds nothing and tells what it was given: for the tests of the process wall.

    python PATH/told.py REC --holdout REC --rig TOML --json OUT [--without EFFECT ...]

It is run by its path, in the folder with the files, and imports nothing of the trials.
"""

import json
import os
import sys
from pathlib import Path


def main(arguments: list[str]) -> None:
    """Write a verdict "none" whose notes are all that this process can see."""
    seen = [
        " ".join(arguments),
        " ".join(f"{name}={value}" for name, value in sorted(os.environ.items())),
        *(
            f"{path.name}: {path.read_bytes().decode('latin-1')}"
            for path in sorted(Path.cwd().iterdir())
        ),
        " ".join(str(path) for path in sorted(Path.cwd().parent.iterdir())),
    ]
    out = Path(arguments[arguments.index("--json") + 1])
    out.write_text(json.dumps({"verdict": "none", "sentence": "Nothing.", "notes": seen}))


if __name__ == "__main__":
    main(sys.argv[1:])
