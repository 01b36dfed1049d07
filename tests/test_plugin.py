"""The pytest plugin, used as a stranger's project uses it: in a pytest of its own."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servo_bench.excitation.enumeration import primitive_polynomials
from servo_bench.pytest_plugin.failure import page_name

ROOT = Path(__file__).parent.parent
Stranger = Callable[..., pytest.RunResult]
SMALL = """
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary

SMALL = Experiment(
    name="small", rig="none", period_s=0.008, memory=9, standstill_s=0.8, lead_in=64,
    identification=MSequence(polynomial="1021", amplitude_rad_s=2.6),
    validation=RandomBinary(kind="random-binary", seed=1, amplitude_rad_s=2.6, length=200),
)
"""


pytest_plugins = ["pytester"]


@pytest.fixture(scope="module", autouse=True)
def _compiler_is_there() -> None:
    """What a pytest within this process imports is forgotten at its end, and the compiler cannot be
    imported twice: whoever compiles in this process afterwards would fail."""
    primitive_polynomials(5)


@pytest.fixture
def stranger(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Stranger:
    """A pytest of its own in this process, with this plugin and no other from outside."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    pytester.makeini("[pytest]\n")

    def run(text: str, *words: str) -> pytest.RunResult:
        pytester.makepyfile(test_it=SMALL + text)
        own = ("-p", "servo_bench.pytest_plugin", "-p", "no:cacheprovider")
        return pytester.runpytest_inprocess(*own, *words)

    return run


def test_the_entry_point_names_the_plugin_and_importing_it_costs_nothing() -> None:
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    assert import_module(points["pytest11"]["servo_bench"]).__name__ == "servo_bench.pytest_plugin"
    heavy = "numpy, scipy, numba, pydantic, canopen, can, matplotlib, drivers, sim_rig"
    text = (
        "import sys; import servo_bench.pytest_plugin; "
        f"sys.exit(' '.join(set('{heavy}'.split(', ')) & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""


GOOD = """
import pytest
from servo_bench.errors import ConfigError, WireError

def test_kernels(sim_rig, bench):
    run = bench.run(SMALL, sim_rig(effects={"coulomb": {"torque_nm": 0.01}}, seed=7))
    assert bench.analyse(run).numbers()["vaf_fresh_order3_percent"] > 50
    assert run.rig.simulated is None, "the hidden effect is not in the recording"

def test_a_fault(sim_rig, bench):
    with pytest.raises(WireError, match="DC link"):
        bench.run(SMALL, sim_rig(faults="emcy node=drive code=0x3220 at=120"))
    assert len(bench.recordings[0]) > 100

@pytest.mark.parametrize("wrong", [
    {"effects": {"no-such": {}}}, {"effects": {"coulomb": {"x": 1}}}, {"faults": "no-such"},
    {"gap": 3}, {"backlash_gap_rad": -1.0}, {"rig": "no-such.toml"}, {"seed": -1},
])
def test_a_rig_that_cannot_be(sim_rig, wrong):
    with pytest.raises(ConfigError):
        sim_rig(**wrong)

def test_no_real_rig_without_permission(sim_rig, bench):
    with pytest.raises(ConfigError, match="--permit-real-rig"):
        bench.run(SMALL, sim_rig().config)

def test_no_bus_in_virtual_time(sim_rig):
    with pytest.raises(ConfigError, match="wire=True"):
        sim_rig().bus
"""


def test_rigs_runs_refusals_and_properties(stranger: Stranger, pytester: pytest.Pytester) -> None:
    stranger(GOOD, "--junitxml", "out.xml").assert_outcomes(passed=11)
    root = ElementTree.parse(pytester.path / "out.xml").getroot()  # noqa: S314 - our own file
    found = {str(place.get("name")): str(place.get("value")) for place in root.iter("property")}
    assert float(found["servo_bench.vaf_fresh_order3_percent"]) > 50.0
    assert found["servo_bench.run1"].startswith("small on paper: ")
    assert not (pytester.path / "servo-bench-reports").exists()


BAD = """
import pytest

@pytest.mark.parametrize("name", ["a/b", "<img src=x>"])
def test_too_much_asked(sim_rig, bench, name):
    run = bench.run(SMALL, sim_rig())
    assert len(run) < 0, name

def test_without_a_run(bench):
    assert False, "before any run"

def test_that_asks_for_nothing():
    assert False
"""


@pytest.mark.long
def test_every_failure_that_used_the_bench_leaves_one_page(
    stranger: Stranger, pytester: pytest.Pytester
) -> None:
    done = stranger(BAD, "--servo-bench-reports", "pages", "--junitxml", "o.xml")
    done.assert_outcomes(failed=4)
    pages = sorted((pytester.path / "pages").glob("*.html"))
    assert len(pages) == 3
    texts = [page.read_text(encoding="utf-8") for page in pages]
    assert sum("<svg" in text for text in texts) == 2
    assert all("<img src=x>" not in text for text in texts)
    assert sum("had recorded no run" in text for text in texts) == 1
    told = (pytester.path / "o.xml").read_text()
    assert all(page.name in told for page in pages)


def test_pages_can_be_switched_off(stranger: Stranger, pytester: pytest.Pytester) -> None:
    stranger(BAD, "--servo-bench-reports=", "-k", "without").assert_outcomes(failed=1, deselected=3)
    assert not (pytester.path / "servo-bench-reports").exists()


@given(st.text(), st.text())
def test_pages_of_two_tests_have_two_names(one: str, other: str) -> None:
    names = {page_name(one), page_name(other)}
    assert len(names) == len({one, other})
    assert all("/" not in name and len(name) < 120 for name in names)


FILES = """
import pytest
from servo_bench.errors import RecordingError

def test_beside(recording):
    assert len(recording("nominal.mcap")) == 5497

def test_nowhere(recording):
    with pytest.raises(RecordingError, match="looked for"):
        recording("no-such.mcap")
"""


def test_recordings_are_found_where_the_project_says(stranger: Stranger) -> None:
    folder = f"servo_bench_recordings={ROOT / 'recordings'}"
    stranger(FILES, "-o", folder).assert_outcomes(passed=2)


IN_A_FIXTURE = """
import pytest

@pytest.fixture
def played(sim_rig, bench):
    run = bench.run(SMALL, sim_rig())
    assert len(run) < 0

def test_of_what_was_played(played):
    pass
"""


@pytest.mark.long
def test_a_failure_in_a_fixture_after_a_run_leaves_its_page_too(
    stranger: Stranger, pytester: pytest.Pytester
) -> None:
    stranger(IN_A_FIXTURE, "--servo-bench-reports", "pages").assert_outcomes(errors=1)
    (page,) = (pytester.path / "pages").glob("*.html")
    assert "<svg" in page.read_text(encoding="utf-8")
