"""Encoding is the inverse of decoding, and a converter's end is its end."""

import math

import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE, packed_cycle
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.can.channel_map import Channel, ChannelMapError
from cablesense_online.can.decoder import FrameDecoder
from cablesense_online.can.emulated_amplifier import FrameEncoder
from cablesense_online.can.faults import FaultLedger

TWELVE = st.lists(st.floats(-49.0, 3270.0), min_size=12, max_size=12)


@pytest.mark.parametrize(
    ("channel_map", "database", "half_step_n"),
    [(PACKED, PACKED_DATABASE, 0.05), (SINGLE, SINGLE_DATABASE, 0.0005)],
    ids=["packed", "cia404"],
)
@given(tensions_n=TWELVE, counter=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_what_is_encoded_is_decoded_to_half_a_step(
    channel_map, database, half_step_n, tensions_n, counter
):
    decoder = FrameDecoder(channel_map, database, FaultLedger())
    decoded = [
        decoder.decode(frame)
        for frame in FrameEncoder(channel_map, database).cycle(tensions_n, counter)
    ]
    readings = dict(pair for one in decoded for pair in one.readings)
    assert [readings[i] for i in range(12)] == pytest.approx(tensions_n, abs=half_step_n + 1e-9)
    assert all(one.valid for one in decoded)
    if channel_map is PACKED:
        assert decoded[0].counter == counter % 256


def test_the_frames_are_those_that_cantools_makes():
    tensions_n = [50.0 + number for number in range(12)]
    frames = FrameEncoder(PACKED, PACKED_DATABASE).cycle(tensions_n, 3)
    expected = packed_cycle(tensions_n, 3)
    assert [(f.arbitration_id, f.data) for f in frames] == [
        (f.arbitration_id, f.data) for f in expected
    ]


def test_scale_and_zero_are_undone():
    channels = {**PACKED.channels}
    channels["cable_1"] = Channel(
        message="TENSIONS_1_TO_4", signal="TENSION_1", scale_n_per_unit=-2.0, zero=10.0
    )
    changed = PACKED.model_copy(update={"channels": channels})
    decoder = FrameDecoder(changed, PACKED_DATABASE, FaultLedger())
    frames = FrameEncoder(changed, PACKED_DATABASE).cycle([80.0] * 12, 0)
    assert dict(decoder.decode(frames[1]).readings)[0] == pytest.approx(80.0)


@pytest.mark.parametrize(("tension_n", "raw"), [(9e9, 32767), (-9e9, -32768)])
def test_beyond_the_converter_the_last_value_is_sent(tension_n, raw):
    frame = FrameEncoder(PACKED, PACKED_DATABASE).cycle([tension_n] * 12, 0)[1]
    assert int.from_bytes(frame.data[:2], "little", signed=True) == raw


def test_a_whole_number_cannot_carry_nan():
    encoder = FrameEncoder(PACKED, PACKED_DATABASE)
    assert not encoder.is_float("cable_1")
    with pytest.raises(ChannelMapError, match="TENSION_1 is a whole number"):
        encoder.cycle([math.nan] * 12, 0)


def test_a_status_is_sent_with_its_cable():
    frames = FrameEncoder(SINGLE, SINGLE_DATABASE).cycle([1.0] * 12, 0, {"cable_5": 3})
    assert [frame.data[4] for frame in frames] == [0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]
