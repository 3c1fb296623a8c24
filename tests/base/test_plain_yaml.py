"""YAML as data: any text is a mapping of plain values, or refused in one line, at once."""

import time
from contextlib import suppress
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_base.plain_yaml import MAX_DEPTH, parse_plain_mapping


class RefusedError(CableSenseError):
    pass


def parsed(text):
    return parse_plain_mapping(text, "my.yaml", "a, b", RefusedError)


def refusal(text):
    with pytest.raises(RefusedError) as caught:
        parsed(text)
    line = str(caught.value)
    assert line.startswith("my.yaml: ")
    assert len(line.splitlines()) == 1
    assert len(line) < 400
    return line


def test_plain_values_are_what_they_look_like():
    text = "a: 1\nb: [1.5, .inf, yes, ~, 'x']\nc: {d: 2026-01-02 03:04:05}\n"
    assert parsed(text) == {
        "a": 1,
        "b": [1.5, float("inf"), True, None, "x"],
        "c": {"d": datetime(2026, 1, 2, 3, 4, 5)},
    }


@given(st.text(max_size=60) | st.text(alphabet="ab:{}[]!&*<>|- \n\t1", max_size=60))
def test_any_text_is_a_mapping_or_refused(text):
    with suppress(RefusedError):
        assert isinstance(parsed(text), dict)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: 1\na: 2", "line 2: .*key 'a' stands twice"),
        ("b: {a: 1, a: 2}", "stands twice"),
        ("b: &x 1\na: *x", "line 2: .*an alias"),
        ("a: &x [*x]", "an alias"),
        ("a: 1\n\n\nb: !!python/object:os.x {}", "line 4: .*a tag"),
        ("a: !!int 3", "a tag"),
        ("a: !!set {x}", "a tag"),
        ("a: !own 3", "a tag"),
        ("a: {<<: {b: 1}}", "a merge"),
        ("{[a]: 1}", "as a key"),
        ("a: 2020-99-99", "month"),
        ("3", "holds int, not a mapping with the keys a, b"),
        ("a: [", "line 1: not plain YAML"),
        ("a: '\0'", "not plain YAML"),
        ("a: 1\n---\nb: 2", "not plain YAML"),
        ("a: " + "9" * 5000, "a value of 5000 characters"),
        ("a: 0x" + "f" * 5000, "a value of 5002 characters"),
        ("a: " + "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested deeper"),
        ("a: " + "{b: " * 50_000, "nested deeper"),
        ("a: 1" + ":59" * 100_000, "a value of"),
    ],
    ids=lambda text: ascii(text)[:24],
)
def test_more_than_plain_values_is_refused_at_once(text, says):
    start = time.monotonic()
    line = refusal(text)
    assert time.monotonic() - start < 5.0
    with pytest.raises(RefusedError, match=says):
        raise RefusedError(line)
