"""The pages: self-contained, escaped, complete, and with the figures of the JSON."""

import json
from dataclasses import replace

import pytest

from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.kernels.paper_simulation import PaperResult, simulate_paper
from servo_bench.report.html import analysis_report, headline, paper_report
from tests.reported_run import HOSTILE, Page, flat, hostile_run, short_run


@pytest.fixture(scope="module")
def analysis() -> Analysis:
    return analyse(short_run())


@pytest.fixture(scope="module")
def html(analysis: Analysis) -> str:
    return analysis_report(analysis, short_run())


@pytest.fixture(scope="module")
def result() -> PaperResult:
    return simulate_paper(seeds=(1,))


@pytest.fixture(scope="module")
def paper_html(result: PaperResult) -> str:
    return paper_report(result)


@pytest.fixture(params=["html", "paper_html"])
def page(request: pytest.FixtureRequest) -> Page:
    return Page(request.getfixturevalue(request.param))


def test_a_page_takes_nothing_from_outside_and_runs_nothing(page: Page) -> None:
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(page.tags)
    loading = {"src", "href", "xlink:href", "data", "action", "srcset", "poster"}
    taken = [value for name, value in page.attributes if name in loading]
    assert taken
    assert all(value.startswith(("#", "data:image/png;base64,")) for value in taken)
    assert not any(name.startswith("on") for name, _ in page.attributes)
    styles = [value for name, value in page.attributes if name == "style"]
    assert not any("url(h" in style or "url(/" in style for style in styles)
    assert "@import" not in page.text


def test_every_id_is_alone_on_its_page_and_every_reference_finds_it(page: Page) -> None:
    ids = [value for name, value in page.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    used = {
        value[1:] for name, value in page.attributes if name == "xlink:href" and value[0] == "#"
    }
    clips = {value[5:-1] for name, value in page.attributes if name == "clip-path"}
    assert used
    assert clips
    assert used | clips <= set(ids)


def test_the_experiments_figures_are_all_there(html: str) -> None:
    page = Page(html)
    assert page.tags.count("svg") == page.tags.count("figcaption") == 8
    for number in ("7", "8", "9", "10"):
        assert f"Figure {number} of the paper" in page.text


def test_the_simulations_figures_are_there_for_both_plants(paper_html: str) -> None:
    page = Page(paper_html)
    assert page.tags.count("svg") == page.tags.count("figcaption") == 6
    for number in ("2", "3", "4"):
        assert page.text.count(f"Figure {number} of the paper") == 2


def test_the_pages_figures_are_those_of_the_json(analysis: Analysis, html: str) -> None:
    assert Page(html).figures() == flat(json.loads(json.dumps(analysis.numbers())))


def test_the_simulations_figures_are_those_of_the_json(
    result: PaperResult, paper_html: str
) -> None:
    page = Page(paper_html)
    assert page.figures() == flat(json.loads(json.dumps(result.numbers())))
    for plant in (result.zero, result.no_zero):
        for vaf in plant.numbers().values():
            assert f"{vaf:.2f} %" in page.text


def test_the_first_sentence_is_the_result(analysis: Analysis, html: str) -> None:
    assert analysis.validation is not None
    fresh = analysis.validation.velocity
    sentence = headline(analysis)
    assert f"held-out output to {fresh.vaf_order3_percent:.1f} % VAF" in sentence
    assert f"linear alone {fresh.vaf_order1_percent:.1f} %" in sentence
    assert f"0 of {analysis.quality.slots} slots missed" in sentence
    text = Page(html).text
    assert text.index(sentence) < text.index("VAF, fresh") < text.index("VAF, same period")


def test_quantities_are_in_degrees_with_their_unit(analysis: Analysis, html: str) -> None:
    text = Page(html).text
    assert "150 deg/s" in text
    assert "rad/s" not in text.split("All figures, in SI")[0].replace("A s/rad", "")


@pytest.mark.long
def test_markup_in_a_recording_stays_text() -> None:
    run = hostile_run()
    html = analysis_report(analyse(run), run)
    page = Page(html)
    assert "<script" not in html
    assert "script" not in page.tags
    assert page.text.count(HOSTILE) >= 7  # name, rig twice, bus, provenance, event


def test_flags_and_unusual_events_come_before_the_figures(analysis: Analysis) -> None:
    flagged = replace(analysis, flags=("The coupling slipped & moved.",))
    run = hostile_run()
    text = Page(analysis_report(flagged, run)).text
    first_table = text.index("VAF, fresh")
    assert text.index("The coupling slipped & moved.") < first_table
    assert text.index(f"{HOSTILE}: {HOSTILE}") < first_table


def test_a_flawless_run_is_said_to_be_one(html: str) -> None:
    assert "Nothing was flagged" in html
    assert "Read this first" not in html
