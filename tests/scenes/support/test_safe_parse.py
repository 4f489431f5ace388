"""Texts by strangers: their values, or a `ValueError`; never a crash, a hang or all of the memory."""

from typing import Any

import pytest

from scenes.support.safe_parse import parse_json, parse_toml, parse_xml, parse_yaml

DEEP = 100_000


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_toml, "a = " + "[" * DEEP),
        (parse_json, "[" * DEEP),
        (parse_yaml, "[" * DEEP),
        # no text at all to a parser of YAML, and a list within a list to OpenCV's
        (parse_yaml, "- " * DEEP),
        (parse_yaml, "[" * 51 + "]" * 51),
        (parse_xml, "<a>" * 5000 + "</a>" * 5000),
    ],
    ids=["toml", "json", "yaml", "yaml-dashes", "yaml-closed", "xml"],
)
def test_deep_nesting_is_refused(parse: Any, text: str) -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse(text)


@pytest.mark.parametrize(
    ("parse", "text", "says"),
    [
        (parse_yaml, "a: &a [1, 2]\nb: [*a, *a]", "alias"),
        (parse_yaml, "a: [1, 2", "not valid YAML"),
        (parse_yaml, "a: \0", "not valid YAML"),
        (parse_yaml, "a: 1\n---\nb: 2", "not valid YAML"),
        (parse_xml, "<a><b></a>", "not valid XML"),
        (parse_xml, "", "not valid XML"),
        (parse_xml, '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document type"),
    ],
)
def test_aliases_document_types_and_broken_texts_are_refused(
    parse: Any, text: str, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        parse(text)


def test_yaml_and_xml_scalars_stay_texts() -> None:
    # YAML 1.1 would make 25200 and False of the first two
    assert parse_yaml("a: 7:00:00\nb: no\nc: 1.e-3\n") == {"a": "7:00:00", "b": "no", "c": "1.e-3"}
    assert parse_xml("<r><a> 1. 2.\n 3.</a><b>x</b><c/></r>") == {
        "a": ["1.", "2.", "3."],
        "b": "x",
        "c": [],
    }


def test_yaml_tags_create_no_python_objects() -> None:
    assert parse_yaml("a: !!python/object/apply:os.system ['false']") == {"a": ["false"]}
