"""Reads a JUnit file and checks it by the schema beside this file."""

from functools import cache
from pathlib import Path

from lxml import etree


@cache
def _schema() -> etree.XMLSchema:
    return etree.XMLSchema(etree.parse(Path(__file__).with_name("junit.xsd")))


def checked(text: str | bytes) -> etree._Element:
    """The root of a file that keeps the schema's rules, and whose counts are those of its cases."""
    root = etree.fromstring(text.encode() if isinstance(text, str) else text)
    schema = _schema()
    assert schema.validate(root), schema.error_log
    for suite in root:
        cases = suite.findall("testcase")
        assert int(suite.get("tests", "")) == len(cases)
        for count, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.get(count, "")) == len(suite.findall(f"testcase/{tag}")), suite.get("name")
        names = [case.get("name") for case in cases]
        assert len(set(names)) == len(names), "servers keep the history of a case by its name"
    return root
