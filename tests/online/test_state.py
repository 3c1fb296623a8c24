"""A state goes through its message and its file bit for bit; an impossible one is refused."""

import json
import os
import resource
from contextlib import contextmanager

import numpy as np
import pytest
from estimation_settings import estimation_settings

from cablesense_msgs_py.messages import Level
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import (
    EstimatorState,
    Event,
    EventKind,
    GateState,
    Tare,
    TareState,
    put_state,
    state_of,
)
from cablesense_online.state_file import StateFile, StateFileError
from cablesense_sim.arm import open_arm

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg")
serialization = pytest.importorskip("rclpy.serialization")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

SETTINGS = estimation_settings(tare_samples=4, joint_speed_rad_s=1 / 3, settle_s=0.05)
STRAIGHT = (0.0,) * 8
GATE = GateState(command_rad=(0.1, *STRAIGHT[1:]), pose_rad=STRAIGHT, rest_from_ns=-(2**62))
TARE = Tare(
    measured_n=(41.0, 1e-300, *[40.0] * 10),
    predicted_n=(40.0, 1 / 3, *[40.0] * 10),
    command_rad=(0.0, -0.0, *STRAIGHT[2:]),
    sample_count=4,
    taken_ns=10**18,
)
STATE = EstimatorState(
    before_ns=7,
    arm="cdsm-1",
    settings=SETTINGS,
    origin={"model": "any.onnx"},
    gate=GATE,
    tare=TareState(tare=TARE, predicted_n=TARE.predicted_n),
)


def same(one, other):
    """As JSON has them, which distinguishes 0.0 from -0.0."""
    return one.model_dump_json() == other.model_dump_json()


def changed(**parts):
    """`STATE` with other fields in its parts."""
    update = {
        name: getattr(STATE, name).model_copy(update=fields) for name, fields in parts.items()
    }
    return STATE.model_copy(update=update)


def message_of(state):
    message = diagnostic_msgs.DiagnosticArray()
    put_state(message, state, diagnostic_msgs.DiagnosticStatus, diagnostic_msgs.KeyValue)
    return message


def test_a_message_reads_back_bit_for_bit():
    numbers = np.array([0.1, -0.0, 1 / 3, 1e-300, 5e-324, -1e8, 2.0**29, 0.0])
    state = changed(
        gate={"pose_rad": numbers, "course": numbers},
        misfit={"withheld_until_ns": 2**62, "misfit_since_ns": -(2**62)},
        breath={"turn": 3, "mark_ns": 2**62, "offset_n": numbers},
    ).model_copy(
        update={
            "before_ns": 2**31 * 10**9 - 1,
            "events": (Event(EventKind.MISFIT), Event(EventKind.COMMAND, (0.1, -0.0))),
            "origin": {"model": 'a "b"\n\u00e9\U0001f916'},
            "command_received": True,
        }
    )
    raw = serialization.serialize_message(message_of(state))
    message = serialization.deserialize_message(raw, diagnostic_msgs.DiagnosticArray)
    assert same(state_of(message), state)


