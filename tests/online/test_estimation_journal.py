"""Journal and samples alone give the answers again: whatever happened when, from any entry on."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.journal import Event, EventKind
from cablesense_msgs_py.topics import ContractError
from cablesense_online.estimation import Estimation
from cablesense_online.journal import EstimationJournal, EstimationSettings
from cablesense_online.motion_gate import MotionGate
from cablesense_online.tare import TareModel, UnloadedTensions
from cablesense_sim.arm import open_arm

serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

ARM = open_arm("cdsm")
SETTINGS = EstimationSettings(
    contact_threshold=0.5,
    stale_after_s=0.2,
    slack_below_n=1.0,
    tare_samples=4,
    tare_steady_n=1.0,
    auto_tare=True,
    joint_speed_rad_s=0.35,
    settle_s=0.05,
)
EPOCH_NS = 10**18
STEP_NS = 10_000_000


class EveryBit:
    """An answer in which every bit of the difference and of the command shows."""

    pose_aware = True

    def estimate(self, tension_difference_n, joint_command_rad):
        weights = np.arange(1.0, 13.0)
        return SimpleNamespace(
            probabilities=np.array([0.25, 0.0, 0.75, 0.0, 0.0]),
            angle_deg=float(weights[:8] @ joint_command_rad),
            magnitude_n=100.0 + float(weights @ tension_difference_n),
        )


def estimation(arm=ARM):
    return Estimation(arm, EveryBit(), SETTINGS, 0.0)


def sample(tensions, stamp_ns):
    message = sensor_msgs.JointState(name=list(ARM.cable_names), effort=tensions.tolist())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return serialization.serialize_message(message)


def live_run(seed, count=120):
    """Samples in order with their outcomes, while commands and tares come between them."""
    rng = np.random.default_rng(seed)
    live, course, stamp = estimation(), [], EPOCH_NS
    for _ in range(count):
        chance = rng.random()
        if chance < 0.05:
            angles = rng.uniform(-0.004, 0.004, 8)
            live.command(SimpleNamespace(name=ARM.joint_names, position=angles))
        elif chance < 0.15:
            with suppress(CableSenseError):
                live.take_tare(stamp) if chance < 0.12 else live.undo_tare()
        elif chance < 0.17:
            live.adjust(float(rng.uniform(0.0, 1.0)), 0.2, 1.0)
        stamp += STEP_NS if rng.random() < 0.99 else -STEP_NS * 100
        tensions = 100.0 + rng.uniform(-0.5, 0.5, 12)
        if rng.random() < 0.05:
            tensions[3] = np.nan
        raw = sample(tensions, stamp)
        course.append((raw, stamp, live.sample(raw, stamp + 3_000_000, 0.0)))
    return course


def told(outcome):
    return outcome.contact, tuple(outcome.probabilities), outcome.stamp_ns


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), begin=st.integers(0, 119))
@settings(max_examples=20, deadline=None)
def test_the_last_entry_and_the_samples_are_enough_from_anywhere(seed, begin):
    course = live_run(seed)
    entries = [outcome.entry for *_, outcome in course[: begin + 1] if outcome.entry is not None]
    other = estimation()
    other.restore(entries[-1])
    threshold = float(entries[-1].settings["contact_threshold"])
    other.adjust(threshold, 0.2, 1.0)
    for raw, stamp, outcome in course[begin:]:
        if outcome.entry is not None:
            other.adjust(float(outcome.entry.settings["contact_threshold"]), 0.2, 1.0)
            other.restore(outcome.entry)
        assert told(other.sample(raw, stamp, 0.0)) == told(outcome)


def test_what_happened_is_told_with_the_first_sample_after_it():
    live, stamp = estimation(), EPOCH_NS
    kinds = []
    for i in range(12):
        if i == 8:
            live.take_tare(stamp)
            live.undo_tare()
        if i == 10:
            live.command(SimpleNamespace(name=ARM.joint_names, position=[0.001] * 8))
            live.command(SimpleNamespace(name=ARM.joint_names, position=[0.002] * 8))
            live.command(SimpleNamespace(name=ARM.joint_names, position=[0.002] * 8))
        stamp += STEP_NS
        entry = live.sample(sample(np.full(12, 100.0), stamp), stamp, 0.0).entry
        if entry is not None:
            assert entry.before_ns == stamp
            kinds.append((i, [event.kind for event in entry.events]))
    assert kinds == [
        (0, [EventKind.START]),
        (4, [EventKind.AUTO_TARE]),
        (8, [EventKind.TARE, EventKind.TARE_UNDO]),
        (10, [EventKind.COMMAND, EventKind.COMMAND]),
    ]
    assert entry is None
    assert live.gate.rest_from_ns > stamp


def test_a_sample_refused_for_its_content_is_answered_with_its_stamp():
    live = estimation()
    outcome = live.sample(sample(np.full(12, np.nan), EPOCH_NS), EPOCH_NS, 0.0)
    assert outcome.problem is not None
    assert outcome.stamp_ns == EPOCH_NS
    refused = live.sample(sample(np.full(12, 100.0), EPOCH_NS - STEP_NS), EPOCH_NS, 0.0)
    assert refused.problem is not None
    assert refused.stamp_ns == 0


def test_another_arm_carries_the_tare_over_by_its_own_model():
    live, stamp = estimation(), EPOCH_NS
    for _ in range(5):
        stamp += STEP_NS
        entry = live.sample(sample(np.full(12, 100.0), stamp), stamp, 0.0).entry
    moved = replace(entry, arm="another", command_rad=(0.01,) * 8)
    other, same = estimation(), estimation()
    other.restore(moved)
    same.restore(replace(entry, command_rad=(0.01,) * 8))
    np.testing.assert_array_equal(same.tare.unloaded_n, entry.unloaded_n)
    gone = other.tare.unloaded_n - np.array(entry.tared_n)
    predict_n = UnloadedTensions(ARM).predict_n
    np.testing.assert_allclose(
        gone, predict_n(np.full(8, 0.01)) - predict_n(np.zeros(8)), atol=1e-9
    )


def parts():
    """A journal with the state that its entries tell, before any tare."""
    command = np.zeros(8)
    gate = MotionGate(command, SETTINGS.joint_speed_rad_s, SETTINGS.settle_s)
    tare = TareModel(UnloadedTensions(ARM).predict_n, command, SETTINGS.tare_samples, 1.0)
    return EstimationJournal(ARM, {"model": "any.onnx"}), (SETTINGS, command, gate, tare)


def test_an_entry_comes_once_and_only_after_a_change():
    journal, state = parts()
    assert journal.next_entry(1, *state) is None
    journal.note(EventKind.SETTINGS)
    assert journal.next_entry(2, *state).before_ns == 2
    assert journal.next_entry(3, *state) is None
    journal.note(EventKind.TARE)
    journal.forget()
    assert journal.next_entry(4, *state) is None


def test_events_are_told_in_order_and_a_start_before_the_first_sample_once():
    journal, state = parts()
    journal.start(np.zeros(8))
    journal.start(np.zeros(8))
    journal.command(np.full(8, 0.01))
    journal.note(EventKind.TARE_UNDO)
    assert journal.next_entry(1, *state).events == (
        Event(EventKind.START, (0.0,) * 8),
        Event(EventKind.COMMAND, (0.01,) * 8),
        Event(EventKind.TARE_UNDO),
    )


def test_an_entry_tells_model_joints_and_settings_as_text():
    journal, state = parts()
    journal.start(np.zeros(8))
    told = journal.next_entry(1, *state).settings
    assert told["model"] == "any.onnx"
    assert told["joints"].split() == list(ARM.joint_names)
    assert told["stale_after_s"] == "0.2"
    assert told["auto_tare"] == "True"


def test_an_entry_tells_the_tare_once_there_is_one():
    journal, state = parts()
    *_, tare = state
    journal.start(np.zeros(8))
    entry = journal.next_entry(1, *state)
    assert (entry.unloaded_n, entry.tared_n, entry.tare_command_rad) == ((), (), ())
    for _ in range(SETTINGS.tare_samples):
        tare.add([100.0] * 12)
    tare.take(0)
    journal.note(EventKind.TARE)
    entry = journal.next_entry(2, *state)
    assert entry.tared_n == entry.unloaded_n == (100.0,) * 12
    assert entry.tare_command_rad == (0.0,) * 8


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"command_rad": (0.0,) * 7}, "7 joint angles; the arm cdsm-.* has 8"),
        ({"lowest_rad": ()}, "0 lowest joint angles"),
        ({"tared_n": (1.0,) * 9, "tare_command_rad": (0.0,) * 8}, "9 tared tensions"),
        ({"tared_n": (1.0,) * 12, "tare_command_rad": ()}, "0 joint angles at the tare"),
    ],
)
def test_an_entry_of_another_arm_is_refused(wrong, said):
    journal, state = parts()
    journal.start(np.zeros(8))
    entry = journal.next_entry(1, *state)
    journal.require_fitting(entry)
    with pytest.raises(ContractError, match=said):
        journal.require_fitting(replace(entry, **wrong))


def test_restoring_from_an_entry_of_another_arm_is_refused():
    live = estimation()
    entry = live.sample(sample(np.full(12, 100.0), EPOCH_NS), EPOCH_NS, 0.0).entry
    with pytest.raises(ContractError, match="7 joint angles"):
        live.restore(replace(entry, command_rad=(0.0,) * 7))
