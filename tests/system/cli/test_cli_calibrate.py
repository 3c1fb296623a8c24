"""The verb `calibrate`, and `info` of its file: from a recording of an arm of the other plant."""

import json
from pathlib import Path

import numpy as np
import pytest

from cablesense_base.installation import config_path
from cablesense_contact.calibration import Calibrator
from cablesense_contact.calibration_file import read_calibration, write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.unloaded_holds import unloaded_holds
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_recording.csv_file import write_csv
from cablesense_recording.recording import Recording
from cablesense_sim.arm import open_arm

LAB = Path(config_path("arms/cdsm_lab.yaml"))
ARM = open_arm(LAB)
RATE_HZ = ARM.sensors.rate_hz
STAY = 20


def stays(count, errors=1.0, seed=4, *, touched=(), labelled=True):
    """A recording of an unloaded arm in some poses; in the `touched` ones something acts on it."""
    rng = np.random.default_rng(seed)
    built = BuiltArm(read_nominal(LAB), Workmanship().scaled(errors), rng)
    poses = np.deg2rad(rng.uniform(-10.0, 10.0, (count, 8)))
    pushes = [
        (Push(2, 0.065, np.array([0.0, 0.0, 30.0])),) if number in touched else ()
        for number in range(count)
    ]
    tensions = built.rests(poses, pushes).tensions_n
    rows = count * STAY
    pushed = np.repeat([bool(each) for each in pushes], STAY) & labelled
    return Recording(
        name="poses",
        time_s=np.arange(rows) / RATE_HZ,
        trial=np.repeat(np.arange(count), STAY),
        command_rad=np.repeat(poses, STAY, axis=0),
        load_segment=np.where(pushed, 2, 0),
        load_n=np.outer(pushed, [0.0, 0.0, 30.0]),
        tensions_n=built.read(np.repeat(tensions, STAY, axis=0), rng),
    )


@pytest.fixture
def calibrated(command, tmp_path):
    """A calibration file of an arm that is built well, and what the verb printed."""
    write_csv(tmp_path / "poses.csv", stays(12))
    ended = command(
        "calibrate",
        "poses.csv",
        "--arm",
        LAB,
        "--out",
        "lab.calibration",
        "--json",
        "--ended",
        "2026-03-01T10:00:00",
    )
    assert ended.returncode == 0, ended.stderr
    return tmp_path / "lab.calibration", json.loads(ended.stdout)


@pytest.mark.slow
def test_poses_of_a_recording_become_a_calibration(calibrated):
    file, content = calibrated
    assert content["poses"] == content["unloaded_readings"] == 12
    assert content["as_described"]
    assert content["probability"] > 0.01
    assert content["channels"] == 12 * 12
    assert content["taken"] == "2026-03-01T10:00:00+00:00"
    assert content["force_known_n"]["after"] < content["force_known_n"]["before"]
    kinds = {row["kind"]: row for row in content["parameters"]}
    assert "carried_friction" not in kinds
    assert kinds["sensor_zero"]["count"] == 12
    assert kinds["sensor_zero"]["std"] < kinds["sensor_zero"]["tolerance"] == 0.5
    assert kinds["hole_outward"]["count"] == 12 + 12 + 9 + 6 + 3
    calibration = read_calibration(file, FeltArm(ARM))
    assert len(calibration.unloaded) == 12
    assert calibration.made_from == "poses, with unloaded readings in 12 poses"


@pytest.mark.slow
def test_info_shows_a_calibration_file_as_calibrate_does(calibrated, command):
    _, content = calibrated
    shown = command("info", "lab.calibration", "--json")
    assert shown.returncode == 0, shown.stderr
    assert json.loads(shown.stdout) == content
    text = command("info", "lab.calibration").stdout
    assert "with unloaded readings in 12 poses" in text
    assert "cable stiffness" in text
    assert "as its file's tolerances describe it" in text
    assert "push of 20 N is known to" in text


@pytest.mark.slow
def test_a_touched_arm_that_no_label_tells_of_is_not_as_described(command, tmp_path):
    write_csv(tmp_path / "poses.csv", stays(10, touched=(3, 7), labelled=False))
    ended = command("calibrate", "poses.csv", "--arm", LAB, "--out", "lab.calibration")
    assert ended.returncode == 0, ended.stderr
    assert "It is not as its file's tolerances describe it" in ended.stdout


def test_loaded_rows_are_left_out_and_so_are_moves():
    recording = stays(5, touched=(2,))
    holds = unloaded_holds(recording)
    assert len(holds) == 4
    first, second = holds[:2]
    assert first.count == STAY  # nothing was before
    assert second.count == STAY - round(RATE_HZ)
    assert first.taken_ns == 0
    np.testing.assert_allclose(
        second.reading_n, recording.tensions_n[STAY + round(RATE_HZ) : 2 * STAY].mean(axis=0)
    )
    timed = unloaded_holds(recording, ended_ns=10**18)
    assert timed[-1].taken_ns == 10**18
    assert timed[0].taken_ns == 10**18 - round(1e9 * 4 * STAY / RATE_HZ)


@pytest.mark.slow
def test_what_cannot_be_used_is_refused_in_one_line(command, tmp_path):
    write_csv(tmp_path / "short.csv", stays(8).rows(np.arange(0, 160, 11)))
    write_csv(tmp_path / "poses.csv", stays(3))
    for arguments, reason in (
        (("short.csv", "--arm", LAB, "--out", "a"), "never rests unloaded"),
        (("none.csv", "--arm", LAB, "--out", "a"), "none.csv"),
        (("poses.csv", "--arm", "no_arm", "--out", "a"), "no_arm"),
        (("poses.csv", "--arm", LAB, "--out", "poses.csv", "--force"), "is an input"),
        (("poses.csv", "--arm", LAB, "--out", "a", "--model", "none.onnx"), "no model file"),
    ):
        ended = command("calibrate", *arguments)
        assert ended.returncode == 2, arguments
        assert reason in ended.stderr
        assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_info_needs_the_description_of_the_arm_in_the_file(command, tmp_path):
    calibration = Calibrator(FeltArm(ARM), law=None).by_tolerances()
    write_calibration(tmp_path / "bare.calibration", calibration)
    ended = command("info", "bare.calibration")
    assert ended.returncode == 2
    assert "holds no description of its arm" in ended.stderr
