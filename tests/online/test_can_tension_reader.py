"""The whole way from frames to samples, with every fault that frames can carry."""

import can
import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE, packed_cycle, single_cycle

from cablesense_online.can.bus import BusCondition, CanInterface
from cablesense_online.can.faults import FaultKind, FaultLedger
from cablesense_online.can.tension_reader import TensionReader

NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


class Bench:
    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE, interface="virtual"):
        self.ledger = FaultLedger()
        self.reader = TensionReader(
            channel_map, database, CanInterface(interface, "bench"), self.ledger
        )
        self.time_s = NOW_S

    def send(self, frames):
        given = [
            self.reader.take(frame, frame.timestamp + 1e-4, frame.timestamp) for frame in frames
        ]
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
def bench():
    return Bench()


def test_a_second_of_frames_is_a_thousand_samples_with_their_bus_times(bench):
    samples = bench.cycles(1000)
    assert len(samples) == bench.reader.samples == 1000
    assert np.allclose([sample.tensions_n for sample in samples], TENSIONS_N, atol=0.051)
    assert np.allclose([s.time_s for s in samples], NOW_S + np.arange(1000) * 1e-3, atol=1e-6)
    assert bench.faults == set()
    assert bench.reader.largest_skew_s == pytest.approx(3e-4, abs=1e-6)


def test_cia_404_nodes_make_samples_too():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    samples = []
    for number in range(100):
        samples += bench.send(single_cycle(TENSIONS_N, NOW_S + number * 2e-3))
    assert len(samples) == 100
    assert bench.faults == set()


@pytest.mark.parametrize(("interface", "given"), [("virtual", 9), ("slcan", 10)])
def test_a_pause_in_reading_costs_nothing_where_frames_bear_the_time_of_reading(interface, given):
    bench = Bench(interface=interface)

    def pause(number, frames):
        for frame in frames[2:]:
            frame.timestamp += 0.02 if number == 9 else 0.0
        return frames

    assert len(bench.cycles(10, change=pause)) == given


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_a_missing_frame_costs_one_sample(bench, lost):
    samples = bench.cycles(
        10,
        change=lambda number, frames: [
            f for i, f in enumerate(frames) if (number, i) != (5, lost)
        ],
    )
    assert len(samples) == 9
    assert bench.reader.withheld == 1
    assert bench.faults == {FaultKind.MISSING_CHANNEL}


def test_a_reading_beyond_the_range_withholds_samples_while_it_lasts(bench):
    over = TENSIONS_N.copy()
    over[3] = 3276.7
    assert len(bench.cycles(10)) == 10
    assert bench.cycles(10, over, first=10) == []
    assert len(bench.cycles(10, first=20)) == 10
    report = bench.ledger.report()
    assert report.places == {FaultKind.OVER_RANGE: {"cable_4": 10}}


def test_a_stuck_channel_withholds_samples(bench):
    samples = 0
    for number in range(3000):
        tensions_n = TENSIONS_N + number * 0.05
        tensions_n[6] = 47.0
        samples += len(bench.cycles(1, tensions_n, first=number))
    assert 1990 <= samples < 2010
    assert bench.faults == {FaultKind.STUCK_VALUE}


def test_unknown_frames_between_do_no_harm(bench):
    stranger = can.Message(arbitration_id=0x555, is_extended_id=False, data=[1], timestamp=NOW_S)
    samples = bench.cycles(10, change=lambda number, frames: [*frames[:2], stranger, *frames[2:]])
    assert len(samples) == 10
    assert bench.faults == {FaultKind.UNKNOWN_ID}


def test_a_flood_of_the_amplifiers_own_frames_is_held_to_twice_its_rate(bench):
    samples = []
    for number in range(20_000):
        start_s = NOW_S + number * 5e-5
        samples += bench.send(packed_cycle(TENSIONS_N, number, start_s, step_s=1e-5))
    assert len(samples) < 2.2 * 1000 * 1.5
    assert FaultKind.FLOODED in bench.faults


def test_bus_off_and_recovery(bench):
    bench.cycles(3)
    off = can.Message(
        arbitration_id=0x40, is_error_frame=True, is_extended_id=False, data=bytes(8)
    )
    bench.send([off])
    assert bench.reader.bus.condition is BusCondition.OFF
    assert len(bench.cycles(3, first=3)) == 3
    assert bench.reader.bus.recoveries == 1
    assert bench.faults == {FaultKind.BUS_OFF}


def test_silence_names_what_did_not_come_once_a_cycle_has_passed(bench):
    bench.send(packed_cycle(TENSIONS_N, 0, NOW_S)[:2])
    bench.reader.silence(NOW_S + 0.5e-3)
    assert bench.faults == set()
    bench.reader.silence(NOW_S + 50e-3)
    assert bench.faults == {FaultKind.MISSING_CHANNEL}


def test_after_reopening_any_counter_and_clock_is_taken(bench):
    bench.cycles(3)
    bench.reader.reopened()
    frames = packed_cycle(TENSIONS_N, 200, 5.0)
    samples = [bench.reader.take(f, NOW_S + 9.0, NOW_S + 9.0) for f in frames]
    assert samples[-1].time_s == pytest.approx(NOW_S + 9.0, abs=1e-3)
    assert bench.faults == set()
