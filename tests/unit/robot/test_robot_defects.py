"""Every defect of a robot's recording, in CSV and in bags: it is named, or it does no harm."""

from __future__ import annotations

import re
import tracemalloc
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_recording.recording import RecordingError
from tests.helpers.bags import write_joint_states
from tests.helpers.two_link import XML, recorded, write_model

pytestmark = pytest.mark.slow  # loads the message types

MOST_BYTES = 60_000_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("defects")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


@pytest.fixture(scope="module")
def table(folder):
    whole = pd.read_csv(recorded(folder / "recording.csv", trials=3))
    channels = whole.filter(regex="time_s|trial|position|torque")
    return channels.assign(time_s=np.arange(len(channels)) * 0.01)


def as_csv(path, table):
    table.to_csv(path.with_suffix(".csv"), index=False)
    return path.with_suffix(".csv")


def as_bag(path, table):
    return write_joint_states(path.with_suffix(".mcap"), table)


def later(seconds, row=620):
    return lambda t: t.assign(time_s=t.time_s + seconds * (np.arange(len(t)) >= row))


def held(label, first=0, last=None):
    """A channel that stands still in some rows."""

    def change(table):
        values = table[label].to_numpy(copy=True)
        values[first:last] = values[first]
        return table.assign(**{label: values})

    return change


def in_rows(label, rows, value):
    def change(table):
        values = table[label].to_numpy(copy=True)
        values[rows] = value
        return table.assign(**{label: values})

    return change


