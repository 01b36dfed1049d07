"""The page's files by themselves: nothing from elsewhere, nothing inline, nothing missing."""

import re
from html.parser import HTMLParser
from pathlib import Path, PurePosixPath

import pytest

PAGE = Path(__file__).parent.parent / "servo_bench" / "daemon" / "page"
OWN = sorted(path for path in PAGE.rglob("*.js") if "vendor" not in path.parts)
SCRIPTS = sorted(PAGE.rglob("*.js"))
MARKUP = (
    "innerHTML",
    "outerHTML",
    "insertAdjacentHTML",
    "document.write",
    "createContextualFragment",
)
COMMENT = re.compile(r"/\*.*?\*/|(?m:^\s*//.*$)", re.DOTALL)
IMPORT = re.compile(r'(?:from|import)\s+"([^"]+)"')


class Elements(HTMLParser):
    """Every element's name and attributes, and the text within scripts and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str]]] = []
        self.inline = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))

    def handle_data(self, data: str) -> None:
        if self.found and self.found[-1][0] in ("script", "style"):
            self.inline += data.strip()


@pytest.fixture
def elements() -> Elements:
    parser = Elements()
    parser.feed((PAGE / "index.html").read_text())
    return parser


def test_a_strict_content_policy_holds(elements: Elements) -> None:
    attributes = {name for _, attrs in elements.found for name in attrs}
    assert elements.inline == ""
    assert not {name for name in attributes if name.startswith("on")} | attributes & {"style"}
    assert "style" not in {tag for tag, _ in elements.found}


def test_every_file_that_is_named_is_there(elements: Elements) -> None:
    named = [attrs.get("src") or attrs.get("href", "") for _, attrs in elements.found]
    for name in filter(None, named):
        assert name.startswith(("/", "#/")), name
        assert name.startswith("#/") or (PAGE / name.lstrip("/")).is_file(), name


@pytest.mark.parametrize("script", OWN, ids=lambda path: str(path.relative_to(PAGE)))
def test_every_import_leads_to_a_file_of_the_page(script: Path) -> None:
    for name in IMPORT.findall(script.read_text()):
        found = PAGE / name.lstrip("/") if name.startswith("/") else script.parent / name
        assert found.resolve().is_relative_to(PAGE.resolve())
        assert found.is_file(), name


def test_every_script_is_used() -> None:
    used = {PAGE / "js" / "main.js"}
    waiting = list(used)
    while waiting:
        script = waiting.pop()
        for name in IMPORT.findall(script.read_text()):
            found = PAGE / name.lstrip("/") if name.startswith("/") else script.parent / name
            if found.resolve() not in used:
                used.add(found.resolve())
                waiting.append(found.resolve())
    assert used == set(SCRIPTS)


@pytest.mark.parametrize("path", [*SCRIPTS, *PAGE.rglob("*.css")], ids=lambda path: path.name)
def test_nothing_comes_from_elsewhere(path: Path) -> None:
    text = COMMENT.sub("", path.read_text())
    assert not re.findall(r"https?://|[\"'(]//\w|@import|url\(", text)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_no_text_is_ever_read_as_markup_or_program(script: Path) -> None:
    text = COMMENT.sub("", script.read_text())
    assert [word for word in (*MARKUP, "eval(", "new Function") if word in text] == []


def test_the_library_keeps_its_licence() -> None:
    licence = (PAGE / "vendor" / "uPlot.LICENSE").read_text()
    assert "MIT License" in licence
    assert "Leon Sorokin" in licence
    assert {path.name for path in (PAGE / "vendor").iterdir()} == {
        *("uPlot.esm.js", "uPlot.css", "uPlot.LICENSE"),
    }


def test_the_stop_button_is_outside_of_what_views_replace(elements: Elements) -> None:
    order = [attrs.get("id", tag) for tag, attrs in elements.found]
    assert order.index("stop") < order.index("main")
    assert PurePosixPath("/js/main.js") in {
        PurePosixPath(attrs["src"]) for tag, attrs in elements.found if tag == "script"
    }
