"""What an estimator's answers rest on survives it in a file; what does not fit is refused."""

import json
import os

import pytest

from cablesense_msgs_py.journal import JournalEntry
from cablesense_online.journal import StateFile, StateFileError

ENTRY = JournalEntry(
    before_ns=7,
    events=(),
    arm="cdsm-1",
    settings={},
    command_rad=(0.1, 0.2),
    lowest_rad=(0.0, 0.0),
    highest_rad=(0.1, 0.2),
    rest_from_ns=-(2**62),
    unloaded_n=(40.0, 1 / 3),
    tared_n=(41.0, 1e-300),
    tare_command_rad=(0.0, -0.0),
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state.json"


def written(path, entry=ENTRY):
    state = StateFile(path, 60.0)
    state.keep(entry)
    state.flush()
    return state


def test_a_state_reads_back_to_the_last_bit(path):
    written(path)
    assert StateFile(path, 60.0).read("cdsm-1") == ENTRY
    assert [one.name for one in path.parent.iterdir()] == ["state.json"]


def test_nothing_is_kept_without_a_path_nor_read_without_a_file(path):
    state = written("")
    assert state.read("cdsm-1") is None
    assert StateFile(path, 60.0).read("cdsm-1") is None


def test_a_state_of_long_ago_is_refused(path):
    written(path)
    os.utime(path, (1e9, 1e9))
    with pytest.raises(StateFileError, match="was last alive"):
        StateFile(path, 60.0).read("cdsm-1")


def test_signs_of_life_renew_the_file_once_a_second(path):
    state = written(path)
    os.utime(path, (1e9, 1e9))
    state.flush()
    assert path.stat().st_mtime == 1e9
    now_s = path.stat().st_ctime + 5.0
    state = StateFile(path, 1e12, lambda: now_s)
    state.read("cdsm-1")
    state.flush()
    assert path.stat().st_mtime > 1e9
    StateFile(path, 60.0).read("cdsm-1")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"arm": "other-2"}, "is of arm 'other-2'; "),
        ({"arm": "\n" * 5000}, r"is of arm '(\\n){80}'; "),
        ({"tared_n": []}, "no tare"),
        ({"format": "something"}, "no state of an estimator"),
        ({"command_rad": [float("nan")]}, "no state of an estimator"),
        ({"unloaded_n": "1 2"}, "no state of an estimator"),
        ({"rest_from_ns": 0.5}, "no state of an estimator"),
        ({"tared_n": [0.0] * 5000}, "no state of an estimator"),
        ({"tared_n": [10**400]}, "no state of an estimator"),
        ({"unloaded_n": [True, 2.0]}, "no state of an estimator"),
    ],
)
def test_what_does_not_fit_is_refused(path, change, said):
    written(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(StateFileError, match=said):
        StateFile(path, 60.0).read("cdsm-1")


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, "x" * 300_000])
def test_a_broken_file_is_refused(path, text):
    path.write_text(text)
    with pytest.raises(StateFileError, match="state"):
        StateFile(path, 60.0).read("cdsm-1")


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(StateFileError, match="cannot be written"):
        written(tmp_path / "no folder" / "state.json")
