"""A state goes through its message and its file bit for bit; what cannot be is refused."""

import json
import math
import os
import resource
from contextlib import contextmanager

import pytest
from estimation_settings import estimation_settings
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.messages import Level
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import (
    BreathState,
    EstimationSettings,
    EstimatorState,
    Event,
    EventKind,
    put_state,
    state_of,
)
from cablesense_online.state_file import StateFile, StateFileError
from cablesense_sim.arm import open_arm

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg")
serialization = pytest.importorskip("rclpy.serialization")
pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

SETTINGS = estimation_settings(tare_samples=4, joint_speed_rad_s=1 / 3, settle_s=0.05)
STATE = EstimatorState(
    before_ns=7,
    arm="cdsm-1",
    settings=SETTINGS,
    origin={"model": "any.onnx"},
    command_rad=(0.1, 0.2),
    lowest_rad=(0.0, 0.0),
    highest_rad=(0.1, 0.2),
    rest_from_ns=-(2**62),
    unloaded_n=(40.0, 1 / 3),
    tared_n=(41.0, 1e-300),
    tare_command_rad=(0.0, -0.0),
)

NUMBERS = st.lists(st.floats(-1e8, 1e8), max_size=12).map(tuple)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
AMOUNTS = st.floats(0.0, 1e8)
STATES = st.builds(
    EstimatorState,
    before_ns=st.integers(0, 2**31 * 10**9 - 1),
    events=st.lists(st.builds(Event, st.sampled_from(EventKind), NUMBERS), max_size=4).map(tuple),
    arm=TEXTS,
    settings=st.builds(
        EstimationSettings,
        contact_threshold=AMOUNTS,
        stale_after_s=AMOUNTS,
        slack_below_n=AMOUNTS,
        tare_samples=st.integers(1, 10_000),
        tare_steady_n=AMOUNTS,
        auto_tare=st.booleans(),
        joint_speed_rad_s=st.floats(1e-3, 10.0),
        settle_s=AMOUNTS,
        largest_misfit=AMOUNTS,
    ),
    origin=st.dictionaries(TEXTS, TEXTS, max_size=5),
    command_rad=NUMBERS,
    lowest_rad=NUMBERS,
    highest_rad=NUMBERS,
    rest_from_ns=st.integers(-(2**62), 2**62),
    unloaded_n=NUMBERS,
    tared_n=NUMBERS,
    tare_command_rad=NUMBERS,
    pose_assumed=st.booleans(),
    breath=st.builds(
        BreathState,
        turn=st.integers(-1, 9),
        mark_ns=st.integers(0, 2**62),
        sum_log_n_s=NUMBERS,
        offset_n=NUMBERS,
    ),
    withheld_until_ns=st.integers(-(2**62), 2**62),
    misfit_since_ns=st.integers(-(2**62), 2**62),
)


def message_of(state):
    message = diagnostic_msgs.DiagnosticArray()
    put_state(message, state, diagnostic_msgs.DiagnosticStatus, diagnostic_msgs.KeyValue)
    return message


@pytest.mark.slow
@given(STATES)
def test_a_message_reads_back_bit_for_bit(state):
    raw = serialization.serialize_message(message_of(state))
    got = state_of(serialization.deserialize_message(raw, diagnostic_msgs.DiagnosticArray))
    assert repr(got) == repr(state)  # which distinguishes 0.0 from -0.0


def test_a_journal_from_before_misfits_is_read_as_one_without_a_check():
    checked = SETTINGS.model_copy(update={"largest_misfit": 2.3})
    message = message_of(STATE.model_copy(update={"settings": checked, "withheld_until_ns": 5}))
    message.status = [status for status in message.status if status.name != "misfit"]
    for status in message.status:
        later = ("largest_misfit", "pose assumed")
        status.values = [value for value in status.values if value.key not in later]
    assert state_of(message) == STATE


def changed(part, key=None, **values):
    message = message_of(STATE.model_copy(update={"events": (Event(EventKind.TARE),)}))
    for status in message.status:
        if status.name == part:
            for value in status.values:
                if key in (None, value.key):
                    value.value = values.get("value", value.value)
            status.name = values.get("name", part)
    return message


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (changed("motion", name="other"), "no motion"),
        (changed("motion", value="one 2"), r"command_rad.0 = 'one': must be a number"),
        (changed("motion", value=repr(math.inf)), "command_rad.0 = 'inf'"),
        (changed("motion", "at rest from stamp (ns)", value="0.5"), "rest_from_ns = '0.5'"),
        (changed("event: tare on request", name="event: dance"), "'dance'.*'tare undone'"),
        (changed("settings", "settle_s", value="soon"), "settings.settle_s = 'soon'"),
        (changed("settings", "settle_s", value="inf"), "settle_s = 'inf': must be a finite"),
        (changed("settings", "tare_samples", value="0"), "tare_samples = '0'"),
        (changed("settings", "joint_speed_rad_s", value="0.0"), "joint_speed_rad_s = '0.0'"),
    ],
)
def test_a_message_that_is_no_state_is_refused_in_one_line(message, problem):
    with pytest.raises(ContractError, match=problem) as caught:
        state_of(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({"command_rad": (0.0,) * 7}, "7 joint angles; the arm cdsm-.* has 8"),
        ({"lowest_rad": ()}, "0 lowest joint angles"),
        ({"highest_rad": (0.0,) * 7 + (1e6,)}, "a joint at 1e"),
        ({"tared_n": (1.0,) * 9, "tare_command_rad": (0.0,) * 8}, "9 tared tensions"),
        ({"tared_n": (1.0,) * 12, "tare_command_rad": ()}, "0 joint angles at the tare"),
    ],
)
def test_a_state_of_another_arm_does_not_fit(wrong, problem):
    straight = (0.0,) * 8
    fitting = {"command_rad": straight, "lowest_rad": straight, "highest_rad": straight}
    state = STATE.model_copy(update={**fitting, "tared_n": (), "unloaded_n": (1.0,) * 12, **wrong})
    with pytest.raises(ContractError, match=problem):
        state.require_fitting(open_arm("cdsm"))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state.json"


