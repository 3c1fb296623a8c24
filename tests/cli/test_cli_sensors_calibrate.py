"""`sensors calibrate`: a table of loads becomes the file that the driver reads."""

import json

import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE
from typer.testing import CliRunner

from cablesense_base.errors import CableSenseError
from cablesense_cli.app import app
from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.recording import Recording
from cablesense_online.can.calibration import calibrated, load_calibration
from cablesense_sim.arm import open_arm

SCALE, ZERO = 0.125, 40.0
MASSES_KG = (0.0, 2.0, 4.0, 8.0, 4.0, 2.0, 0.0)


def run(*arguments):
    return CliRunner().invoke(app, ["sensors", "calibrate", *map(str, arguments)])


@pytest.fixture
def loads(tmp_path):
    lines = ["cable,mass_kg,raw"]
    for cable in ("cable_1", "cable_2"):
        lines += [f"{cable},{m},{ZERO + m * 9.81 / SCALE:.6f}" for m in MASSES_KG]
    path = tmp_path / "loads.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_the_file_is_one_that_the_driver_takes(loads, tmp_path):
    out = tmp_path / "calibration.yaml"
    result = run(loads, "--out", out, "--gravity", "9.81")
    assert result.exit_code == 0, result.output
    assert "Not calibrated: cable_3" in result.output
    calibration = load_calibration(out)
    channels = calibrated(PACKED, PACKED_DATABASE, calibration, "c").channels
    assert channels["cable_2"].scale_n_per_unit == pytest.approx(SCALE, rel=1e-6)
    assert channels["cable_2"].zero == pytest.approx(ZERO, rel=1e-6)
    assert channels["cable_12"] == PACKED.channels["cable_12"]
    assert calibration.gravity_m_s2 == 9.81


def test_unknown_gravity_makes_the_scale_less_sure(loads, tmp_path):
    result = run(loads, "--out", tmp_path / "c.yaml", "--json")
    sensor = json.loads(result.stdout)["cables"]["cable_1"]
    assert sensor["scale_u95_n_per_unit"] / sensor["scale_n_per_unit"] == pytest.approx(
        0.003, rel=0.05
    )


def test_no_calibration_is_written_over(loads, tmp_path):
    out = tmp_path / "c.yaml"
    out.write_text("mine", encoding="utf-8")
    result = run(loads, "--out", out)
    assert isinstance(result.exception, CableSenseError)
    assert out.read_text(encoding="utf-8") == "mine"


def test_too_few_loads_leave_no_file(loads, tmp_path):
    text = loads.read_text(encoding="utf-8").splitlines()
    loads.write_text("\n".join(text[:4]), encoding="utf-8")
    result = run(loads, "--out", tmp_path / "c.yaml")
    assert "at least 5" in str(result.exception)
    assert not (tmp_path / "c.yaml").exists()


def test_windows_of_a_recording_give_the_same_whatever_was_in_force(loads, tmp_path):
    in_force = tmp_path / "in_force.yaml"
    assert run(loads, "--out", in_force, "--gravity", "9.81").exit_code == 0
    arm = open_arm("cdsm")
    time_s = np.arange(0.0, 10.0 * len(MASSES_KG), 0.1)
    step = (time_s // 10.0).astype(int)
    raw = 75.0 + np.array(MASSES_KG)[step] * 9.81 / 0.5  # of a sensor that was exchanged since
    tensions_n = np.full((len(time_s), 12), 50.0)
    tensions_n[:, 1] = SCALE * (raw - ZERO)
    rows = len(time_s)
    write_csv(
        tmp_path / "run.csv",
        Recording(
            "run",
            time_s,
            np.zeros(rows, dtype=np.int64),
            np.zeros((rows, arm.joint_count)),
            np.zeros(rows, dtype=np.int64),
            np.zeros((rows, 3)),
            tensions_n,
        ),
    )
    lines = [f"cable_2,{mass},{10 * n + 2},{10 * n + 9}" for n, mass in enumerate(MASSES_KG)]
    loads.write_text("\n".join(["cable,mass_kg,start_s,end_s", *lines]), encoding="utf-8")
    out = tmp_path / "anew.yaml"
    recorded = ("--recording", tmp_path / "run.csv", "--recorded-with", in_force)
    result = run(loads, "--out", out, "--gravity", "9.81", *recorded)
    assert result.exit_code == 0, result.output
    (sensor,) = load_calibration(out).cables.values()
    assert sensor.scale_n_per_unit == pytest.approx(0.5, rel=1e-4)
    assert sensor.zero == pytest.approx(75.0, rel=1e-4)