DEFECTS = {
    "clock set back within a trial": (later(-3.0), "time_s runs back by 2.99 s in row 621", None),
    "clock set back by a day": (later(-86_400.0), "runs back by 86400 s in row 621", None),
    "row twice": (lambda t: pd.concat([t[:300], t[299:]]), "time_s stands still in row 301", None),
    "rows in another order": (lambda t: t[::-1], "time_s runs back", None),
    "one stamp of a later clock": (
        in_rows("time_s", 620, 1.764e9),
        "row 621, of another clock",
        None,
    ),
    "one stamp of an earlier clock": (
        in_rows("time_s", 620, 0.0),
        "row 621, of another clock",
        None,
    ),
    "two clocks by turns": (
        in_rows("time_s", slice(0, None, 2), 5_000.0 + np.arange(600)),
        "time_s",
        None,
    ),
    "paused for a quarter of a second": (later(0.25), None, "a break of 0.26 s before row 621"),
    "paused for a minute": (later(60.0), None, "a break of 60 s before row 621"),
    "clock set by years": (later(1.7e9), None, r"a break of 1\.7e\+09 s before row 621"),
    "time in bursts": (
        lambda t: t.assign(
            time_s=0.1 * (np.arange(len(t)) // 10) + 1e-6 * (np.arange(len(t)) % 10)
        ),
        "comes in bursts",
        None,
    ),
    "torque 0": (
        in_rows("torque.elbow", slice(None), 0.0),
        None,
        "torque.elbow is 0 in every row, whatever moves",
    ),
    "torque constant": (
        in_rows("torque.elbow", slice(None), 0.37),
        None,
        "torque.elbow is 0.37 in every row, whatever moves",
    ),
    "torque dies": (held("torque.elbow", 700), "torque.elbow is .* in rows 701 to 1200", None),
    "torque dies late": (
        held("torque.elbow", 980),
        None,
        "torque.elbow is .* in rows 981 to 1200",
    ),
    "torque begins late": (held("torque.elbow", 0, 500), "in rows 1 to 500, while its", None),
    "position constant": (
        held("position.elbow"),
        None,
        "position.elbow is .* in every row, while position.shoulder changes",
    ),
    "position dies": (
        held("position.elbow", 600),
        None,
        "position.elbow is .* in rows 601 to 1200",
    ),
    "encoder fails now and then": (
        in_rows("position.elbow", slice(20, None, 90), -3.0),
        "position.elbow leaps away and back in rows 21, 111",
        None,
    ),
    "encoder fails once": (
        in_rows("position.elbow", 555, -3.0),
        None,
        "position.elbow leaps away and back in row 556",
    ),
    "encoder is set anew": (
        lambda t: t.assign(
            **{"position.elbow": t["position.elbow"] + 0.8 * (np.arange(len(t)) >= 620)}
        ),
        None,
        "position.elbow leaps by 0.8.* before row 621",
    ),
    "torque missing in some rows": (
        in_rows("torque.elbow", slice(600, 640), np.nan),
        "row 601 and 39 more, column torque.elbow: empty",
        None,
    ),
    "torque missing at first": (
        in_rows("torque.elbow", slice(0, 100), np.nan),
        None,
        "The first 100 of 1200 rows are left out",
    ),
    "torque missing at last": (
        in_rows("torque.elbow", slice(1100, None), np.nan),
        None,
        "The last 100 of 1200 rows are left out",
    ),
    "position missing in some rows": (
        in_rows("position.elbow", slice(600, 640), np.nan),
        "row 601 and 39 more, column position.elbow: empty",
        None,
    ),
    "a trial that comes back": (
        in_rows("trial", slice(800, None), 0),
        None,
        "Trial 0 comes back after another one",
    ),
    "milliseconds": (lambda t: t.assign(time_s=1e3 * t.time_s), "milliseconds given", None),
    "degrees": (
        lambda t: t.assign(**{"position.elbow": 60.0 * t["position.elbow"]}),
        "degrees given",
        None,
    ),
    "none": (lambda t: t, None, "Trials by"),
}


@contextmanager
def traced(*, wanted):
    """Gives a list that has the peak of memory at the end; tracing takes longer than reading."""
    peak_bytes = []
    if not wanted:
        yield peak_bytes
        return
    tracemalloc.start()
    try:
        yield peak_bytes
        peak_bytes.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("write", [as_csv, as_bag])
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_named_and_a_leap_of_time_takes_no_memory(
    tmp_path, table, robot, defect, write
):
    change, refused, noted = DEFECTS[defect]
    path = write(tmp_path / "run", change(table))
    if refused is not None:
        with pytest.raises(RecordingError, match=refused) as said:
            read_robot_recording(path, robot)
        assert "\n" not in str(said.value)
        return
    with traced(wanted="a break of" in noted) as peak_bytes:
        recording = read_robot_recording(path, robot)
        motion = prepared(recording, robot)
    said = (*recording.notes, *recording.warnings)
    assert any(re.search(noted, each) for each in said)
    assert all(each < MOST_BYTES for each in peak_bytes)
    assert sum(len(each.time_s) for each in motion.trials) <= 1.1 * len(recording)


@pytest.mark.parametrize("seconds", [0.25, 7.0, 1.7e9])
def test_nothing_is_interpolated_at_a_break(tmp_path, table, robot, seconds):
    whole = read_robot_recording(as_csv(tmp_path / "whole", table), robot)
    leapt = read_robot_recording(as_csv(tmp_path / "leapt", later(seconds)(table)), robot)
    assert len(leapt) == len(whole)
    assert leapt.trial[619] != leapt.trial[620]


def test_a_dead_channel_is_used_if_the_user_insists(tmp_path, table, robot):
    path = as_csv(tmp_path / "dead", held("torque.elbow", 700)(table))
    with pytest.raises(RecordingError, match="or continue with --force"):
        read_robot_recording(path, robot)
    warnings = read_robot_recording(path, robot, force=True).warnings
    assert any("torque.elbow is" in warning for warning in warnings)


def test_a_constant_torque_is_not_compared(tmp_path, table, robot):
    path = as_csv(tmp_path / "dead", in_rows("torque.elbow", slice(None), 0.37)(table))
    recording = read_robot_recording(path, robot)
    assert np.isnan(recording.torque[:, 1]).all()
    assert np.isfinite(recording.torque[:, 0]).all()


def test_a_joint_without_a_drive_has_no_torque_rightly(tmp_path, table):
    model = tmp_path / "passive.xml"
    model.write_text(XML.replace('<motor name="elbow" joint="elbow"/>', ""))
    path = as_csv(tmp_path / "passive", in_rows("torque.elbow", slice(None), 0.0)(table))
    recording = read_robot_recording(path, load_robot(model))
    assert (recording.torque[:, 1] == 0.0).all()
    assert not any("torque" in warning for warning in recording.warnings)


@pytest.mark.parametrize("labels", [("shoulder",), ("shoulder", "elbow")])
def test_drives_that_hold_a_torque_at_rest_are_well(tmp_path, table, robot, labels):
    """A brake holds a joint that rests, and its torque may stand still for long."""
    resting = table.copy()
    for label in labels:
        for kind in ("position", "torque"):
            resting = held(f"{kind}.{label}", 400, 800)(resting)
    recording = read_robot_recording(as_csv(tmp_path / "rest", resting), robot)
    assert not any("torque" in warning for warning in recording.warnings)
