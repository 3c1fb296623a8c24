"""Frames to valid samples: rates limited, stuck channels found, anything in doubt withheld."""

import can
import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE, packed_cycle, single_cycle
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.bus import BusCondition, CanInterface, FaultKind, FaultLedger
from cablesense_online.can.channel_map import StuckLimits
from cablesense_online.can.tension_reader import StuckDetector, TensionReader, TokenBucket

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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_flood_of_the_amplifiers_own_frames_is_held_to_twice_its_rate(bench):
    samples = []
    for number in range(6_000):
        start_s = NOW_S + number * 5e-5
        samples += bench.send(packed_cycle(TENSIONS_N, number, start_s, step_s=1e-5))
    assert len(samples) < 2.2 * 1000 * (0.3 + 0.5)
    assert "amplifier" in bench.ledger.report().places[FaultKind.FLOODED]


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


def test_after_reopening_any_counter_and_clock_is_taken_and_bus_off_is_over(bench):
    bench.cycles(3)
    bench.reader.bus.error_frame(0x40, bytes(8))
    bench.ledger.report()
    bench.reader.reopened()
    assert bench.reader.bus.condition is BusCondition.ACTIVE
    assert bench.reader.bus.recoveries == 0
    frames = packed_cycle(TENSIONS_N, 200, 5.0)
    samples = [bench.reader.take(f, NOW_S + 9.0, NOW_S + 9.0) for f in frames]
    assert samples[-1].time_s == pytest.approx(NOW_S + 9.0, abs=1e-3)
    assert bench.faults == set()


def test_a_backlog_of_a_pause_is_taken_whole(bench):
    frames = [packed_cycle(TENSIONS_N, n, NOW_S + n * 1e-3) for n in range(300)]
    now_s = NOW_S + 0.3
    given = [bench.reader.take(frame, now_s, now_s) for cycle in frames for frame in cycle]
    assert sum(sample is not None for sample in given) == 300
    assert bench.faults == set()


def test_unknown_frames_beyond_the_limit_are_noted_and_known_ones_still_taken(bench):
    stranger = can.Message(arbitration_id=0x555, is_extended_id=False, data=[1])

    def flood(number, frames):
        stranger.timestamp = frames[0].timestamp
        return [*[stranger] * 20, *frames]

    assert len(bench.cycles(500, change=flood)) == 500
    assert set(bench.ledger.report().places[FaultKind.FLOODED]) == {"bus"}


@given(st.lists(st.floats(0.0, 0.1), min_size=1, max_size=200), st.integers(1, 50))
def test_a_bucket_never_gives_more_than_rate_and_allowance(waits_s, burst):
    bucket, time_s, taken = TokenBucket(100.0), 0.0, 0
    for wait_s in waits_s:
        time_s += wait_s
        taken += sum(bucket.take(time_s) for _ in range(burst))
    assert taken <= 100.0 * (time_s + 0.5) + 1.0


LIMITS = StuckLimits(after_s=2.0, others_moved_n=20.0)


@pytest.fixture
def watch():
    return StuckDetector(12, LIMITS)


def play(watch, samples, start_s=0.0, step_s=0.1):
    return [watch.stuck(sample, start_s + i * step_s) for i, sample in enumerate(samples)]


def test_a_resting_arm_is_not_stuck(watch):
    assert set(play(watch, [np.full(12, 50.0)] * 100)) == {()}


def test_a_channel_that_stands_still_while_the_others_move_is_found_and_released(watch):
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    found = play(watch, moving)
    assert found[19] == ()  # two seconds have not passed
    assert found[-1] == (4,)
    back = np.full(12, 50.0)
    assert watch.stuck(back, 5.0) == (4,)  # the others came back; it has still not moved
    back[4] = 50.1
    assert watch.stuck(back, 5.1) == ()


def test_few_others_that_move_prove_nothing(watch):
    moving = np.full((40, 12), 50.0)
    moving[:, :5] += np.linspace(0.0, 50.0, 40)[:, None]
    assert set(play(watch, moving)) == {()}


def test_a_restart_forgets(watch):
    moving = np.linspace(50.0, 100.0, 40)[:, None] * np.ones(12)
    moving[:, 4] = 50.0
    play(watch, moving)
    watch.restart()
    assert watch.stuck(moving[-1], 9.0) == ()


def test_a_lone_channel_is_never_stuck():
    assert set(play(StuckDetector(1, LIMITS), [np.array([50.0])] * 100)) == {()}
