"""Floods: all known frames of a normal bus are admitted, a babbling node is held to a rate."""

from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.faults import FaultKind, FaultLedger
from cablesense_online.can.tension_reader import RateLimit


def make(ledger):
    return RateLimit(limit_frames_s=8000.0, known_frames_s=4000.0, ledger=ledger)


def test_a_normal_bus_is_never_flooded():
    ledger = FaultLedger()
    watch = make(ledger)
    assert all(watch.admit(True, number / 4000.0) for number in range(20_000))
    assert ledger.report().recent == {}


def test_a_backlog_of_a_pause_is_taken_whole():
    ledger = FaultLedger()
    watch = make(ledger)
    watch.admit(True, 0.0)
    assert all(watch.admit(True, 0.3) for _ in range(1200))
    assert ledger.report().recent == {}


def test_unknown_frames_beyond_the_limit_are_noted_and_known_ones_still_admitted():
    ledger = FaultLedger()
    watch = make(ledger)
    admitted = [watch.admit(number % 5 == 0, number / 20_000.0) for number in range(40_000)]
    assert all(admitted)
    assert set(ledger.report().places[FaultKind.FLOODED]) == {"bus"}


def test_a_babbling_amplifier_is_held_to_twice_its_rate():
    ledger = FaultLedger()
    watch = make(ledger)
    admitted = sum(watch.admit(True, number / 40_000.0) for number in range(400_000))
    assert admitted / 10.0 < 8000.0 * 1.1
    assert "amplifier" in ledger.report().places[FaultKind.FLOODED]


@given(st.lists(st.floats(0.0, 0.1), min_size=1, max_size=200), st.integers(1, 50))
def test_admission_never_exceeds_rate_and_allowance(waits_s, burst):
    watch = RateLimit(100.0, 50.0, FaultLedger())
    time_s, admitted = 0.0, 0
    for wait_s in waits_s:
        time_s += wait_s
        admitted += sum(watch.admit(True, time_s) for _ in range(burst))
    assert admitted <= 100.0 * (time_s + 0.5) + 1.0
