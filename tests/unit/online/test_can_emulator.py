"""The emulated amplifier: frames of each cycle, every fault, an interface that is pulled."""

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.can.bus import CanInterface, FaultKind, FaultLedger, start_frames
from cablesense_online.can.emulator import Emulator, FaultRequestError
from cablesense_online.can.reader import FrameDecoder, TensionReader
from tests.helpers.can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE

NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


class Sink:
    """A bus that keeps what is sent, or does not take it."""

    def __init__(self):
        self.sent = []
        self.coming = []
        self.closed = False
        self.full = False

    def send(self, frame):
        if self.full:
            raise can.CanOperationError("transmit buffer full")
        self.sent.append(frame)

    def recv(self, timeout):
        return self.coming.pop(0) if self.coming else None

    def shutdown(self):
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


def test_canopen_nodes_boot_and_wait_to_be_started():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    sink = bench.sinks[0]
    assert [frame.arbitration_id for frame in sink.sent] == list(range(0x701, 0x70D))
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 12
    sink.coming = start_frames([4])
    bench.emulator.cycle(TENSIONS_N)
    assert [frame.arbitration_id for frame in sink.sent[12:]] == [0x184]
    sink.coming = start_frames([0])
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 25


class Pair:
    """An amplifier and a reader on one clock, without a bus between."""

    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE):
        self.map = channel_map
        self.ledger = FaultLedger()
        sink = Sink()
        self.amplifier = Emulator(channel_map, database, lambda: sink)
        self.reader = TensionReader(
            channel_map, database, CanInterface("virtual", "bench"), self.ledger
        )
        self.time_s = NOW_S
        sink.coming = start_frames(channel_map.nmt_start_nodes)
        self.amplifier.listen()

    def cycles(self, count, tensions_n=TENSIONS_N):
        """Samples of so many cycles, a hundredth of the cycle from frame to frame."""
        samples = []
        for _ in range(count):
            begin_s = self.time_s
            for frame in self.amplifier.frames(tensions_n):
                self.time_s += self.map.cycle_time_s / 100.0
                frame.timestamp = self.time_s
                sample = self.reader.take(frame, self.time_s + 1e-5)
                samples += [sample] if sample is not None else []
            self.time_s = max(self.time_s, begin_s + self.map.cycle_time_s)
        last = self.reader.lapse()
        return samples if last is None else [*samples, last]

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
        ("wrong_length cable_6", FaultKind.WRONG_LENGTH, 0.0),
        ("over_range cable_6", FaultKind.OVER_RANGE, 0.0),
        ("unknown_id", FaultKind.UNKNOWN_ID, 1.0),
        ("error_frame", FaultKind.ERROR_FRAME, 1.0),
        ("bus_off", FaultKind.BUS_OFF, 0.0),
        ("counter_gap", FaultKind.COUNTER_GAP, 0.94),
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
    given = sum(len(packed.cycles(1, TENSIONS_N + 0.05 * number)) for number in range(2200))
    assert 1900 < given < 2100
    assert packed.ledger.report().recent == {FaultKind.STUCK_VALUE: {"cable_6": 2200 - given}}


@pytest.mark.parametrize(
    ("text", "of", "refusal"),
    [
        ("explosion", "packed", "unknown fault 'explosion'; there are missing_"),
        ("missing_channel", "packed", "needs one cable of cable_1 … cable_12"),
        ("missing_channel cable_13", "packed", "needs one cable"),
        ("bus_off cable_1", "packed", "concerns the whole bus"),
        ("counter_gap", "single", "no cycle counter"),
    ],
)
def test_what_cannot_be_requested_is_refused(request, text, of, refusal):
    with pytest.raises(FaultRequestError, match=refusal):
        request.getfixturevalue(of).request(text)


TWELVE = st.lists(st.floats(-49.0, 3270.0), min_size=12, max_size=12)


@pytest.mark.parametrize(
    ("channel_map", "database", "half_step_n"),
    [(PACKED, PACKED_DATABASE, 0.05), (SINGLE, SINGLE_DATABASE, 0.0005)],
    ids=["packed", "cia404"],
)
@given(tensions_n=TWELVE)
@settings(max_examples=20, deadline=None)
def test_what_is_encoded_is_decoded_to_half_a_step(channel_map, database, half_step_n, tensions_n):
    decoder = FrameDecoder(channel_map, database, FaultLedger())
    pair = Pair(channel_map, database)
    decoded = [decoder.decode(frame) for frame in pair.amplifier.frames(tensions_n)]
    readings = dict(reading for one in decoded for reading in one.readings)
    assert [readings[i] for i in range(12)] == pytest.approx(tensions_n, abs=half_step_n + 1e-9)
    assert all(one.valid for one in decoded)
