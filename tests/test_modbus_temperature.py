"""The drive's temperature on Modbus: read where it has a limit, and a trip above it."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.modbus import profile as names
from drivers.modbus.library import load_profile
from drivers.modbus.plan import plan_of, unused_items
from servo_bench.errors import LimitError
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.finding import Level
from servo_bench.run.preflight import preflight
from servo_bench.run.session import run
from servo_bench.run.supervisor import Supervisor
from servo_bench.run.table import SlotTable
from sim_rig.process import spawn
from tests.test_sync_by_drive import PLAN


def rig(limit_c: float | None, really_c: float = 35.0) -> RigConfig:
    plain = load_rig("rigs/modbus-tcp.toml")
    assert plain.simulated is not None
    simulated = plain.simulated.model_copy(update={"drive_temperature_c": really_c})
    limits = plain.limits.model_copy(update={"drive_temperature_c": limit_c})
    return plain.model_copy(update={"limits": limits, "simulated": simulated})


def words(*, limits_temperature: bool) -> tuple[int, set[str]]:
    without = unused_items(has_load=True, limits_temperature=limits_temperature)
    (exchange,) = plan_of(load_profile("generic"), without).exchanges
    assert exchange.read is not None
    return exchange.read.count, {name for name, _, _ in exchange.read.items}


def test_it_is_read_only_where_it_has_a_limit_and_costs_nothing_elsewhere() -> None:
    limited, plain = words(limits_temperature=True), words(limits_temperature=False)
    assert limited[1] - plain[1] == {names.TEMPERATURE}
    assert limited[0] == plain[0] + 2, "the error code lies between"
    for limit_c in (None, 70.0):
        plan = rig(limit_c).modbus_settings(0.008).plan
        assert plan.exchanges[0].read is not None
        assert plan.exchanges[0].read.count == (limited if limit_c else plain)[0]


def test_the_supervisor_takes_it_from_the_samples_where_its_line_asks_nothing() -> None:
    judge = SimpleNamespace(period_s=0.008, wants_temperature=True)
    line = SimpleNamespace(temperature_c=lambda: None)
    with SlotTable.create(4) as table:
        supervisor = Supervisor(table, -1, judge, lambda *_told, **_data: None)
        assert supervisor._temperature_c(line, 1) is None
        table.temperature_c = 71.25
        second_ns = 1_000_000_000
        assert supervisor._temperature_c(line, 2) is None, "once a second"
        assert supervisor._temperature_c(line, 2 * second_ns) == 71.25
        assert supervisor._temperature_c(None, 4 * second_ns) == 71.25


def test_preflight_says_where_nobody_tells_it() -> None:
    (told,) = [it for it in preflight(PLAN, rig(70.0)) if it.subject == "temperature"]
    assert told.level is Level.OK
    paper = load_rig("rigs/paper.toml")
    limits = paper.limits.model_copy(update={"drive_temperature_c": 70.0})
    silent = paper.model_copy(update={"limits": limits})
    (missing,) = [it for it in preflight(PLAN, silent) if it.subject == "temperature"]
    assert missing.level is Level.CHANGE
    assert "watches nothing" in missing.text


@pytest.mark.wire
@pytest.mark.parametrize(("really_c", "trips"), [(69.9, False), (70.1, True)])
def test_a_drive_that_is_too_hot_ends_the_run(really_c: float, trips: bool, tmp_path: Path) -> None:
    hot = rig(70.0, really_c).on_a_free_port()
    with spawn(hot.simulation_settings()) as simulated:
        if not trips:
            assert run(PLAN, hot.with_bus(**simulated.bus), tmp_path / "run.mcap").played > 100
            return
        with pytest.raises(LimitError, match=r"drive's temperature reached 70\.1 °C.*limit is 70"):
            run(PLAN, hot.with_bus(**simulated.bus), tmp_path / "run.mcap")
