"""The verb `sensors`: check and calibrate, from files, with tables and exit codes."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_online.can.channel_map import load_sensor_scales, with_sensor_scales
from cablesense_recording.csv_file import write_csv
from cablesense_ros.cli.app import app
from tests.helpers.bags import write_mcap
from tests.helpers.can_frames import PACKED, PACKED_DATABASE
from tests.helpers.sensor_series import ARM, good_tensions_n, series


def run(*arguments):
    return CliRunner().invoke(app, ["sensors", "check", *map(str, arguments)])


def test_good_sensors_give_a_table_and_exit_code_0(tmp_path):
    path = tmp_path / "run.mcap"
    write_mcap(path, series(good_tensions_n()), ARM)
    result = run(path)
    assert result.exit_code == 0, result.output
    assert "1,000 samples at 100.0 Hz" in result.output
    assert "cable_12" in result.output
    assert "Nothing wrong" in result.output


def test_what_is_wrong_gives_exit_code_1_and_says_where(tmp_path):
    tensions_n = good_tensions_n()
    tensions_n[:, 3] += np.random.default_rng(0).normal(0.0, 1.0, len(tensions_n))
    write_csv(tmp_path / "run.csv", series(tensions_n))
    result = run(tmp_path / "run.csv")
    assert result.exit_code == 1
    assert "wrong: cable_4 varies at rest by" in result.output
    assert "Nothing wrong" not in result.output


def test_json_has_the_figures_and_what_was_expected(tmp_path):
    tensions_n = good_tensions_n()
    tensions_n[:, 6] += np.linspace(0.0, 3.0, len(tensions_n))
    write_csv(tmp_path / "run.csv", series(tensions_n))
    result = run(tmp_path / "run.csv", "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 1
    assert not content["usable"]
    assert content["timing"]["rate_hz"] == pytest.approx(100.0)
    assert content["expected"]["rate_hz"] == 100.0
    assert content["channels"][0]["noise_n"] < content["expected"]["noise_n"]
    assert content["findings"][0]["kind"] == "drift"


SCALE = 0.125
ZERO = 40.0
MASSES_KG = (0.0, 2.0, 4.0, 8.0, 4.0, 2.0, 0.0)


def run_calibrate(*arguments):
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
    result = run_calibrate(loads, "--out", out, "--gravity", "9.81")
    assert result.exit_code == 0, result.output
    assert "Not calibrated: cable_3" in result.output
    calibration = load_sensor_scales(out)
    channels = with_sensor_scales(PACKED, PACKED_DATABASE, calibration, "c").channels
    assert channels["cable_2"].scale_n_per_unit == pytest.approx(SCALE, rel=1e-6)
    assert channels["cable_2"].zero == pytest.approx(ZERO, rel=1e-6)
    assert channels["cable_12"] == PACKED.channels["cable_12"]
    assert calibration.gravity_m_s2 == 9.81


def test_unknown_gravity_makes_the_scale_less_sure(loads, tmp_path):
    result = run_calibrate(loads, "--out", tmp_path / "c.yaml", "--json")
    sensor = json.loads(result.stdout)["cables"]["cable_1"]
    share = sensor["scale_u95_n_per_unit"] / sensor["scale_n_per_unit"]
    assert share == pytest.approx(0.003, rel=0.05)


def test_windows_of_a_recording_give_the_same_whatever_was_in_force(loads, tmp_path):
    in_force = tmp_path / "in_force.yaml"
    assert run_calibrate(loads, "--out", in_force, "--gravity", "9.81").exit_code == 0
    time_s = np.arange(0.0, 10.0 * len(MASSES_KG), 0.1)
    step = (time_s // 10.0).astype(int)
    raw = 75.0 + np.array(MASSES_KG)[step] * 9.81 / 0.5  # of a sensor that was exchanged since
    tensions_n = np.full((len(time_s), 12), 50.0)
    tensions_n[:, 1] = SCALE * (raw - ZERO)
    write_csv(tmp_path / "run.csv", series(tensions_n, time_s))
    lines = [f"cable_2,{mass},{10 * n + 2},{10 * n + 9}" for n, mass in enumerate(MASSES_KG)]
    loads.write_text("\n".join(["cable,mass_kg,start_s,end_s", *lines]), encoding="utf-8")
    out = tmp_path / "anew.yaml"
    recorded = ("--recording", tmp_path / "run.csv", "--recorded-with", in_force)
    result = run_calibrate(loads, "--out", out, "--gravity", "9.81", *recorded)
    assert result.exit_code == 0, result.output
    (sensor,) = load_sensor_scales(out).cables.values()
    assert sensor.scale_n_per_unit == pytest.approx(0.5, rel=1e-4)
    assert sensor.zero == pytest.approx(75.0, rel=1e-4)


def test_of_two_arms_in_a_bag_a_topic_chooses_one_and_is_named(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    write_mcap(bag / "bag_0.mcap", series(good_tensions_n()), ARM, "left")
    write_mcap(bag / "bag_1.mcap", series(good_tensions_n()), ARM, "right")
    refused = run(bag)
    assert "choose one, as with --topic /left/" in str(refused.exception)
    result = run(bag, "--topic", "/right/cable_tensions")
    assert result.exit_code == 0, result.output
    assert "/right/cable_tensions" in result.output
