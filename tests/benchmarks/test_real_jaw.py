"""The torque of a jaw from the drive's signals: refusals of bad folders, planted friction."""

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import real_jaw  # noqa: E402
from real_jaw_baselines import Regression, load_proportional, stops  # noqa: E402
from real_jaw_network import scan  # noqa: E402
from real_jaw_physics import PhysicsEstimator  # noqa: E402
from real_jaw_recordings import (  # noqa: E402
    COLUMNS,
    JawRecordingError,
    read_recordings,
    split,
)

CONSTANT_NM, PROPORTIONAL, GAIN = 0.04, 0.4, 0.9


def write_folder(folder, tools=("a",), levels=(20, 40, 60, 80), seconds=4.0):
    """A rigid transmission with friction of a constant and a load-proportional part."""
    time_s = np.arange(0.0, seconds, 0.01)
    lines = []
    for t, tool in enumerate(tools):
        for level in levels:
            angle = 0.5 - np.abs(time_s % 1.0 - 0.5)  # turns within a sample
            direction = stops(angle, [0.002])[:, 0]
            jaw = 1e-3 * level * (1.0 + 0.2 * angle) * (1.0 + 0.1 * t)
            drive = GAIN * jaw + direction * (CONSTANT_NM + PROPORTIONAL * jaw)
            columns = [time_s, angle, drive, 2.0 * drive, -angle, jaw]
            name = f"{tool}_{level}"
            pd.DataFrame(dict(zip(COLUMNS, columns, strict=True))).to_csv(
                folder / f"{name}.csv.gz", index=False
            )
            lines.append(f"{name},{tool},0.5,{level}")
    index = ["recording,folder,frequency_hz,brake_percent", *lines]
    (folder / "index.csv").write_text("\n".join(index))
    return folder


def rewrite(folder, name, change):
    path = folder / name
    table = pd.read_csv(path)
    change(table).to_csv(path, index=False)


def test_the_planted_friction_is_inverted(tmp_path):
    train, (part,) = split(read_recordings(write_folder(tmp_path)), None, 4)
    estimator = Regression(load_proportional, train)
    for recording, told in zip(part.test, estimator.torques_nm(part.test), strict=True):
        # at first it has not moved
        np.testing.assert_allclose(told[1:], recording.jaw_torque_nm[1:], atol=2e-3)


def test_levels_alternate_and_what_is_tested_is_neither_trained_on_nor_adapted_to(tmp_path):
    recordings = read_recordings(write_folder(tmp_path, ("a", "b"), (10, 20, 30, 40, 50)))
    recordings = [r for r in recordings if r.tool == "a" or r.brake_percent > 10]
    train, (same, other) = split(recordings, None, 2)
    assert [r.name for r in train] == ["a_10", "a_30", "a_50"]
    assert [r.name for r in same.test] == ["a_20", "a_40"]
    assert not same.adapt
    assert len(other.adapt) == len(other.test) == 2
    assert {r.name for r in (*other.adapt, *other.test)} == {r.name for r in recordings[5:]}


def test_tools_of_another_folder_are_adapted_to_unless_they_were_trained_on(tmp_path):
    recordings = read_recordings(write_folder(tmp_path, ("a", "b")))
    train, (known, new) = split(recordings[:3], recordings[3:], 1)
    assert train == recordings[:3]
    assert (known.tool, len(known.adapt), len(known.test)) == ("a", 0, 1)
    assert (new.tool, len(new.adapt), len(new.test)) == ("b", 1, 3)
    with pytest.raises(JawRecordingError, match="4 to adapt to and one to test on"):
        split(recordings[:3], recordings[3:], 4)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("index.csv", lambda t: t.drop(columns="folder"), "no column folder"),
        ("index.csv", lambda t: t[:0], "no recordings"),
        ("index.csv", lambda t: t.assign(recording="gone"), "gone.csv.gz: no such file"),
        ("a_20.csv.gz", lambda t: t.drop(columns="jaw_torque_nm"), "no column jaw_torque_nm"),
        ("a_20.csv.gz", lambda t: t.replace({"time_s": {1.0: 1.3}}), "not evenly spaced"),
        ("a_20.csv.gz", lambda t: t.assign(jaw_torque_nm="much"), "row 1, .*much is no finite"),
        ("a_20.csv.gz", lambda t: t.replace({"time_s": {0.06: np.nan}}), "row 7, column time_s"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path, name, change, message):
    rewrite(write_folder(tmp_path), name, change)
    with pytest.raises(JawRecordingError, match=message) as caught:
        read_recordings(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_table_is_refused(tmp_path):
    (write_folder(tmp_path) / "a_20.csv.gz").write_bytes(b"\x1f\x8b no gzip")
    with pytest.raises(JawRecordingError, match=r"a_20.csv.gz: no table"):
        read_recordings(tmp_path)


@given(angles=st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=30), steps=st.integers(2, 5))
def test_stops_do_not_depend_on_the_speed_and_stay_within_their_radius(angles, steps):
    turning = np.array(angles)
    at = np.arange(0.0, len(turning) - 1 + 1e-9, 1.0 / steps)
    slowly = np.interp(at, np.arange(len(turning)), turning)
    shares = stops(turning)
    assert np.abs(shares).max() <= 1.0 + 1e-9
    np.testing.assert_allclose(stops(slowly)[::steps], shares, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("length", [1, 2, 7, 64])
def test_the_scan_is_the_recursion(length):
    drawn = torch.Generator().manual_seed(length)
    kept, added = torch.rand(2, 3, length, 4, generator=drawn)
    held = torch.zeros(3, 4)
    for t, told in enumerate(scan(kept, added).unbind(1)):
        held = kept[:, t] * held + added[:, t]
        torch.testing.assert_close(told, held)


@pytest.mark.slow
def test_no_answer_depends_on_what_comes_after_or_on_what_the_jaw_measures(tmp_path):
    recordings = read_recordings(write_folder(tmp_path))
    whole = recordings[3]
    begun = replace(
        whole,
        drive_angle_rad=whole.drive_angle_rad[:250],
        drive_torque_nm=whole.drive_torque_nm[:250],
        motor_current_a=whole.motor_current_a[:250],
        jaw_angle_rad=np.zeros(250),
        jaw_torque_nm=np.zeros(250),
    )
    physics = PhysicsEstimator(recordings[:3])
    for name, estimator in real_jaw.trained(recordings[:3], physics, steps=20).items():
        one, other = estimator.torques_nm([whole, begun])
        np.testing.assert_allclose(one[:250], other, atol=1e-5, err_msg=name)


@pytest.mark.slow
def test_the_command_prints_errors_by_recording_and_in_all(tmp_path, monkeypatch, capsys):
    folder = str(write_folder(tmp_path, ("a", "b"), (20, 40, 60)))
    options = ["--train", folder, "--test", folder, "--adapt", "2", "--json"]
    monkeypatch.setattr(real_jaw, "trained", partial(real_jaw.trained, steps=20))
    monkeypatch.setattr(sys, "argv", ["real_jaw.py", *options])
    real_jaw.main()
    estimators = json.loads(capsys.readouterr().out)["estimators"]
    for found in estimators.values():
        assert set(found["tools"]) == {"a", "b"}
        assert set(found["recordings"]) == {"a_40", "b_40"}
        assert found["tools"]["a"] == found["recordings"]["a_40"]
