"""Frames to readings: by name, with scale and zero, and every frame that is none."""

import math
import struct

import can
import pytest
from can_frames import (
    PACKED,
    PACKED_DATABASE,
    SINGLE,
    SINGLE_DATABASE,
    frame,
    packed_cycle,
    single_cycle,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.installation import config_path
from cablesense_online.can.channel_map import Channel, parse_database
from cablesense_online.can.decoder import FrameDecoder
from cablesense_online.can.faults import FaultKind, FaultLedger

TENSIONS_N = [50.0 + number for number in range(12)]


@pytest.fixture
def ledger():
    return FaultLedger()


@pytest.fixture
def packed(ledger):
    return FrameDecoder(PACKED, PACKED_DATABASE, ledger)


def all_readings(decoder, frames):
    return dict(pair for one in frames for pair in decoder.decode(one).readings)


def test_the_packed_amplifier_reads_what_was_sent(packed):
    cycle, *data = packed_cycle(TENSIONS_N, 7)
    assert packed.decode(cycle).counter == 7
    readings = all_readings(packed, data)
    assert [readings[i] for i in range(12)] == pytest.approx(TENSIONS_N, abs=0.051)
    assert (packed.frames_per_cycle, packed.counter_modulo) == (4, 256)


def test_cia_404_nodes_read_what_was_sent(ledger):
    decoder = FrameDecoder(SINGLE, SINGLE_DATABASE, ledger)
    readings = all_readings(decoder, single_cycle(TENSIONS_N))
    assert [readings[i] for i in range(12)] == pytest.approx(TENSIONS_N, abs=0.00051)
    assert (decoder.frames_per_cycle, decoder.counter_modulo) == (12, 0)


def test_scale_and_zero_are_applied_and_names_may_be_crossed(ledger):
    channels = dict(PACKED.channels)
    channels["cable_1"] = Channel(
        message="TENSIONS_1_TO_4", signal="TENSION_2", scale_n_per_unit=-2.0, zero=10.0
    )
    channels["cable_2"] = Channel(message="TENSIONS_1_TO_4", signal="TENSION_1")
    decoder = FrameDecoder(
        PACKED.model_copy(update={"channels": channels}), PACKED_DATABASE, ledger
    )
    readings = dict(decoder.decode(packed_cycle(TENSIONS_N, 0)[1]).readings)
    assert readings[0] == pytest.approx(-2.0 * (51.0 - 10.0))
    assert readings[1] == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("raw", "fault"), [(32767, FaultKind.OVER_RANGE), (-32768, FaultKind.UNDER_RANGE)]
)
def test_a_reading_at_the_converters_end_makes_the_frame_invalid(packed, ledger, raw, fault):
    message = packed_cycle(TENSIONS_N, 0)[1]
    message.data[2:4] = struct.pack("<h", raw)
    assert not packed.decode(message).valid
    assert ledger.report().places == {fault: {"cable_2": 1}}


@pytest.mark.parametrize(
    ("status", "fault"),
    [
        (0x01, FaultKind.INVALID_STATUS),
        (0x03, FaultKind.OVER_RANGE),
        (0x05, FaultKind.UNDER_RANGE),
        (0xF0, None),
    ],
)
def test_a_status_byte_is_believed(ledger, status, fault):
    decoder = FrameDecoder(SINGLE, SINGLE_DATABASE, ledger)
    statuses = [0] * 12
    statuses[4] = status
    decoded = [decoder.decode(one) for one in single_cycle(TENSIONS_N, statuses=statuses)]
    assert [one.valid for one in decoded] == [True] * 4 + [fault is None] + [True] * 7
    assert set(ledger.report().recent) == ({fault} if fault else set())


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_float_that_is_no_number_makes_the_frame_invalid(ledger, bad):
    text = config_path("can/cia404_amplifier.dbc").read_text(encoding="utf-8")
    text = text.replace("0|32@1- (0.001,0)", "0|32@1- (1,0)") + "SIG_VALTYPE_ 387 VALUE_3 : 1;\n"
    database = parse_database(text)
    decoder = FrameDecoder(SINGLE, database, ledger)
    message = frame(database, "TPDO_3", {"VALUE_3": bad, "STATUS_3": 0})
    assert not decoder.decode(message).valid
    assert ledger.report().places == {FaultKind.NOT_FINITE: {"cable_3": 1}}


@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_frame_of_the_wrong_length_tells_nothing(packed, ledger, length):
    message = packed_cycle(TENSIONS_N, 0)[2]
    short = can.Message(
        arbitration_id=message.arbitration_id, is_extended_id=False, data=message.data[:length]
    )
    assert packed.decode(short) is None
    assert ledger.report().places == {FaultKind.WRONG_LENGTH: {"TENSIONS_5_TO_8": 1}}


def test_remote_and_extended_frames_of_a_known_number_are_no_readings(packed, ledger):
    number = packed_cycle(TENSIONS_N, 0)[1].arbitration_id
    remote = can.Message(arbitration_id=number, is_extended_id=False, is_remote_frame=True, dlc=8)
    extended = can.Message(arbitration_id=number, is_extended_id=True, data=bytes(8))
    assert packed.decode(remote) is None
    assert packed.decode(extended) is None
    assert set(ledger.report().recent) == {FaultKind.UNREADABLE, FaultKind.UNKNOWN_ID}


def test_an_unknown_id_is_named_and_one_that_the_dbc_describes_is_not(ledger):
    decoder = FrameDecoder(SINGLE, SINGLE_DATABASE, ledger)
    heartbeat = can.Message(arbitration_id=0x705, is_extended_id=False, data=[5])
    stranger = can.Message(arbitration_id=0x3AB, is_extended_id=False, data=[5])
    assert decoder.decode(heartbeat) is None
    assert decoder.decode(stranger) is None
    assert not decoder.knows(stranger)
    assert ledger.report().places == {FaultKind.UNKNOWN_ID: {"0x3AB": 1}}


@given(
    st.one_of(st.integers(0x118, 0x128), st.integers(0, 2**29 - 1)),
    st.binary(max_size=8),
    st.booleans(),
)
@settings(max_examples=200, deadline=None)
def test_any_frame_gives_readings_within_the_range_or_is_invalid_or_none(number, data, extended):
    extended = extended or number > 0x7FF
    ledger = FaultLedger()
    decoder = FrameDecoder(PACKED, PACKED_DATABASE, ledger)
    message = can.Message(arbitration_id=number, is_extended_id=extended, data=data)
    decoded = decoder.decode(message)
    if decoded is None:
        assert sum(ledger.report().recent.values()) == 1
    elif decoded.valid:
        low, high = PACKED.range_n
        assert all(low < tension_n < high for _, tension_n in decoded.readings)
