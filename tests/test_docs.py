"""The documentation is whole: a reference that is the code's own, no lost page, no dead link."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner

from servo_bench.cli.app import COMMANDS, app
from servo_bench.cli.reference import exit_codes
from servo_bench.cli.reference_commands import nodes
from servo_bench.cli.reference_keys import FILES, File, key_sections
from servo_bench.errors import BenchError

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
REFERENCE = (DOCS / "reference.md").read_text(encoding="utf-8")
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def links(page: Path) -> Iterator[tuple[str, str]]:
    """The relative links of a page: file ("" for itself) and anchor."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in LINK.findall(text):
        if not re.match(r"[a-z]+:", target):
            name, _, anchor = target.partition("#")
            yield name, anchor


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_the_reference_is_what_the_code_writes() -> None:
    done = CliRunner().invoke(app, ["reference", "--markdown"])
    assert done.exit_code == 0
    assert done.output == REFERENCE, "servo-bench reference --markdown > docs/reference.md"


def test_every_command_and_every_option_is_in_the_reference() -> None:
    sections = dict(re.findall(r"^### `(servo-bench.*?)`\n(.*?)(?=^##)", REFERENCE, re.M | re.S))
    assert {f"servo-bench {name}" for name in COMMANDS} < set(sections)
    for node in nodes():
        for parameter in node.command.params:
            shown = getattr(parameter, "metavar", None)
            argument = parameter.param_type_name == "argument"
            typed = (shown,) if argument and shown else parameter.opts
            for word in (*typed, *parameter.secondary_opts):
                assert re.search(rf"\W{re.escape(word)}\W", sections[node.name]), (node.name, word)


def fields_of(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
    """Every (class, key) of a model and of those inside, by pydantic's own definitions."""
    schema = model.model_json_schema()
    for name, part in {model.__name__: schema, **schema.get("$defs", {})}.items():
        for key in part.get("properties", {}):
            yield name, key


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.model.__name__)
def test_every_key_has_a_row_below_its_table(file: File) -> None:
    written = "\n".join(key_sections(file))
    assert written in REFERENCE
    for kind, key in fields_of(file.model):
        start = 0 if kind == file.model.__name__ else written.index(f": {kind}\n")
        table = written[start:].split("\n### ")[0]
        row = re.search(rf"^\| `{key}` \|.* \| (.*) \|$", table, re.MULTILINE)
        assert row is not None, (kind, key)
        assert row[1].strip().endswith((".", ")")), f"{kind}.{key} has no meaning: {row[0]}"


def test_every_exit_code_is_in_the_reference() -> None:
    named = {kind.exit_code for kind in BenchError.__subclasses__()}
    assert {0, 1, 10, 130} | named == set(exit_codes())
    for code, meaning in exit_codes().items():
        assert f"| {code} | {meaning} |" in REFERENCE


def test_every_page_is_named_in_the_index() -> None:
    named = {name for name, _ in links(DOCS / "index.md")}
    assert {page.name for page in PAGES} - {"index.md"} <= named


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name)
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    for name, anchor in links(page):
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name}: {name}"
        assert target.is_relative_to(ROOT), f"{page.name}: {name}"
        if anchor:
            assert anchor in anchors(target), f"{page.name}: {name}#{anchor}"
