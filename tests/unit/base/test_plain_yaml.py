"""YAML as data: any text is a mapping of plain values, or refused in one line, at once."""

import time
from contextlib import suppress
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_base.plain_yaml import FilePart, parse_plain_mapping, read_plain


class RefusedError(CableSenseError):
    pass


def parsed(text):
    return parse_plain_mapping(text, "my.yaml", "a, b", RefusedError)


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
        ("b: &x 1\na: *x", "line 2: .*an alias"),
        ("a: 1\n\n\nb: !!python/object:os.x {}", "line 4: .*tag"),
        ("a: !own 3", "tag"),
        ("a: 2020-99-99", "month"),
        ("3", "holds int, not a mapping with the keys a, b"),
        ("a: [", "line 1: not plain YAML"),
        ("a: 1\n---\nb: 2", "not plain YAML"),
        ("a: 0x" + "f" * 5000, "a value of more than 1000 characters"),
        ("a: " + "{b: " * 50_000, "nested deeper"),
    ],
    ids=lambda text: ascii(text)[:24],
)
def test_more_than_plain_values_is_refused_at_once(text, says):
    start = time.monotonic()
    with pytest.raises(RefusedError, match=rf"^my\.yaml: .*{says}") as caught:
        parsed(text)
    assert time.monotonic() - start < 5.0
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 400


class Segments(FilePart):
    count: int
    length_m: float


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("count: 1\nlenght_m: 2.0", r"lenght_m is no known key; is length_m meant\?"),
        ("count: 1\nlength_m: 2.0\ncolour: 3", "colour is no known key; valid keys here: count"),
    ],
)
def test_a_key_that_is_written_wrongly_is_named_with_the_one_meant(text, says):
    with pytest.raises(RefusedError, match=says):
        read_plain(text, "my.yaml", Segments, RefusedError)