def written(path, state=STATE):
    file = StateFile(path, 60.0)
    file.keep(state)
    file.flush()
    return file


def test_a_file_reads_back_to_the_last_bit(path):
    written(path, STATE.model_copy(update={"events": (Event(EventKind.TARE),)}))
    assert repr(StateFile(path, 60.0).read("cdsm-1")) == repr(STATE)
    assert [one.name for one in path.parent.iterdir()] == ["state.json"]


def test_a_file_has_the_keys_and_the_text_of_its_format(path):
    """As earlier versions wrote and read it: a flat mapping of text for settings and model."""
    written(path)
    values = json.loads(path.read_text())
    assert values["format"] == "cablesense estimator state 1"
    assert values["settings"]["model"] == "any.onnx"
    assert values["settings"]["joint_speed_rad_s"] == "0.3333333333333333"
    assert values["settings"]["auto_tare"] == "True"
    assert values["tared_n"] == [41.0, 1e-300]


def test_nothing_is_kept_without_a_path_nor_read_without_a_file(path):
    assert written("").read("cdsm-1") is None
    assert StateFile(path, 60.0).read("cdsm-1") is None


def test_a_path_that_cannot_be_looked_at_is_refused(tmp_path):
    with pytest.raises(StateFileError, match="cannot be read"):
        StateFile(tmp_path / (300 * "x"), 60.0).read("cdsm-1")


def test_a_file_of_long_ago_is_refused(path):
    written(path)
    os.utime(path, (1e9, 1e9))
    with pytest.raises(StateFileError, match="was last alive"):
        StateFile(path, 60.0).read("cdsm-1")


def test_a_living_estimator_renews_the_file_once_a_second(path):
    file = written(path)
    os.utime(path, (1e9, 1e9))
    file.flush()
    assert path.stat().st_mtime == 1e9
    now_s = path.stat().st_ctime + 5.0
    file = StateFile(path, 1e12, lambda: now_s)
    file.read("cdsm-1")
    file.flush()
    assert path.stat().st_mtime > 1e9
    StateFile(path, 60.0).read("cdsm-1")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"arm": "other-2"}, "is of arm 'other-2'; "),
        ({"arm": "\n" * 5000}, r"is of arm '(\\n){80}'; "),
        ({"tared_n": []}, "no tare"),
        ({"format": "something"}, "no state of an estimator"),
        ({"command_rad": [float("nan")]}, "no state of an estimator: command_rad"),
        ({"unloaded_n": "1 2"}, "unloaded_n = '1 2': must be a list"),
        ({"rest_from_ns": 0.5}, "rest_from_ns = 0.5: must be a whole number"),
        ({"rest_from_ns": True}, "must be a number"),
        ({"tared_n": [0.0] * 5000}, "no state of an estimator"),
        ({"tared_n": [10**400]}, "no state of an estimator"),
        ({"tared_n": [1e12]}, "no state of an estimator"),
        ({"unloaded_n": [True, 2.0]}, "no state of an estimator"),
        ({"settings": None}, "no state of an estimator: settings"),
    ],
)
def test_a_file_with_a_value_that_cannot_be_is_refused(path, change, problem):
    written(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(StateFileError, match=problem) as caught:
        StateFile(path, 60.0).read("cdsm-1")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, "x" * 300_000])
def test_a_broken_file_is_refused(path, text):
    path.write_text(text)
    with pytest.raises(StateFileError, match="state"):
        StateFile(path, 60.0).read("cdsm-1")


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(StateFileError, match="cannot be written"):
        written(tmp_path / "no folder" / "state.json")


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
    file.keep(STATE.model_copy(update={"command_rad": (0.3, 0.3)}))
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
    assert StateFile(path, 1e12).read("cdsm-1").command_rad == (0.3, 0.3)


def test_a_file_that_is_removed_is_written_again(path):
    now_s = 1e9
    file = StateFile(path, 60.0, lambda: now_s)
    file.keep(STATE)
    file.flush()
    path.unlink()
    now_s += 1.0
    with pytest.raises(StateFileError, match="No such file"):
        file.flush()
    now_s += 1.0
    file.flush()
    assert path.exists()


def test_what_is_no_state_is_not_removed(path):
    """Nor is one that could not be continued from."""
    path.write_text("mine")
    file = StateFile(path, 60.0)
    with pytest.raises(StateFileError):
        file.read("cdsm-1")
    file.keep(STATE)
    with full_disk(), pytest.raises(StateFileError):
        file.flush()
    assert path.read_text() == "mine"


def test_without_a_path_there_is_no_status():
    assert StateFile("", 60.0).status() is None