@pytest.mark.parametrize(
    ("field", "text", "problem"),
    [
        ("gate", None, "gate is missing"),
        ("gate", "{", "gate: is no JSON"),
        ("gate", '{"command_rad": ["one", 2]}', r"command_rad.0 = 'one': must be a number"),
        ("gate", '{"command_rad": [Infinity]}', "command_rad.0 = inf"),
        ("gate", '{"command_rad": "1 2"}', "command_rad = '1 2': must be a list"),
        ("before_ns", "0.5", "before_ns = 0.5: must be a whole number"),
        ("events", '[{"kind": "dance"}]', "'dance'.*'tare undone'"),
        ("settings", "{}", "settings.contact_threshold is missing"),
        ("tare", '{"predicted_n": [1e12]}', "tare.predicted_n.0 = 1000000000000"),
    ],
)
def test_a_message_that_is_no_state_is_refused_in_one_line(field, text, problem):
    message = message_of(STATE)
    (status,) = message.status
    if text is None:
        status.values = [value for value in status.values if value.key != field]
    for value in status.values:
        if value.key == field:
            value.value = text
    with pytest.raises(ContractError, match=problem) as caught:
        state_of(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("parts", "problem"),
    [
        ({"gate": {"command_rad": np.zeros(7)}}, "command_rad has 7 numbers; the arm cdsm-.* 8"),
        ({"gate": {"pose_rad": np.array([0.0] * 7 + [1e6])}}, "a joint at 1e"),
        ({"gate": {"course": np.zeros(9)}}, "gate.course has 9"),
        ({"tare": {"tare": TARE.model_copy(update={"command_rad": np.zeros(0)})}}, "has 0"),
        ({"breath": {"offset_n": np.ones(1)}}, "breath.offset_n has 1"),
    ],
)
def test_a_state_of_another_arm_does_not_fit(parts, problem):
    STATE.require_fitting(open_arm("cdsm"))
    with pytest.raises(ContractError, match=problem):
        changed(**parts).require_fitting(open_arm("cdsm"))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state.json"


def written(path, state=STATE):
    file = StateFile(path, 60.0)
    file.keep(state)
    file.flush()
    return file


def test_a_file_reads_back_to_the_last_bit_without_the_events(path):
    written(path, STATE.model_copy(update={"events": (Event(EventKind.TARE),)}))
    assert same(StateFile(path, 60.0).read("cdsm-1"), STATE)
    assert written("").read("cdsm-1") is None
    assert [one.name for one in path.parent.iterdir()] == ["state.json"]


def test_a_living_estimator_renews_the_file_once_a_second(path):
    file = written(path)
    os.utime(path, (1e9, 1e9))
    with pytest.raises(StateFileError, match="was last alive"):
        StateFile(path, 60.0).read("cdsm-1")
    file.flush()
    assert path.stat().st_mtime == 1e9
    now_s = path.stat().st_ctime + 5.0
    file = StateFile(path, 1e12, lambda: now_s)
    file.read("cdsm-1")
    file.flush()
    assert path.stat().st_mtime > 1e9


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"arm": "other-2"}, "is of arm 'other-2'; "),
        ({"tare": {"predicted_n": []}}, "no tare"),
        ({"format": "something"}, "no state of an estimator"),
        ({"tare": {"predicted_n": [0.0] * 5000}}, "no state of an estimator: tare.predicted_n"),
        ({"settings": None}, "no state of an estimator: settings"),
    ],
)
def test_a_file_with_an_impossible_value_is_refused(path, change, problem):
    written(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(StateFileError, match=problem) as caught:
        StateFile(path, 60.0).read("cdsm-1")
    assert "\n" not in str(caught.value)


@contextmanager
def full_disk():
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_no_earlier_state_and_is_an_error_until_there_is_room(path):
    now_s = 1e9
    file = StateFile(path, 60.0, lambda: now_s)
    file.keep(STATE)
    file.flush()
    assert file.status().level is Level.OK
    latest = changed(gate={"command_rad": np.full(8, 0.3)})
    file.keep(latest)
    with full_disk(), pytest.raises(StateFileError, match="cannot be written"):
        file.flush()
    assert StateFile(path, 60.0).read("cdsm-1") is None
    assert list(path.parent.iterdir()) == []
    assert file.status().level is Level.ERROR
    file.flush()  # it is not tried at every sample
    assert not path.exists()
    now_s += 1.0
    file.flush()
    assert file.status().level is Level.OK
    assert same(StateFile(path, 1e12).read("cdsm-1"), latest)


def test_a_file_that_is_no_state_is_not_removed(path):
    """Nor is one that could not be continued from."""
    path.write_text("mine")
    file = StateFile(path, 60.0)
    with pytest.raises(StateFileError):
        file.read("cdsm-1")
    file.keep(STATE)
    with full_disk(), pytest.raises(StateFileError):
        file.flush()
    assert path.read_text() == "mine"
