"""What the machine did to a loop is left out of its figures; what it did itself is not."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from servo_bench.benchmark.lateness import Lateness
from servo_bench.benchmark.reference import STOLEN_S, Reference, outside, stolen_windows
from servo_bench.recording.recording import Recording

MS_NS = 1_000_000
ROWS = 100
QUIET_NS = 40_000


class Told:
    """A reference loop that has ended."""

    def __init__(self, late_ns: NDArray[np.int64]) -> None:
        self._rows = np.arange(late_ns.size, dtype=np.int64) * MS_NS + MS_NS // 2, late_ns

    def rows(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return self._rows


def judged(late_s: NDArray[np.float64], *references: NDArray[np.int64]) -> Lateness:
    rows = {"asked_ns": np.arange(late_s.size, dtype=np.int64) * MS_NS, "lateness_s": late_s}
    told = [cast(Reference, Told(late_ns)) for late_ns in references]
    return Lateness.of(cast(Recording, rows), told, MS_NS)


def quiet(cycles: int = ROWS + 10) -> NDArray[np.int64]:
    return np.full(cycles, QUIET_NS, np.int64)


def test_a_hole_of_any_processor_is_left_out_and_nothing_else() -> None:
    late_s, hole = np.full(ROWS, 3e-5), quiet()
    hole[40] = 5 * MS_NS  # from 40.5 ms to 45.5 ms
    late_s[41:46] = 4e-3
    for references in ((hole, quiet()), (quiet(), hole)):
        found = judged(late_s, *references)
        assert found.all_s.size == ROWS
        assert found.clean_s.size == ROWS - 7  # 40 to 46, a period around it with them
        assert found.clean_s.max() == 3e-5
        assert found.reference_s.max() == 5e-3


def test_a_loop_that_is_late_by_itself_has_no_excuse() -> None:
    late_s = np.full(ROWS, 3e-5)
    late_s[50] = 4e-3
    assert judged(late_s, quiet(), quiet()).clean_s.max() == 4e-3


def test_a_reference_within_the_limit_excuses_nothing() -> None:
    almost = quiet()
    almost[50] = round(STOLEN_S * 1e9)
    assert judged(np.full(ROWS, 3e-5), almost).clean_s.size == ROWS


def test_what_no_reference_saw_is_not_called_clean() -> None:
    assert judged(np.full(ROWS, 3e-5), quiet(60)).clean_s.size == 60


def test_several_runs_are_one_and_no_hole_leaves_all() -> None:
    one, other = judged(np.full(ROWS, 3e-5), quiet()), judged(np.full(ROWS, 5e-5), quiet())
    both = Lateness.together([one, other])
    assert both.clean_s.size == 2 * ROWS
    assert both.figures()["clean"]["max_us"] == 50.0
    none = stolen_windows(np.arange(3, dtype=np.int64), np.zeros(3, np.int64))
    assert outside(np.arange(3, dtype=np.int64), none, MS_NS).all()
