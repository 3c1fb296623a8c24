"""Samples of decoded frames: whole, held, and withheld where a second sender may have been."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.can.assembler import DISTRUST_S, Decoded, SampleAssembler
from cablesense_online.can.bus import FaultKind, FaultLedger

NAMES = [f"cable_{n}" for n in range(1, 7)]
SKEW_S = 0.4e-3
CYCLE_S = 1e-3


def data(group, value=0.0, valid=True):
    """Channels 0-1, 2-3 or 4-5."""
    readings = [(2 * group, value), (2 * group + 1, value)]
    return Decoded(readings, valid, message=f"group_{group}")


def opening(count):
    return Decoded(counter=count, message="cycle")


class Assembly:
    def __init__(self, modulo, skew_s=SKEW_S, stamped=True):
        self.ledger = FaultLedger()
        self.assembler = SampleAssembler(NAMES, CYCLE_S, skew_s, modulo, self.ledger, stamped)
        self.given = []
        self.counted = modulo > 0

    def take(self, decoded, time_s):
        self.given.append(self.assembler.take(decoded, time_s))

    @property
    def samples(self):
        """Those given, also that which a silent bus gives."""
        self.given.append(self.assembler.lapse())
        return [sample for sample in self.given if sample is not None]

    def cycle(self, number, groups=(0, 1, 2), value=None, count=None):
        start_s = number * CYCLE_S
        if self.counted:
            self.take(opening((number if count is None else count) % 256), start_s)
        for place, group in enumerate(groups):
            at_s = start_s + (place + 1) * 1e-4
            self.take(data(group, float(number if value is None else value)), at_s)

    @property
    def faults(self):
        return self.ledger.report().recent


@pytest.fixture(params=[0, 256], ids=["without a counter", "with a counter"])
def bench(request):
    return Assembly(request.param)


@pytest.fixture
def counted():
    return Assembly(256)


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


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("after_s", [-2e-5, 2e-5, 5e-4])
def test_a_second_sender_of_an_id_gives_no_sample_until_it_has_been_silent(bench, place, after_s):
    bench.cycle(0)
    for number in range(1, 40):
        sent = [(number * CYCLE_S + 1e-4 * (1 + n), data(n, float(number))) for n in range(3)]
        sent.append((sent[place][0] + after_s, data(place, 99.0)))
        if bench.counted:
            bench.take(opening(number), number * CYCLE_S)
        for time_s, decoded in sorted(sent, key=lambda one: one[0]):
            bench.take(decoded, time_s)
    bench.cycle(40)
    given = [sample.tensions_n for sample in bench.samples]
    assert all(99.0 not in tensions_n for tensions_n in given)
    assert len(given) <= 2
    faults = bench.faults
    assert faults[FaultKind.DUPLICATE_ID][f"group_{place}"] > 30
    assert faults[FaultKind.DISTRUSTED_ID].keys() == {f"group_{place}"}
    later = round(DISTRUST_S / CYCLE_S) + 50
    for number in range(later, later + 3):
        bench.cycle(number)
    assert len(bench.samples) == len(given) + 3


def test_a_frame_that_was_sent_again_with_the_same_content_costs_nothing(bench):
    for number in range(3):
        bench.cycle(number, groups=(0, 1, 2, 2))
    assert [sample.tensions_n[0] for sample in bench.samples] == [0.0, 1.0, 2.0]
    assert bench.faults == {FaultKind.DUPLICATE_ID: {"group_2": 3}}


@pytest.mark.parametrize("lost", [None, *range(3)])
def test_a_counter_frame_that_is_lost_is_no_second_sender(counted, lost):
    """What follows it looks like second frames of the cycle before."""
    for number in range(3):
        counted.cycle(number)
    for group in range(3):
        if group != lost:
            counted.take(data(group, 3.0), 3e-3 + (1 + group) * 1e-4)
    for number in range(4, 6):
        counted.cycle(number)
    assert [sample.tensions_n[0] for sample in counted.samples] == [0.0, 1.0, 2.0, 4.0, 5.0]
    assert counted.faults == {FaultKind.COUNTER_GAP: {"cycle counter": 1}}


@pytest.mark.parametrize(
    ("back", "stamped"),
    [(1, True), (10, True), (100, True), (200, True), (1, False), (100, False)],
)
def test_cycles_that_are_sent_again_are_withheld(back, stamped):
    counted = Assembly(256, stamped=stamped)
    for number in range(300):
        counted.cycle(number)
    before = len(counted.samples)
    for number in range(300, 600):
        counted.cycle(number, value=99.0, count=number - back - 1)
    assert len(counted.samples) == before
    assert counted.faults[FaultKind.COUNTER_JUMP] == {"cycle": 1}


@pytest.mark.parametrize(("pause", "at_once"), [(0, False), (300, True)])
def test_a_restarted_amplifier_is_believed_after_a_pause_or_after_a_while(counted, pause, at_once):
    for number in range(100):
        counted.cycle(number)
    begun = 100 + pause
    given = []
    for number in range(round(DISTRUST_S / CYCLE_S) + 10):
        before = len(counted.given)
        counted.cycle(begun + number, count=number)
        given += [n for n in counted.given[before:] if n is not None]
    kind = FaultKind.COUNTER_GAP if at_once else FaultKind.COUNTER_JUMP
    assert counted.faults[kind]
    assert len(given) == pytest.approx(10_010 if at_once else 10, abs=2)


def test_a_counter_that_stands_still_means_old_values(counted):
    for number in range(4):
        counted.cycle(number, count=7)
    assert len(counted.samples) == 0
    assert counted.faults == {FaultKind.COUNTER_GAP: {"cycle counter": 3}}


@given(
    st.sampled_from([0, 256]),
    st.lists(
        st.tuples(st.integers(0, 3), st.floats(0.0, 2e-3), st.booleans(), st.integers(0, 255)),
        max_size=80,
    ),
)
@settings(max_examples=100, deadline=None)
def test_any_sequence_of_frames_gives_only_whole_samples_within_the_limit(modulo, sequence):
    bench = Assembly(modulo)
    time_s = 0.0
    marks = {}
    invalid_marks = set()
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
