"""The emulated amplifier: frames of each cycle, every fault, sinks, recordings played back."""

import math
from contextlib import suppress

import can
import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE, packed_cycle
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.installation import config_path
from cablesense_online.can.bus import (
    CanInterface,
    FaultKind,
    FaultLedger,
    booted_node,
    start_frames,
)
from cablesense_online.can.channel_map import Channel, ChannelMapError, parse_database
from cablesense_online.can.decoder import FrameDecoder
from cablesense_online.can.emulated_amplifier import (
    EmulatedAmplifier,
    FaultRequest,
    FaultRequestError,
    FrameEncoder,
    PlannedFrame,
)
from cablesense_online.can.emulator import PAUSE_S, BusSink, Emulator, RecordingPlayer, play
from cablesense_online.can.tension_reader import TensionReader


class Sink:
    def __init__(self):
        self.sent, self.coming, self.closed, self.dropped = [], [], False, 0

    def send(self, frames):
        self.sent += frames

    def received(self):
        coming, self.coming = self.coming, []
        return coming

    def close(self):
        self.closed = True


class Bench:
    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE):
        self.sinks = []
        self.emulator = Emulator(channel_map, database, self.open)

    def open(self):
        self.sinks.append(Sink())
        return self.sinks[-1]


@pytest.fixture
def bench():
    return Bench()


def test_every_set_of_tensions_is_one_cycle(bench):
    for _ in range(3):
        bench.emulator.cycle(TENSIONS_N)
    numbers = [frame.arbitration_id for frame in bench.sinks[0].sent]
    assert numbers == [0x120, 0x121, 0x122, 0x123] * 3
    assert bench.emulator.cycles == 3


def test_canopen_nodes_boot_and_wait_to_be_started():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    sink = bench.sinks[0]
    assert [frame.arbitration_id for frame in sink.sent] == list(range(0x701, 0x70D))
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 12
    sink.coming = start_frames(range(1, 13))
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 24


def test_an_interface_is_pulled_and_plugged_in_again_on_request(bench):
    bench.emulator.request("interface_lost")
    assert bench.sinks[0].closed
    bench.emulator.cycle(TENSIONS_N)
    assert bench.emulator.dropped == 0
    bench.emulator.request("")
    bench.emulator.cycle(TENSIONS_N)
    assert len(bench.sinks[1].sent) == 4
    bench.emulator.close()
    bench.emulator.close()
    assert bench.sinks[1].closed


def test_a_fault_that_cannot_be_is_refused_and_changes_nothing(bench):
    bench.emulator.request(" missing_channel  cable_1 ")
    for wrong in ("explosion", "not_finite cable_2"):
        with pytest.raises(FaultRequestError):
            bench.emulator.amplifier.requested(wrong)
        with pytest.raises(FaultRequestError):
            bench.emulator.request(wrong)
    bench.emulator.amplifier.requested("")
    assert bench.emulator.fault == "missing_channel  cable_1"
    bench.emulator.cycle(TENSIONS_N)
    assert [f.arbitration_id for f in bench.sinks[0].sent] == [0x120, 0x122, 0x123]


NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


class Pair:
    """An amplifier and a reader on one clock, without a bus between."""

    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE):
        self.map = channel_map
        self.ledger = FaultLedger()
        self.amplifier = EmulatedAmplifier(channel_map, database)
        self.reader = TensionReader(
            channel_map, database, CanInterface("virtual", "bench"), self.ledger
        )
        self.time_s = NOW_S
        for frame in start_frames(channel_map.nmt_start_nodes):
            self.amplifier.take(frame)

    def cycles(self, count, tensions_n=TENSIONS_N):
        """Samples of so many cycles, a hundredth of the cycle from frame to frame."""
        samples = []
        for _ in range(count):
            begin_s = self.time_s
            for planned in self.amplifier.cycle(tensions_n):
                self.time_s += planned.wait_s + self.map.cycle_time_s / 100.0
                planned.frame.timestamp = self.time_s
                sample = self.reader.take(planned.frame, self.time_s + 1e-5, self.time_s)
                samples += [sample] if sample is not None else []
            self.time_s = max(self.time_s, begin_s + self.map.cycle_time_s)
        return samples

    def request(self, text):
        self.amplifier.request(text)


@pytest.fixture
def packed():
    return Pair()


@pytest.fixture
def single():
    return Pair(SINGLE, SINGLE_DATABASE)


@pytest.fixture(params=["packed", "single"])
def pair(request):
    return request.getfixturevalue(request.param)


def test_without_a_fault_every_cycle_is_a_sample(pair):
    samples = pair.cycles(50)
    assert len(samples) == 50
    assert np.allclose([sample.tensions_n for sample in samples], TENSIONS_N, atol=0.051)
    assert pair.ledger.report().recent == {}


