"""One recording as the catalogue lists it.

`state` is one of

    complete     the whole schedule was played
    stopped      the operator asked it to end
    faulted      the run ended with an error, which `sentence` says
    cut          the file ended before its run did, or is still being written
    unreadable   no recording of ours, damaged beyond use, or not to be opened; `sentence` says why
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import PurePath
from typing import Any, Literal

State = Literal["complete", "stopped", "faulted", "cut", "unreadable"]

ID_DIGITS = 16
LONGEST_TEXT = 200
DEEPEST = 20


@dataclass(frozen=True, slots=True)
class Run:
    """A line of the catalogue; all texts are printable, whatever the file was called.

    id           of the path below the folder: the same after a rebuild, known before a run begins
    name         as the run was called, else the file's name without its ending
    file         the path below the folder, for people; `Catalogue.path(id)` is what to open
    excitation   as "m-sequence 15341 at 2.618 rad/s"; empty where no experiment was recorded
    started_utc  ISO 8601; the file's time where it does not say
    seconds      of the samples, skipped slots included; None where nothing tells
    missed       skipped slots; None where nothing tells
    figures      the scalars of the analysis beside the recording, in SI
    verdict      "named", "none", "unknown", or None where no diagnosis is beside the recording
    """

    id: str
    name: str
    file: str
    state: State
    sentence: str
    started_utc: str
    bytes: int
    experiment: str = ""
    excitation: str = ""
    rig: str = ""
    seconds: float | None = None
    missed: int | None = None
    operator: str = ""
    notes: str = ""
    tags: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    verdict: str | None = None
    causes: tuple[str, ...] = ()

    def row(self) -> dict[str, Any]:
        """The line as plain values, ready for JSON."""
        table = asdict(self)
        return {**table, "tags": list(self.tags), "causes": list(self.causes)}

    def json(self) -> str:
        """The line as JSON text."""
        return json.dumps(self.row(), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Run":
        """The line that `json` wrote."""
        table = json.loads(text)
        return cls(**{**table, "tags": tuple(table["tags"]), "causes": tuple(table["causes"])})

    @property
    def words(self) -> str:
        """Everything that a search looks at, in lower case."""
        shown = (
            *(self.name, self.file, self.experiment, self.excitation, self.rig, self.operator),
            *(self.notes, self.state, self.sentence, self.verdict or "", *self.tags, *self.causes),
        )
        return "\n".join(shown).casefold().encode(errors="replace").decode()


def run_id(file: PurePath) -> str:
    """The id of a recording from its path below the folder: 16 hexadecimal digits."""
    name = os.fsencode(file.as_posix())
    return hashlib.sha256(name).hexdigest()[:ID_DIGITS]


def printable(text: object, longest: int = LONGEST_TEXT) -> str:
    """`text` on one line, without what a terminal or a page would obey or cannot show."""
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(text))
    return shown if len(shown) <= longest else shown[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"


def plain(value: Any, deepest: int = DEEPEST) -> Any:
    """A value out of a file as every reader of JSON takes it: text that is Unicode, and None for
    what is no finite number or lies deeper than so many levels."""
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict | list) and deepest == 0:
        return None
    if isinstance(value, dict):
        return {plain(str(key)): plain(one, deepest - 1) for key, one in value.items()}
    return [plain(one, deepest - 1) for one in value] if isinstance(value, list) else value
