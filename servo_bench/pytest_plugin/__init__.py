"""A pytest plugin: the software rig, the bench, and recordings in tests of your own.

    def test_friction_is_found(sim_rig, bench):
        rig = sim_rig("rigs/paper.toml", effects={"coulomb": {"torque_nm": 0.01}})
        run = bench.run("experiments/demo.toml", rig)
        assert bench.diagnose(run).causes[0].effect == "coulomb"

Virtual time (44 s in less than one) unless `sim_rig(..., wire=True)`. Every test that fails after
a run leaves one HTML page. Nothing of the bench is imported before a test asks for a fixture.
"""

from collections.abc import Generator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from servo_bench.pytest_plugin.files import Recordings
    from servo_bench.pytest_plugin.rigs import Rigs
    from servo_bench.pytest_plugin.workbench import Bench

REPORTS = "servo_bench_reports"
RECORDINGS = "servo_bench_recordings"
DEFAULT_REPORTS = "servo-bench-reports"
BENCH = pytest.StashKey["Bench"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options and ini keys."""
    group = parser.getgroup("servo-bench")
    group.addoption(
        "--servo-bench-reports",
        metavar="DIR",
        default=None,
        help="Folder for the page of each failed test; empty for none (ini: servo_bench_reports).",
    )
    group.addoption(
        "--permit-real-rig",
        action="store_true",
        help="Let bench.run move a rig that is not a software rig of the test's own.",
    )
    parser.addini(REPORTS, "Folder for the page of each failed test.", default=DEFAULT_REPORTS)
    parser.addini(RECORDINGS, "Folder in which the fixture `recording` looks.", default="")


@pytest.fixture
def sim_rig(request: pytest.FixtureRequest) -> "Generator[Rigs]":
    """Make software rigs: `sim_rig(rig, effects=, faults=, seed=, wire=False)`."""
    from servo_bench.pytest_plugin.rigs import Rigs  # noqa: PLC0415 - imports numpy and more

    with Rigs(request.path.parent) as rigs:
        yield rigs


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> "Bench":
    """Run experiments, analyse, diagnose, compare; what was run goes into the failure's page."""
    from servo_bench.pytest_plugin.workbench import Bench  # noqa: PLC0415

    made = Bench(
        folder=request.path.parent,
        scratch=request.getfixturevalue("tmp_path"),
        permitted=bool(request.config.getoption("--permit-real-rig")),
        note=lambda name, value: request.node.user_properties.append((name, value)),
    )
    request.node.stash[BENCH] = made
    return made


@pytest.fixture
def recording(request: pytest.FixtureRequest) -> "Recordings":
    """Read recordings: `recording("run.mcap")`, beside the test or in servo_bench_recordings."""
    from servo_bench.pytest_plugin.files import Recordings  # noqa: PLC0415

    wanted = str(request.config.getini(RECORDINGS))
    folders = [request.path.parent, request.config.rootpath / wanted]
    return Recordings(tuple(folders))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[Any]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """After a failure: the page, its place in the test's output and in the JUnit properties."""
    report = yield
    bench = item.stash.get(BENCH, None)
    if report.failed and call.when != "teardown" and bench is not None:
        from servo_bench.pytest_plugin.failure import write_page  # noqa: PLC0415

        folder = item.config.getoption("--servo-bench-reports")
        wanted = item.config.getini(REPORTS) if folder is None else folder
        if wanted:
            place = item.config.rootpath / str(wanted)
            told = write_page(place, item.nodeid, report.longreprtext, bench.recordings)
            report.sections.append(("servo-bench", told))
            item.user_properties.append(("servo_bench.report", told))  # JUnit's comes at teardown
    return report
