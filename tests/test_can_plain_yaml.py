"""YAML as data: any text is a mapping of plain values, or refused."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_ros.can.channel_map import ChannelMapError
from cablesense_ros.can.plain_yaml import parse_plain_mapping


@given(st.text(max_size=60) | st.text(alphabet="ab:{}[]!&*<>|- \n\t1", max_size=60))
def test_any_text_is_a_mapping_or_refused(text):
    with suppress(ChannelMapError):
        assert isinstance(parse_plain_mapping(text, "t", "a"), dict)


@pytest.mark.parametrize("text", ["a: 1\na: 2", "a: &x 1\nb: *x", "!!python/object:os.x {}", "3"])
def test_more_than_plain_values_is_refused(text):
    with pytest.raises(ChannelMapError, match="file: "):
        parse_plain_mapping(text, "file", "a, b")
