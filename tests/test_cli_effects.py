"""`servo-bench effects`: the catalogue as an operator reads it, and computed signatures."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.cli import effects as command
from servo_bench.diagnosis.judging.domains import ORDERS, Domains, domains
from servo_bench.diagnosis.judging.signature import Signature, cosine, rivals, signatures
from servo_bench.errors import ConfigError
from servo_bench.report.effect_words import overview, range_of, unit_of
from sim_rig.effects import catalogue
from sim_rig.effects.units import SUFFIXES
from sim_rig.errors import EffectError

CHIPS = 1024
PURE = ("order", "fraction", "ratio", "exponent", "probability", "seed", "scale", "count")
DOCS = Path(__file__).parent.parent / "docs"


def call(*words: str | Path) -> tuple[int, str, BaseException | None]:
    done = CliRunner(env={"COLUMNS": "200"}).invoke(cli.app, [str(word) for word in words])
    return done.exit_code, done.output, done.exception


@pytest.fixture(scope="module")
def every() -> dict[str, Signature]:
    return signatures(chips=CHIPS)


@pytest.fixture(scope="module")
def found(every: dict[str, Signature]) -> Callable[[str], Domains]:
    return lambda name: domains(every[name])


class TestList:
    def test_names_port_law_main_parameter_and_confusions(self) -> None:
        code, output, _ = call("effects")
        assert code == 0
        words = " ".join(output.split())
        for effect in catalogue().values():
            main = effect.parameters[0]
            assert f"{main.name}: {range_of(main)}" in words, effect.name
            for word in (effect.name, effect.port.value, *effect.confused_with):
                assert word in words
        assert f"{len(catalogue())} effects" in words

    def test_the_docs_have_the_same_table(self) -> None:
        assert call("effects", "--markdown")[1] == overview()
        assert (DOCS / "effects.md").read_text(encoding="utf-8") == overview()

    @pytest.mark.parametrize("ending", SUFFIXES)
    def test_every_ending_has_a_unit_or_is_a_pure_number(self, ending: str) -> None:
        assert (unit_of(f"x{ending}") == "") == (ending in PURE)


class TestShow:
    @pytest.fixture(autouse=True)
    def _shorter(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(command, "signatures", partial(signatures, chips=128))

    def test_prints_the_file_s_words_and_what_was_computed(self) -> None:
        code, output, _ = call("effects", "show", "cogging")
        assert code == 0
        assert "    tau = sum_k T_k sin(n_k theta + phi_k)" in output
        for parameter in catalogue()["cogging"].parameters:
            assert parameter.name in output
        for word in ("Hendershot", "torque_ripple *", "position x direction", "Computed"):
            assert word in output

    @pytest.mark.parametrize(
        "name", ["cogging", pytest.param("quantisation", marks=pytest.mark.long)]
    )
    def test_writes_a_page_with_what_was_computed(self, tmp_path: Path, name: str) -> None:
        out = tmp_path / "page.html"
        assert call("effects", "show", name, "--out", out)[0] == 0
        text = out.read_text(encoding="utf-8")
        assert text.count("<svg ") == 3
        assert "<script" not in text
        assert "http-equiv" in text
        computed = signatures(chips=128)
        for rival in rivals(name, computed):
            cells = "".join(f'<td class="number">{value:+.2f}</td>' for value in rival.cosines)
            assert f'<th scope="row">{rival.name}</th>{cells}' in text
        for values in domains(computed[name]).shares.values():
            cells = "".join(f'<td class="number">{100.0 * value:.1f} %</td>' for value in values)
            assert cells in text

    def test_writes_a_picture(self, tmp_path: Path) -> None:
        out = tmp_path / "picture.png"
        assert call("effects", "show", "command_offset", "--out", out)[0] == 0
        content = out.read_bytes()
        assert content.startswith(b"\x89PNG")
        width = int.from_bytes(content[16:20], "big")
        assert 1000 < width < 1200


class TestWhatIsRefusedBeforeAnythingIsComputed:
    @pytest.fixture(autouse=True)
    def _never(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def never() -> dict[str, Signature]:
            raise AssertionError("computed")

        monkeypatch.setattr(command, "signatures", never)

    def test_an_effect_that_does_not_exist(self) -> None:
        _, _, error = call("effects", "show", "friction")
        assert isinstance(error, EffectError)
        assert "'friction'" in str(error)
        assert "coulomb" in str(error)

    def test_a_file_that_is_neither_page_nor_picture(self, tmp_path: Path) -> None:
        _, _, error = call("effects", "show", "cogging", "--out", tmp_path / "x.svg")
        assert isinstance(error, ConfigError)
        assert ".html or .png" in str(error)

    def test_a_file_that_is_there(self, tmp_path: Path) -> None:
        there = tmp_path / "there.html"
        there.write_text("precious")
        _, _, error = call("effects", "show", "cogging", "--out", there)
        assert isinstance(error, ConfigError)
        assert there.read_text() == "precious"


class TestSignatures:
    """What is known about an effect must come out of its simulation."""

    @pytest.mark.parametrize(
        ("name", "domain", "channel"),
        [
            ("cogging", "position", 2),
            ("encoder_eccentricity", "position", 0),
            ("misalignment", "position", 0),
            ("encoder_subdivision", "position", 0),
            ("torque_ripple", "position x current", 2),
            ("position_friction", "position x direction", 2),
            ("coulomb", "velocity", 2),
            ("viscous", "velocity", 2),
            ("transport_delay", "after an edge", 2),
            ("command_slew", "after an edge", 2),
            ("command_offset", "drift", 0),
        ],
    )
    def test_it_shows_where_it_must(
        self, found: Callable[[str], Domains], name: str, domain: str, channel: int
    ) -> None:
        shares = {key: values[channel] for key, values in found(name).shares.items()}
        assert max(shares, key=lambda key: shares[key]) == domain, shares
        assert shares[domain] > 0.4

    @pytest.mark.parametrize(
        ("name", "channel", "order"),
        [
            ("cogging", 2, 24),
            ("encoder_eccentricity", 0, 1),
            ("misalignment", 0, 2),
            ("encoder_subdivision", 0, 2048),
        ],
    )
    def test_its_line_has_its_order(
        self, found: Callable[[str], Domains], name: str, channel: int, order: int
    ) -> None:
        assert ORDERS[found(name).lines.plain[channel].argmax()] == order

    def test_an_encoder_s_error_is_not_in_the_current(self, every: dict[str, Signature]) -> None:
        for name in ("encoder_eccentricity", "misalignment", "encoder_subdivision"):
            assert not every[name].current_a.any()

    def test_inertia_is_torque_constant_reversed(self, every: dict[str, Signature]) -> None:
        (rival,) = (r for r in rivals("inertia_error", every) if r.name == "torque_constant_error")
        assert rival.declared
        assert rival.cosines[0] < -0.9
        assert rival.cosines[2] < -0.9

    def test_what_looks_alike_in_every_channel_is_declared(
        self, every: dict[str, Signature]
    ) -> None:
        for name in every:
            for rival in rivals(name, every, most=len(every)):
                if min(abs(value) for value in rival.cosines) > 0.95:
                    assert rival.declared, (name, rival)


def test_cosine() -> None:
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, 500))
    t = np.linspace(0.0, 20.0 * math.tau, 500, endpoint=False)
    assert cosine(a, 3.0 * a) == pytest.approx(1.0)
    assert cosine(a, -a) == pytest.approx(-1.0)
    assert cosine(a, b) == pytest.approx(cosine(b, a))
    assert cosine(a, 0.0 * a) == 0.0
    assert cosine(np.sin(t), np.cos(t)) == pytest.approx(0.0, abs=1e-12)
    assert cosine(np.sin(t + 0.3), np.cos(t), 5.0 * np.cos(t + 1.0)) == pytest.approx(1.0)
