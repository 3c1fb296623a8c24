"""Sizes that no bus carries are refused before anything is made of them."""

import pytest

from cablesense_online.can.channel_map import (
    ChannelMapError,
    parse_database,
)

HEAD = 'VERSION ""\n'
SIGNAL = 'BO_ 1 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|4000000000] "" X\n'


def test_what_a_bus_carries_is_let_through():
    for text in (HEAD + SIGNAL, HEAD + SIGNAL.replace("A: 8", "A: 1785")):
        assert parse_database(text, "f").messages[0].name == "A"
    assert parse_database(HEAD + "// A: 999999999 X\n" + SIGNAL + 'CM_ "A: 999999999 X";\n')


@pytest.mark.parametrize(
    ("was", "becomes", "says"),
    [
        ("A: 8", "A: 1786", "line 2: a message of bytes 1786; it must be at most 1785"),
        ("A: 8", "A //:\n : //x\n 1000000000 ", "line 4: a message of bytes"),
        ("A: 8", "A: " + "9" * 5000, "a message of bytes 9"),
        ("0|8@", "1000000000|8@", "line 3: a signal from bit"),
        ("0|8@", "0|1000000000@", "line 3: a signal of bits"),
        ("0|8@", "0| // 8@\n1000000000 @", "a signal of bits"),
    ],
)
def test_one_line_cannot_ask_for_all_memory(was, becomes, says):
    with pytest.raises(ChannelMapError, match=says) as caught:
        parse_database(HEAD + SIGNAL.replace(was, becomes), "f.dbc")
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("text", ['"', '"' * 400_001, "//:\n:" * 200_000, '\\"' * 400_000, ":|"])
def test_any_text_is_looked_through_at_once(text):
    with pytest.raises(ChannelMapError):
        parse_database(text, "f")
