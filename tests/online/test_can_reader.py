"""Frames to readings, readings to whole samples, and samples withheld while in doubt."""

import math
import struct

import can
import numpy as np
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
from cablesense_online.can.bus import ERROR_ACTIVE, CanInterface, FaultKind, FaultLedger
from cablesense_online.can.channel_map import Channel, StuckLimits, parse_database
from cablesense_online.can.reader import (
    BusClock,
    Decoded,
    FrameDecoder,
    SampleAssembler,
    StuckDetector,
    TensionReader,
)

NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


@pytest.fixture
def ledger():
    return FaultLedger()


@pytest.fixture
def packed(ledger):
    return FrameDecoder(PACKED, PACKED_DATABASE, ledger)


@pytest.mark.parametrize(
    ("channel_map", "database", "frames", "half_step_n", "modulo"),
    [
        (PACKED, PACKED_DATABASE, packed_cycle(TENSIONS_N, 7)[1:], 0.05, 256),
        (SINGLE, SINGLE_DATABASE, single_cycle(TENSIONS_N), 0.0005, 0),
    ],
    ids=["packed", "cia404"],
)
def test_each_amplifier_reads_what_was_sent(
    ledger, channel_map, database, frames, half_step_n, modulo
):
    decoder = FrameDecoder(channel_map, database, ledger)
    readings = dict(pair for one in frames for pair in decoder.decode(one).readings)
    assert [readings[i] for i in range(12)] == pytest.approx(TENSIONS_N, abs=half_step_n + 1e-9)
    assert decoder.counter_modulo == modulo


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
    assert ledger.report().places == {FaultKind.NOT_FINITE: {"cable_3": 1}}


@pytest.mark.parametrize("length", [0, 7])
def test_a_frame_of_the_wrong_length_has_no_readings(packed, ledger, length):
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
    assert set(ledger.report().recent) == {FaultKind.WRONG_LENGTH, FaultKind.UNKNOWN_ID}


def test_an_unknown_id_is_named_and_one_that_the_dbc_describes_is_not(ledger):
    decoder = FrameDecoder(SINGLE, SINGLE_DATABASE, ledger)
    heartbeat = can.Message(arbitration_id=0x705, is_extended_id=False, data=[5])
    stranger = can.Message(arbitration_id=0x3AB, is_extended_id=False, data=[5])
    assert decoder.decode(heartbeat) is None
    assert decoder.decode(stranger) is None
    assert ledger.report().places == {FaultKind.UNKNOWN_ID: {"0x3AB": 1}}


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
        assert sum(ledger.report().recent.values()) == 1
    elif decoded.valid:
        low, high = PACKED.range_n
        assert all(low < tension_n < high for _, tension_n in decoded.readings)


NAMES = [f"cable_{n}" for n in range(1, 7)]
SKEW_S = 0.4e-3
CYCLE_S = 1e-3


def data(group, value=0.0, valid=True):
    """Channels 0-1, 2-3 or 4-5."""
    return Decoded(readings=[(2 * group, value), (2 * group + 1, value)], valid=valid)


def opening(count):
    return Decoded(counter=count)


class Assembly:
    def __init__(self, modulo, skew_s=SKEW_S):
        self.ledger = FaultLedger()
        self.assembler = SampleAssembler(NAMES, skew_s, modulo, self.ledger)
        self.samples = []

    def take(self, decoded, time_s):
        sample = self.assembler.take(decoded, time_s)
        if sample is not None:
            self.samples.append(sample)

    def cycle(self, number, groups=(0, 1, 2), value=None, count=None):
        start_s = number * CYCLE_S
        if self.counted:
            self.take(opening((number if count is None else count) % 256), start_s)
        for place, group in enumerate(groups):
            at_s = start_s + (place + 1) * 1e-4
            self.take(data(group, float(number if value is None else value)), at_s)

    @property
    def counted(self):
        return self.assembler._modulo > 0

    @property
    def faults(self):
        return self.ledger.report().places