@pytest.mark.parametrize(
    ("text", "kind", "share_given"),
    [
        ("missing_channel cable_6", FaultKind.MISSING_CHANNEL, 0.0),
        ("late_channel cable_6", FaultKind.LATE_CHANNEL, 0.0),
        ("wrong_length cable_6", FaultKind.WRONG_LENGTH, 0.0),
        ("unreadable cable_6", FaultKind.UNREADABLE, 0.0),
        ("over_range cable_6", FaultKind.OVER_RANGE, 0.0),
        ("under_range cable_6", FaultKind.UNDER_RANGE, 0.0),
        ("unknown_id", FaultKind.UNKNOWN_ID, 1.0),
        ("error_frame", FaultKind.ERROR_FRAME, 1.0),
        ("bus_off", FaultKind.BUS_OFF, 0.0),
        ("counter_gap", FaultKind.COUNTER_GAP, 1.0),
    ],
)
def test_each_fault_is_named_and_ends_with_its_cause(packed, text, kind, share_given):
    packed.cycles(20)
    packed.request(text)
    assert len(packed.cycles(100)) == pytest.approx(100 * share_given, abs=1)
    assert kind in packed.ledger.report().recent
    packed.request("")
    packed.cycles(2)  # the fault's last sample is named with the next one
    packed.ledger.report()
    samples = packed.cycles(100)
    assert len(samples) == 100
    assert np.allclose(samples[-1].tensions_n, TENSIONS_N, atol=0.051)
    assert packed.ledger.report().recent == {}


def test_a_stuck_channel_is_found_while_the_others_move(packed):
    packed.request("stuck_value cable_6")
    given = sum(len(packed.cycles(1, TENSIONS_N + 0.05 * number)) for number in range(2500))
    assert 1900 < given < 2100
    assert packed.ledger.report().places == {FaultKind.STUCK_VALUE: {"cable_6": 2500 - given}}


@pytest.mark.slow
def test_a_flood_is_named_and_costs_no_sample(packed):
    packed.request("flooded")
    assert len(packed.cycles(2000)) == 2000
    assert set(packed.ledger.report().recent) == {FaultKind.FLOODED, FaultKind.UNKNOWN_ID}


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("invalid_status cable_6", FaultKind.INVALID_STATUS),
        ("over_range cable_6", FaultKind.OVER_RANGE),
        ("under_range cable_6", FaultKind.UNDER_RANGE),
        ("missing_channel cable_6", FaultKind.MISSING_CHANNEL),
    ],
)
def test_faults_of_a_node_are_found_by_its_status(single, text, kind):
    single.request(text)
    assert single.cycles(20) == []
    single.reader.silence(single.time_s + 1.0)
    assert set(single.ledger.report().places[kind]) == {"cable_6"}


def test_nan_is_found_in_a_signal_that_can_carry_it(packed):
    with pytest.raises(FaultRequestError, match="whole number"):
        packed.request("not_finite cable_3")
    text = config_path("can/cia404_amplifier.dbc").read_text(encoding="utf-8")
    floating = Pair(SINGLE, parse_database(text + "SIG_VALTYPE_ 387 VALUE_3 : 1;\n"))
    floating.request("not_finite cable_3")
    assert floating.cycles(5) == []
    assert floating.ledger.report().places == {FaultKind.NOT_FINITE: {"cable_3": 5}}


def test_silence_sends_nothing(packed):
    packed.request("silent_bus")
    assert packed.amplifier.cycle(TENSIONS_N) == []


def test_canopen_nodes_send_only_after_they_were_started():
    amplifier = EmulatedAmplifier(SINGLE, SINGLE_DATABASE)
    booted = [booted_node(frame, SINGLE.nmt_start_nodes) for frame in amplifier.power_up()]
    assert booted == list(range(1, 13))
    assert amplifier.cycle(TENSIONS_N) == []
    amplifier.take(start_frames([4])[0])
    assert [one.frame.arbitration_id for one in amplifier.cycle(TENSIONS_N)] == [0x184]
    amplifier.take(start_frames([0])[0])
    assert len(amplifier.cycle(TENSIONS_N)) == 12
    amplifier.power_up()
    assert amplifier.cycle(TENSIONS_N) == []


def requested(text, channel_map=PACKED, database=PACKED_DATABASE):
    return EmulatedAmplifier(channel_map, database).requested(text)


@pytest.mark.parametrize(
    "kind", [k for k in FaultKind if k.name not in ("NOT_FINITE", "COUNTER_GAP")]
)
def test_every_kind_can_be_requested(kind):
    cable = "cable_5" if kind.of_cable else ""
    text = f" {kind.name.lower()}  {cable} "
    assert requested(text, SINGLE, SINGLE_DATABASE) == FaultRequest(kind, cable)


def test_an_empty_text_ends_a_fault():
    assert requested("  ") is None


