"""Faults asked for by text."""

import pytest
from can_frames import PACKED, SINGLE
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.emulated_amplifier import (
    FaultRequest,
    FaultRequestError,
    parse_fault,
)
from cablesense_online.can.faults import FaultKind


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_can_be_asked_for(kind):
    name = kind.name.lower()
    if kind.of_cable:
        asked = parse_fault(f" {name}  cable_5 ", SINGLE)
        assert asked == FaultRequest(kind, "cable_5")
    else:
        assert parse_fault(name, PACKED) == FaultRequest(kind)


def test_an_empty_text_ends_a_fault():
    assert parse_fault("  ", PACKED) is None


@pytest.mark.parametrize(
    ("text", "channel_map", "said"),
    [
        ("explosion", PACKED, "unknown fault 'explosion'; there are missing_channel"),
        ("missing_channel", PACKED, "needs one cable of cable_1 … cable_12"),
        ("missing_channel cable_13", PACKED, "needs one cable"),
        ("bus_off cable_1", PACKED, "concerns the whole bus"),
        ("counter_gap", SINGLE, "no cycle counter"),
        ("invalid_status cable_1", PACKED, "no status"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(text, channel_map, said):
    with pytest.raises(FaultRequestError, match=said):
        parse_fault(text, channel_map)


@given(st.text(max_size=60))
def test_any_text_is_a_fault_or_refused(text):
    try:
        asked = parse_fault(text, PACKED)
    except FaultRequestError:
        return
    assert asked is None or isinstance(asked, FaultRequest)