@pytest.fixture(params=[0, 256], ids=["without a counter", "with a counter"])
def bench(request):
    return Assembly(request.param)


@pytest.fixture
def counted():
    return Assembly(256)


@pytest.fixture
def plain():
    return Assembly(0)


def test_every_whole_cycle_gives_one_sample_at_its_first_frame(bench):
    for number in range(5):
        bench.cycle(number)
    assert [sample.tensions_n.tolist() for sample in bench.samples] == [
        [float(number)] * 6 for number in range(5)
    ]
    first_s = 0.0 if bench.counted else 1e-4
    assert [sample.time_s for sample in bench.samples] == pytest.approx(
        [number * CYCLE_S + first_s for number in range(5)]
    )
    assert bench.samples[0].skew_s == pytest.approx(3e-4 if bench.counted else 2e-4)
    assert bench.faults == {}


def test_a_missing_channel_costs_its_sample_alone_and_is_named(bench):
    for number in range(6):
        bench.cycle(number, groups=(0, 2) if number == 3 else (0, 1, 2))
    assert [sample.tensions_n[0] for sample in bench.samples] == [0.0, 1.0, 2.0, 4.0, 5.0]
    assert bench.faults == {FaultKind.MISSING_CHANNEL: {"cable_3": 1, "cable_4": 1}}
    assert bench.assembler.dropped == 1


def test_a_late_channel_costs_its_sample_and_is_named(counted):
    counted.cycle(0)
    counted.cycle(1, groups=(0, 1))
    counted.take(data(2, 1.0), 1.6e-3)
    counted.cycle(2)
    assert [sample.tensions_n[0] for sample in counted.samples] == [0.0, 2.0]
    assert counted.faults == {FaultKind.LATE_CHANNEL: {"cable_5": 1, "cable_6": 1}}


def test_without_a_counter_a_late_channel_is_named_and_the_order_found_again(plain):
    plain.cycle(0)
    plain.cycle(1, groups=(0, 1))
    plain.take(data(2, 1.0), 1.6e-3)
    for number in range(2, 6):
        plain.cycle(number)
    late = plain.faults[FaultKind.LATE_CHANNEL]
    assert (late["cable_5"], late["cable_6"]) == (1, 1)
    assert all(sample.skew_s <= SKEW_S for sample in plain.samples)
    assert [sample.tensions_n[0] for sample in plain.samples[-2:]] == [4.0, 5.0]


@pytest.mark.parametrize("jitter_s", [0.0, 3e-5])
def test_without_a_counter_samples_are_of_one_cycle_again_soon_after_a_lost_frame(jitter_s):
    """A skew limit of a whole cycle, as nodes with their own timers need, hides the cut."""
    noise = np.random.default_rng(1)
    bench = Assembly(0, skew_s=CYCLE_S)
    for number in range(60):
        for group in (0, 1, 2):
            if (number, group) != (20, 0):  # what follows would open each sample
                at_s = number * CYCLE_S + group * 1e-4 + noise.uniform(0.0, jitter_s)
                bench.take(data(group, float(number)), at_s)
    whole = [np.ptp(sample.tensions_n) == 0.0 for sample in bench.samples]
    assert all(whole[:20])
    assert all(whole[32:])
    assert len(bench.samples) > 55
    assert bench.faults[FaultKind.LATE_CHANNEL]["cycle"] == 1


def test_nodes_with_their_own_timers_have_no_pause_to_begin_at():
    bench = Assembly(0, skew_s=CYCLE_S)
    for number in range(60):
        for group, phase_s in enumerate((0.0, 3.5e-4, 7e-4)):
            bench.take(data(group, float(number)), number * CYCLE_S + phase_s)
    assert len(bench.samples) == 60
    assert bench.faults == {}


