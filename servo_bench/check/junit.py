"""A judgement as JUnit XML, as Jenkins, GitLab, and GitHub's reporters read it.

<testsuites> <testsuite name= tests= failures= errors= time=>
  <testcase classname= name=> [<failure message=> | <error message= type=>]
"""

from xml.etree.ElementTree import Element, SubElement, indent, tostring

from servo_bench.check.judge import Judgement
from servo_bench.errors import BenchError


def judgement_xml(judgement: Judgement) -> bytes:
    """One testcase for every finding."""
    failures = sum(not finding.passed for finding in judgement.findings)
    root, suite = _suite(judgement.plan.name, len(judgement.findings), failures=failures)
    suite.set("time", f"{judgement.seconds:.3f}")
    for finding in judgement.findings:
        case = _case(suite, judgement.plan.name, f"{finding.group}.{finding.name}")
        if not finding.passed:
            SubElement(case, "failure", message=_xml_text(finding.sentence))
        properties = SubElement(case, "properties")
        for name, value in (("value", finding.text), ("allowed", finding.allowed)):
            SubElement(properties, "property", name=name, value=_xml_text(value))
    return _written(root)


def error_xml(plan: str, error: BenchError) -> bytes:
    """One testcase that could not be judged, and why."""
    root, suite = _suite(plan, 1, errors=1)
    case = _case(suite, plan, "run")
    SubElement(case, "error", message=_xml_text(str(error)), type=type(error).__name__)
    return _written(root)


def _suite(name: str, tests: int, *, failures: int = 0, errors: int = 0) -> tuple[Element, Element]:
    root = Element("testsuites")
    counts = {"tests": str(tests), "failures": str(failures), "errors": str(errors)}
    return root, SubElement(root, "testsuite", {"name": _xml_text(name), **counts})


def _case(suite: Element, plan: str, name: str) -> Element:
    return SubElement(suite, "testcase", classname=_xml_text(plan), name=_xml_text(name))


def _xml_text(text: str) -> str:
    """Without the characters that XML 1.0 cannot hold."""
    return "".join(
        c if c in "\t\n" or c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text
    )


def _written(root: Element) -> bytes:
    indent(root)
    text: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
