"""The benchmark's parts on one seed: its figures are reached, and it says what it needs."""

import json

import pytest

from servo_bench.benchmark import volterra
from servo_bench.errors import ConfigError
from tests.truth import volterra_plants


@pytest.mark.long
def test_the_papers_figures_and_their_ceilings_are_reproduced() -> None:
    numbers = json.loads(json.dumps(volterra.paper(volterra_plants)))
    for plant, tolerance in (("zero", 0.3), ("no_zero", 0.5)):
        for name, reference in numbers[f"{plant}_reference"].items():
            assert numbers[plant][name] == pytest.approx(reference, abs=tolerance)
        reached = numbers["ceiling_percent"][plant]
        reference = numbers["ceiling_reference_percent"][plant]
        assert reached["memory_18"] == pytest.approx(reference, abs=0.1)
        assert reached["memory_34"] > reached["memory_18"]


def test_structured_figures_are_reached_on_a_seed() -> None:
    figures = volterra.structured(volterra_plants, (7,))
    assert min(entry["worst"] for entry in figures["play"].values()) >= figures["wanted"]
    assert min(entry["worst"] for entry in figures["grey-box"].values()) >= figures["wanted"]


def test_the_speed_is_measured_beside_its_reference() -> None:
    figures = json.loads(json.dumps(volterra.speed(1)))
    for degree in (14, 20):
        assert figures[f"transform_degree_{degree}"]["ms"] > 0.0
    assert figures["extraction_peak_bytes_per_chip"] < 100.0


def test_plants_that_are_not_there_are_named() -> None:
    with pytest.raises(ConfigError, match=r"no_such_plants, cannot be imported.*checkout"):
        volterra.measure((1,), "no_such_plants")