def test_a_channel_that_comes_twice_in_a_cycle_costs_its_sample(counted):
    counted.cycle(0)
    counted.take(opening(1), 1e-3)
    for group, at_s in ((0, 1.1e-3), (0, 1.15e-3), (1, 1.2e-3), (2, 1.3e-3)):
        counted.take(data(group, 1.0), at_s)
    counted.cycle(2)
    assert [sample.tensions_n[0] for sample in counted.samples] == [0.0, 2.0]
    assert counted.faults == {FaultKind.LATE_CHANNEL: {"cable_1": 1, "cable_2": 1}}


def test_a_lost_cycle_is_counted_and_the_next_sample_is_given(counted):
    for number in (254, 255, 256, 259, 260):
        counted.cycle(number)
    assert len(counted.samples) == 5
    report = counted.ledger.report()
    assert report.recent == {FaultKind.COUNTER_GAP: 1}
    assert (
        report.last[FaultKind.COUNTER_GAP] == "the cycle counter went from 0 to 3: 2 cycles lost"
    )


def test_a_counter_that_stands_still_means_old_values(counted):
    for number in range(4):
        counted.cycle(number, count=7)
    assert len(counted.samples) == 1
    assert counted.faults == {FaultKind.COUNTER_GAP: {"cycle counter": 3}}


def test_data_before_the_first_counter_is_no_fault(counted):
    counted.take(data(1), 0.5e-3)
    counted.cycle(1)
    assert len(counted.samples) == 1
    assert counted.faults == {}


def test_an_invalid_reading_costs_its_sample_without_a_missing_channel(bench):
    bench.cycle(0)
    if bench.counted:
        bench.take(opening(1), 1e-3)
    for group in range(3):
        bench.take(data(group, valid=group != 1), 1e-3 + (group + 1) * 1e-4)
    bench.cycle(2)
    assert [sample.tensions_n[0] for sample in bench.samples] == [0.0, 2.0]
    assert bench.faults == {}
    assert bench.assembler.dropped == 1


@given(
    st.sampled_from([0, 256]),
    st.lists(
        st.tuples(st.integers(0, 3), st.floats(0.0, 2e-3), st.booleans(), st.integers(0, 255)),
        max_size=80,
    ),
)
@settings(max_examples=100, deadline=None)
def test_any_sequence_of_frames_gives_only_whole_samples_within_the_limit(modulo, sequence):
    bench, time_s, marks, invalid_marks = Assembly(modulo), 0.0, {}, set()
    for mark, (kind, wait_s, valid, count) in enumerate(sequence, start=1):
        time_s += wait_s
        marks[float(mark)] = time_s
        if kind == 3:
            bench.take(opening(count) if modulo else data(0, float(mark)), time_s)
            continue
        if not valid:
            invalid_marks.add(float(mark))
        bench.take(data(kind, float(mark), valid), time_s)
    for sample in bench.samples:
        values = sample.tensions_n.tolist()
        times_s = [marks[value] for value in values]  # each value was sent, and by whom is known
        assert max(times_s) - min(times_s) <= SKEW_S + 1e-12
        assert not invalid_marks & set(values)
        assert all(value in marks for value in values)


def test_stamps_of_this_machines_clock_are_kept():
    clock = BusClock()
    for number in range(100):
        stamp_s = NOW_S + number * 1e-3
        late_s = 0.03 if number % 7 == 0 else 1e-4
        assert clock.time_s(stamp_s, stamp_s + late_s) == stamp_s


def test_an_adapters_own_clock_is_carried_over_and_its_drift_followed():
    rng, clock, error_s = np.random.default_rng(0), BusClock(), []
    for number in range(5_000):
        true_s = number * 1e-2
        stamp_s = 12.0 + true_s * (1.0 + 100e-6)
        arrival_s = NOW_S + true_s + 1e-4 + rng.exponential(1e-3)
        error_s.append(clock.time_s(stamp_s, arrival_s) - (NOW_S + true_s))
    assert np.abs(error_s[100:]).max() < 2e-3
    assert np.std(error_s[100:]) < 0.5e-3  # not the millisecond by which arrival is scattered


