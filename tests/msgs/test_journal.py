"""A journal entry goes through its message without losing a bit; other messages are refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.journal import (
    Event,
    EventKind,
    JournalEntry,
    journal_entry,
    put_journal_entry,
)
from cablesense_msgs_py.topics import ContractError

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg")
serialization = pytest.importorskip("rclpy.serialization")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

NUMBERS = st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=12).map(tuple)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
ENTRIES = st.builds(
    JournalEntry,
    before_ns=st.integers(0, 2**31 * 10**9 - 1),
    events=st.lists(st.builds(Event, st.sampled_from(EventKind), NUMBERS), max_size=4).map(tuple),
    arm=TEXTS,
    settings=st.dictionaries(TEXTS, TEXTS, max_size=5),
    command_rad=NUMBERS,
    lowest_rad=NUMBERS,
    highest_rad=NUMBERS,
    rest_from_ns=st.integers(-(2**62), 2**62),
    unloaded_n=NUMBERS,
    tared_n=NUMBERS,
    tare_command_rad=NUMBERS,
)


def message_of(entry):
    message = diagnostic_msgs.DiagnosticArray()
    put_journal_entry(message, entry, diagnostic_msgs.DiagnosticStatus, diagnostic_msgs.KeyValue)
    return message


@given(ENTRIES)
def test_what_is_put_is_read_back_bit_for_bit(entry):
    raw = serialization.serialize_message(message_of(entry))
    got = journal_entry(serialization.deserialize_message(raw, diagnostic_msgs.DiagnosticArray))
    assert repr(got) == repr(entry)  # which tells 0.0 from -0.0


def changed(part, **values):
    entry = JournalEntry(1, (Event(EventKind.TARE),), "arm", {}, (0.5,), (0.5,), (0.5,), 7)
    message = message_of(entry)
    for status in message.status:
        if status.name == part:
            for value in status.values:
                value.value = values.get("value", value.value)
            status.name = values.get("name", part)
    return message


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (changed("motion", name="other"), "no motion"),
        (changed("motion", value="one 2"), "no list of numbers"),
        (changed("motion", value=repr(math.inf)), "must be finite"),
        (changed("motion", value="0.5"), "no whole number"),
        (changed("event: tare on request", name="event: dance"), "unknown event 'dance'"),
    ],
)
def test_other_messages_are_refused_with_a_reason(message, said):
    with pytest.raises(ContractError, match=said):
        journal_entry(message)
