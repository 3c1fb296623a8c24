"""The mean over a whole turn is what an arm without friction would read; or nothing is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_msgs_py.messages import BREATH_END, Level
from cablesense_online.breath_readings import SILENT_AFTER_S, BreathReadings

TRUE_N = np.array([0.0, *np.linspace(20.0, 120.0, 11)])  # one cable is slack
GRIP = 0.16
MS = 1_000_000


class StickingCables:
    """Cables that slide in and out, one after the other; readings are off by exp(± grip)."""

    def __init__(self, period_ms=10, first_ms=0, true_n=TRUE_N):
        self.readings, self.now_ns = BreathReadings(settle_s=0.1), 10**18 + first_ms * MS
        self.period_ms, self.true_n = period_ms, true_n
        self.begun_ns = self.now_ns

    def read(self, until_ms, inwards=None):
        answer = None
        while self.now_ns < self.begun_ns + until_ms * MS:
            self.now_ns += self.period_ms * MS
            phase = 2.0 * np.pi * (self.now_ns - 10**18) / (400.0 * MS) + np.arange(12)
            way = np.sign(np.sin(phase)) if inwards is None else inwards
            tensions = self.true_n * np.exp(GRIP * way)
            answer = self.readings.without_friction(tensions.tolist(), self.now_ns)
        return answer

    def mark(self, turn):
        return self.readings.mark(turn, self.now_ns)

    def breathe(self, left=1.0):
        """One breath; at its end all cables stick with a share `left` of their grip inwards."""
        self.mark(0)
        self.read(200)
        self.mark(1)
        self.read(600)
        self.mark(0)
        self.read(800)
        self.mark(BREATH_END)
        return self.read(1200, inwards=left)


@pytest.mark.parametrize("left", [1.0, -1.0, 0.3])
def test_after_a_breath_readings_are_those_without_friction(left):
    cables = StickingCables()
    np.testing.assert_allclose(cables.breathe(left), TRUE_N, rtol=0.01, atol=1e-9)
    # a change of load that gets through shows in full
    cables.true_n = TRUE_N + 5.0
    change = cables.read(1300, inwards=left) - TRUE_N
    np.testing.assert_allclose(change, 5.0 * np.exp(GRIP * left), atol=0.05 * TRUE_N.max() * GRIP)
    cables.readings.moved()
    stuck_n = (TRUE_N + 5.0) * np.exp(GRIP * left)
    assert cables.read(1400, inwards=left) == pytest.approx(stuck_n)
    assert cables.readings.status().level is Level.WARN


@settings(max_examples=20)
@given(first_ms=st.integers(0, 400), period_ms=st.integers(5, 20))
def test_no_rate_or_phase_of_the_sensors_matters_much(first_ms, period_ms):
    answer = StickingCables(period_ms, first_ms).breathe(1.0)
    np.testing.assert_allclose(answer, TRUE_N, rtol=2.5 * GRIP * period_ms / 400.0 + 0.01)


def test_there_is_no_answer_before_a_whole_turn_and_each_turn_renews_it():
    cables = StickingCables()
    assert cables.read(100, inwards=1.0) is not None
    cables.mark(0)
    assert cables.read(200) is None
    cables.mark(1)
    assert cables.read(590) is None
    cables.read(600)
    cables.mark(2)
    np.testing.assert_allclose(cables.read(700), TRUE_N, rtol=0.01)
    cables.true_n = 1.5 * TRUE_N
    cables.read(1000)
    cables.mark(3)
    cables.read(1400)
    cables.mark(4)
    np.testing.assert_allclose(cables.read(1410), 1.5 * TRUE_N, rtol=0.01)


def test_too_few_readings_or_a_gap_make_no_turn():
    assert StickingCables(period_ms=100).breathe(1.0) == pytest.approx(TRUE_N * np.exp(GRIP))
    cables = StickingCables()
    cables.mark(0)
    cables.read(200)
    cables.mark(1)
    cables.read(300)
    cables.now_ns += 150 * MS
    cables.read(600)
    cables.mark(0)
    assert cables.read(700) is None


def test_a_load_that_comes_during_the_breath_is_not_taken_for_friction():
    cables = StickingCables()
    cables.mark(0)
    cables.read(200)
    cables.mark(1)
    cables.read(600)
    cables.mark(0)
    cables.true_n = TRUE_N + 30.0
    cables.read(800)
    cables.mark(BREATH_END)
    answer = cables.read(1200, inwards=1.0)
    assert answer == pytest.approx((TRUE_N + 30.0) * np.exp(GRIP))
    status = cables.readings.status()
    assert status.level is Level.ERROR
    assert "the load changed by" in status.message


def test_a_breather_that_is_gone_is_missed_and_readings_count_as_they_are():
    cables = StickingCables()
    cables.mark(0)
    readings = cables.readings
    assert cables.read(200) is None
    assert not readings.silent(0.0)
    assert not readings.silent(0.9 * SILENT_AFTER_S)
    cables.mark(0)  # it is still there
    assert not readings.silent(1.5 * SILENT_AFTER_S)
    assert readings.silent(2.6 * SILENT_AFTER_S)
    readings.give_up("gone")
    assert cables.read(400, inwards=1.0) == pytest.approx(TRUE_N * np.exp(GRIP))
    assert readings.status().level is Level.ERROR
    assert not readings.silent(9.0)


@settings(max_examples=30)
@given(begin_ms=st.integers(0, 1190))
def test_the_state_alone_goes_on_as_well(begin_ms):
    script = [(0, 0), (200, 1), (600, 2), (800, 0), (900, BREATH_END)]
    cables, other = StickingCables(), StickingCables()
    for at_ms, turn in [*script, (1300, None)]:
        for until in sorted({min(at_ms, begin_ms), at_ms}):
            cables.read(until)
            other.read(until)
            if until == begin_ms:
                other.readings = BreathReadings(settle_s=0.1)
                other.readings.state = cables.readings.state.model_copy()
        if turn is not None:
            cables.mark(turn)
            other.mark(turn)
        assert cables.readings.state.model_dump_json() == other.readings.state.model_dump_json()