@pytest.mark.parametrize("stamp_s", [0.0, -1.0, math.nan, math.inf])
def test_without_a_usable_stamp_a_frame_counts_from_arrival(stamp_s):
    assert BusClock().time_s(stamp_s, NOW_S) == NOW_S


def test_a_clock_that_was_set_is_noticed():
    clock = BusClock()
    clock.time_s(500.0, NOW_S)
    assert clock.time_s(1.0, NOW_S + 1.0) == pytest.approx(NOW_S + 1.0)
    assert clock.time_s(NOW_S + 2.0, NOW_S + 2.0) == pytest.approx(NOW_S + 2.0)


class Reading:
    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE, interface="virtual"):
        self.ledger = FaultLedger()
        self.reader = TensionReader(
            channel_map, database, CanInterface(interface, "bench"), self.ledger
        )
        self.time_s = NOW_S

    def send(self, frames):
        given = [self.reader.take(frame, frame.timestamp + 1e-4) for frame in frames]
        return [sample for sample in given if sample is not None]

    def cycles(self, count, tensions_n=TENSIONS_N, first=0, change=lambda number, frames: frames):
        samples = []
        for number in range(first, first + count):
            start_s = NOW_S + number * 1e-3
            samples += self.send(change(number, packed_cycle(tensions_n, number, start_s)))
        return samples

    @property
    def faults(self):
        return set(self.ledger.report().recent)


@pytest.fixture
def reading():
    return Reading()


def test_a_second_of_frames_is_a_thousand_samples_with_their_bus_times(reading):
    samples = reading.cycles(1000)
    assert len(samples) == reading.reader.samples == 1000
    assert np.allclose([sample.tensions_n for sample in samples], TENSIONS_N, atol=0.051)
    assert np.allclose([s.time_s for s in samples], NOW_S + np.arange(1000) * 1e-3, atol=1e-6)
    assert reading.faults == set()
    assert reading.reader.largest_skew_s == pytest.approx(3e-4, abs=1e-6)


@pytest.mark.parametrize(("interface", "given"), [("virtual", 9), ("slcan", 10)])
def test_a_pause_in_reading_costs_nothing_where_frames_bear_the_time_of_reading(interface, given):
    reading = Reading(interface=interface)

    def pause(number, frames):
        for delayed in frames[2:]:
            delayed.timestamp += 0.02 if number == 9 else 0.0
        return frames

    assert len(reading.cycles(10, change=pause)) == given


def test_after_reopening_any_counter_and_clock_is_taken_and_bus_off_is_over(reading):
    reading.cycles(3)
    reading.reader.bus.error_frame(0x40, bytes(8))
    reading.ledger.report()
    reading.reader.reopened()
    assert reading.reader.bus.condition == ERROR_ACTIVE
    assert reading.reader.bus.recoveries == 0
    frames = packed_cycle(TENSIONS_N, 200, 5.0)
    samples = [reading.reader.take(f, NOW_S + 9.0) for f in frames]
    assert samples[-1].time_s == pytest.approx(NOW_S + 9.0, abs=1e-3)
    assert reading.faults == set()


LIMITS = StuckLimits(after_s=2.0, others_moved_n=20.0)


@pytest.fixture
def watch():
    return StuckDetector(12, LIMITS)


def play(watch, samples, start_s=0.0, step_s=0.1):
    return [watch.stuck(sample, start_s + i * step_s) for i, sample in enumerate(samples)]


def test_a_resting_arm_is_not_stuck(watch):
    assert not any(play(watch, [np.full(12, 50.0)] * 100))


def test_a_channel_that_stands_still_while_the_others_move_is_found_and_released(watch):
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    found = play(watch, moving)
    assert found[19] == []  # two seconds have not passed
    assert found[-1] == [4]
    back = np.full(12, 50.0)
    assert watch.stuck(back, 5.0) == [4]  # the others came back; it has still not moved
    back[4] = 50.1
    assert watch.stuck(back, 5.1) == []