@pytest.mark.parametrize(
    ("text", "amplifier", "refusal"),
    [
        ("explosion", (PACKED, PACKED_DATABASE), "unknown fault 'explosion'; there are missing_"),
        ("missing_channel", (PACKED, PACKED_DATABASE), "needs one cable of cable_1 … cable_12"),
        ("missing_channel cable_13", (PACKED, PACKED_DATABASE), "needs one cable"),
        ("bus_off cable_1", (PACKED, PACKED_DATABASE), "concerns the whole bus"),
        ("counter_gap", (SINGLE, SINGLE_DATABASE), "no cycle counter"),
        ("invalid_status cable_1", (PACKED, PACKED_DATABASE), "no status"),
    ],
)
def test_what_cannot_be_requested_is_refused(text, amplifier, refusal):
    with pytest.raises(FaultRequestError, match=refusal):
        requested(text, *amplifier)


@given(st.text(max_size=60))
def test_any_text_is_a_fault_or_refused(text):
    amplifier = EmulatedAmplifier(PACKED, PACKED_DATABASE)
    with suppress(FaultRequestError):
        amplifier.request(text)
        assert amplifier.fault is None or isinstance(amplifier.fault, FaultRequest)


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


FRAMES = [can.Message(arbitration_id=n, is_extended_id=False) for n in range(1, 5)]


@pytest.fixture
def buses():
    interface = CanInterface("virtual", "test_can_frame_sink")
    with interface.open() as one, interface.open() as other:
        yield one, other


def test_frames_without_a_wait_go_together():
    played = []

    class Sink:
        def send(self, frames):
            played.append([frame.arbitration_id for frame in frames])

    planned = [PlannedFrame(frame) for frame in FRAMES[:3]] + [PlannedFrame(FRAMES[3], 0.5)]
    play(Sink(), planned, played.append)
    assert played == [[1, 2, 3], 0.5, [4]]


def test_a_bus_takes_frames_and_gives_those_of_others(buses):
    sink = BusSink(buses[0])
    sink.send(FRAMES)
    assert [buses[1].recv(1.0).arbitration_id for _ in FRAMES] == [1, 2, 3, 4]
    buses[1].send(FRAMES[0])
    assert [frame.arbitration_id for frame in sink.received()] == [1]
    assert sink.received() == []


def test_frames_that_the_bus_does_not_take_are_counted(buses, monkeypatch):
    def full(frame):
        raise can.CanOperationError("transmit buffer full")

    sink = BusSink(buses[0])
    monkeypatch.setattr(buses[0], "send", full)
    sink.send(FRAMES)
    assert sink.dropped == 4


TIME_S = np.array([5.0, 5.1, 5.2])
ROWS_N = np.arange(6.0).reshape(3, 2)
COMMANDS_RAD = np.array([[0.0], [0.0], [0.1]])


def make(loop=False):
    return RecordingPlayer(TIME_S, ROWS_N, COMMANDS_RAD, loop)


def tensions(rows):
    return [row[0].tolist() for row in rows]


def test_rows_come_when_they_are_due_and_a_command_when_it_is_new():
    player = make()
    first = player.due(100.0)
    assert tensions(first) == [[0.0, 1.0]]
    assert first[0][1].tolist() == [0.0]
    rest = player.due(100.25)
    assert tensions(rest) == [[2.0, 3.0], [4.0, 5.0]]
    assert rest[0][1] is None
    assert rest[1][1].tolist() == [0.1]
    assert player.ended
    assert player.due(200.0) == []


def test_an_unchanged_command_is_repeated_once_a_second():
    time_s = np.arange(31) * 0.1
    player = RecordingPlayer(time_s, np.zeros((31, 2)), np.zeros((31, 1)), loop=False)
    rows = [row for step in range(31) for row in player.due(50.0 + step * 0.1 + 1e-6)]
    repeated = [number for number, (_, command) in enumerate(rows) if command is not None]
    assert len(rows) == 31
    assert repeated == pytest.approx([0, 10, 20, 30], abs=2)


def test_a_loop_begins_again_after_a_pause():
    player = make(loop=True)
    player.due(100.0)
    player.due(100.25)
    assert player.due(100.2 + PAUSE_S - 0.01) == []
    again = player.due(100.2 + PAUSE_S + 0.01)
    assert tensions(again) == [[0.0, 1.0]]
    assert again[0][1].tolist() == [0.0]
    assert not player.ended


@given(st.lists(st.floats(0.0, 0.2), max_size=40))
def test_every_row_comes_once_and_in_order(waits_s):
    player, now_s, found = make(), 7.0, []
    found += tensions(player.due(now_s))
    for wait_s in waits_s:
        now_s += wait_s
        found += tensions(player.due(now_s))
    assert found == ROWS_N.tolist()[: len(found)]
    assert player.ended == (len(found) == 3)
