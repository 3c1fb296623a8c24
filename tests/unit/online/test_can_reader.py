"""Frames to readings, readings to whole samples, and samples withheld while in doubt."""

import math
import struct

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.installation import config_path
from cablesense_online.can.bus import CanInterface, FaultKind, FaultLedger
from cablesense_online.can.channel_map import Channel, StuckLimits, parse_database
from cablesense_online.can.reader import BusClock, FrameDecoder, StuckDetector, TensionReader
from tests.helpers.can_frames import (
    PACKED,
    PACKED_DATABASE,
    SINGLE,
    SINGLE_DATABASE,
    frame,
    packed_cycle,
    single_cycle,
)

NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


@pytest.fixture
def ledger():
    return FaultLedger()


@pytest.fixture
def packed(ledger):
    return FrameDecoder(PACKED, PACKED_DATABASE, ledger)


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
    assert readings[0] == pytest.approx(-2.0 * (42.0 - 10.0))
    assert readings[1] == pytest.approx(40.0)


BIG_ENDIAN = """VERSION ""
BO_ 256 FORCES: 8 AMPLIFIER
 SG_ FORCE_1 : 7|16@0- (0.01,0) [0|0] "N" DRIVER
 SG_ FORCE_2 : 23|24@0- (0.001,0) [0|0] "N" DRIVER
 SG_ FORCE_3 : 47|24@0+ (0.001,0) [0|0] "N" DRIVER
"""
"""Three values side by side, the highest byte of each first."""


@pytest.mark.parametrize(
    ("data", "tensions_n"),
    [
        ("12 c0 00 ce 64 01 00 00", [48.0, 52.836, 65.536]),
        ("ff 9c ff ff 9c 7f ff ff", [-1.0, -0.1, 8388.607]),
    ],
)
def test_values_whose_highest_byte_comes_first_are_decoded(ledger, data, tensions_n):
    channels = {
        f"cable_{number}": Channel(message="FORCES", signal=f"FORCE_{number}")
        for number in (1, 2, 3)
    }
    big_endian = PACKED.model_copy(
        update={"channels": channels, "counter": None, "range_n": (-10.0, 10_000.0)}
    )
    decoder = FrameDecoder(big_endian, parse_database(BIG_ENDIAN), ledger)
    sent = can.Message(arbitration_id=256, is_extended_id=False, data=bytes.fromhex(data))
    decoded = decoder.decode(sent)
    assert decoded.valid
    assert dict(decoded.readings) == pytest.approx(dict(enumerate(tensions_n)))


@pytest.mark.parametrize(
    ("raw", "fault"), [(32767, FaultKind.OVER_RANGE), (-32768, FaultKind.UNDER_RANGE)]
)
def test_a_reading_at_the_converters_end_makes_the_frame_invalid(packed, ledger, raw, fault):
    message = packed_cycle(TENSIONS_N, 0)[1]
    message.data[2:4] = struct.pack("<h", raw)
    assert not packed.decode(message).valid
    assert ledger.report().recent == {fault: {"cable_2": 1}}


@pytest.mark.parametrize(
    ("status", "fault"),
    [
        (0x01, FaultKind.INVALID_STATUS),
        (0x03, FaultKind.OVER_RANGE),
        (0x05, FaultKind.UNDER_RANGE),
        (0xF0, None),
    ],
)
def test_a_status_byte_makes_a_frame_invalid(ledger, status, fault):
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
    assert ledger.report().recent == {FaultKind.NOT_FINITE: {"cable_3": 1}}


@pytest.mark.parametrize("length", [0, 7])
def test_a_frame_of_the_wrong_length_has_no_readings(packed, ledger, length):
    message = packed_cycle(TENSIONS_N, 0)[2]
    short = can.Message(
        arbitration_id=message.arbitration_id, is_extended_id=False, data=message.data[:length]
    )
    assert packed.decode(short) is None
    assert ledger.report().recent == {FaultKind.WRONG_LENGTH: {"TENSIONS_5_TO_8": 1}}


def test_an_unknown_id_is_named_and_one_that_the_dbc_describes_is_not(ledger):
    decoder = FrameDecoder(SINGLE, SINGLE_DATABASE, ledger)
    heartbeat = can.Message(arbitration_id=0x705, is_extended_id=False, data=[5])
    stranger = can.Message(arbitration_id=0x3AB, is_extended_id=False, data=[5])
    assert decoder.decode(heartbeat) is None
    assert decoder.decode(stranger) is None
    assert ledger.report().recent == {FaultKind.UNKNOWN_ID: {"0x3AB": 1}}


@given(
    st.one_of(st.integers(0x118, 0x128), st.integers(0, 2**29 - 1)),
    st.binary(max_size=8),
    st.booleans(),
)
@settings(max_examples=100, deadline=None)
def test_any_frame_gives_readings_within_the_range_or_is_invalid_or_none(number, data, extended):
    extended = extended or number > 0x7FF
    ledger = FaultLedger()
    decoder = FrameDecoder(PACKED, PACKED_DATABASE, ledger)
    message = can.Message(arbitration_id=number, is_extended_id=extended, data=data)
    decoded = decoder.decode(message)
    if decoded is None:
        (places,) = ledger.report().recent.values()
        assert places.total() == 1
    elif decoded.valid:
        low, high = PACKED.range_n
        assert all(low < tension_n < high for _, tension_n in decoded.readings)


def test_an_adapters_own_clock_is_carried_over_and_its_drift_followed():
    rng = np.random.default_rng(0)
    clock = BusClock()
    error_s = []
    for number in range(5_000):
        true_s = number * 1e-2
        stamp_s = 12.0 + true_s * (1.0 + 100e-6)
        arrival_s = NOW_S + true_s + 1e-4 + rng.exponential(1e-3)
        error_s.append(clock.time_s(stamp_s, arrival_s) - (NOW_S + true_s))
    assert np.abs(error_s[100:]).max() < 2e-3
    assert np.std(error_s[100:]) < 0.5e-3  # not the millisecond by which arrival is scattered


@pytest.mark.parametrize(("interface", "given"), [("virtual", 9), ("slcan", 10)])
def test_a_pause_in_reading_costs_nothing_where_frames_bear_the_time_of_reading(
    ledger, interface, given
):
    reader = TensionReader(PACKED, PACKED_DATABASE, CanInterface(interface, "bench"), ledger)
    samples = []
    for number in range(10):
        frames = packed_cycle(TENSIONS_N, number, NOW_S + number * 1e-3)
        for delayed in frames[2:]:
            delayed.timestamp += 0.02 if number == 9 else 0.0
        samples += [reader.take(frame, frame.timestamp + 1e-4) for frame in frames]
        samples.append(reader.lapse())
    assert sum(sample is not None for sample in samples) == given


def test_a_channel_that_stands_still_while_the_others_move_is_found_and_released():
    watch = StuckDetector(12, StuckLimits(after_s=2.0, others_moved_n=20.0))
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    stuck = [watch.stuck(sample, 0.1 * i) for i, sample in enumerate(moving)]
    assert stuck[19] == []  # two seconds have not passed
    assert stuck[-1] == [4]
    back = np.full(12, 50.0)
    assert watch.stuck(back, 5.0) == [4]  # the others came back; it has still not moved
    back[4] = 50.1
    assert watch.stuck(back, 5.1) == []
