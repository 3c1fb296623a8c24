"""Sets of recordings with hidden effects: files, answers, refusals."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_gap.amended_arm import write_arm
from cablesense_gap.arm_simulator import counted_rows
from cablesense_plants.__main__ import app
from cablesense_plants.arm.blind_cases import make_case, record_cases
from cablesense_plants.arm.body import PlantError, read_nominal
from cablesense_recording.checks import check_recording
from cablesense_recording.csv_file import read_csv
from cablesense_recording.reading import read_recording
from cablesense_sim.arm import open_arm
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.plant_arm import ARM_FILE, NOMINAL, two_segments

pytestmark = pytest.mark.slow


QUICK = ("actuator_ratio", "none")


@pytest.fixture(scope="module")
def arm_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_segments(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def folder(arm_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("cases")
    nominal = read_nominal(arm_file)
    list(record_cases(place, place / "answers" / "answers.csv", nominal, 2, 7, QUICK))
    return place


def test_any_reader_of_recordings_reads_them(folder: Path, arm_file: Path) -> None:
    schedule, tensions_n = make_case(read_nominal(arm_file), 7, 2, "none").recordings[""]
    recording = read_csv(folder / "case_002.csv", open_arm(arm_file))
    for name, expected in schedule._asdict().items():
        np.testing.assert_allclose(getattr(recording, name), expected, atol=1e-9)
    np.testing.assert_allclose(recording.tensions_n, tensions_n, atol=5.1e-5)


LISTS = {
    "segments.length_m": [0.15, 0.13, 0.12, 0.11],
    "segments.mass_kg": [0.6, 0.5, 0.4, 0.3],
    "segments.contact_m": [0.07, 0.06, 0.06, 0.05],
    "cables.routing_radius_m": [0.06, 0.055, 0.05, 0.045],
    "sensors.rate_hz": 1.0,
}
ELASTIC = {
    "segments.count": 1,
    "cables.angle_deg.first": None,
    "cables.stiffness_n_m": None,
    "cables.axial_rigidity_n": 3e4,
    "actuators.kp_n_m": 4e5,
}


@pytest.mark.parametrize("changes", [LISTS, ELASTIC], ids=["lists", "one segment"])
def test_an_arm_of_another_kind_is_read_and_predicted(tmp_path: Path, changes: Any) -> None:
    """Its tolerances alone part its readings from those of the simulator's arm."""
    arm = variant(changes, "cdsm_lab")
    file = tmp_path / "arm.yaml"
    write_arm(file, arm, "")
    (answer,) = record_cases(tmp_path, tmp_path / "a.csv", read_nominal(file), 1, 4, ["none"])
    read = read_recording(tmp_path / "case_001.csv", arm)
    predicted_n = replay_arm(arm, read.course)
    assert check_recording(read, arm, predicted_n) == []
    counted = counted_rows(arm, read, predicted_n)
    left_n = (read.tensions_n - predicted_n)[counted]
    assert np.sqrt((left_n**2).mean()) == pytest.approx(answer.scatter_gap_n, rel=0.3)


def test_answers_stand_apart_and_no_recording_contains_them(folder: Path) -> None:
    with (folder / "answers" / "answers.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["effects"] for row in rows] == ["unknown", "none"]
    assert [row["form"] for row in rows] == ["actuator_ratio", ""]
    names = [row["recording"] for row in rows]
    assert names == ["case_001", "case_002"] == sorted(path.stem for path in folder.glob("*.csv"))
    for path in folder.glob("*.csv"):
        assert "scale" not in path.read_text()


def test_the_command_makes_the_same_files(folder: Path, arm_file: Path, tmp_path: Path) -> None:
    arguments = ["--count", "2", "--seed", "7", "--out", str(tmp_path / "out")]
    arguments += ["--answers", str(tmp_path / "kept.csv"), "--workers", "1"]
    arguments += ["--arm", str(arm_file)]
    result = CliRunner().invoke(app, [*arguments, *(f"--only={kind}" for kind in QUICK)])
    assert result.exit_code == 0, result.output
    assert not (tmp_path / "out" / "answers").exists()
    kept = (tmp_path / "kept.csv").read_bytes()
    assert kept == (folder / "answers" / "answers.csv").read_bytes()
    for path in folder.glob("*.csv"):
        assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes()


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match="no effect 'sag'"):
        list(record_cases(tmp_path, tmp_path / "a.csv", NOMINAL, 1, 0, ("sag",)))
    perfect = replace(NOMINAL, noise_std_n=0.0, step_n=0.0)
    with pytest.raises(PlantError, match="are both 0"):
        list(record_cases(tmp_path, tmp_path / "a.csv", perfect, 1, 0, ("none",)))
    with pytest.raises(PlantError, match="no effect"):
        make_case(NOMINAL, 0, 1, "none+payload")
    (tmp_path / "file").write_text("")
    nominal = read_nominal(two_segments(tmp_path))
    with pytest.raises(PlantError, match="cannot be written"):
        list(record_cases(tmp_path / "file", tmp_path / "a.csv", nominal, 1, 0, ("none",)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("name: cdsm_lab", "name: ["), "not plain YAML"),
        (("mass_kg: 0.50", "mass: 0.5"), "'mass_kg' is missing"),
        (("count: 4", "count: 0"), "no segment"),
        (("length_m: 0.130", "length_m: long"), "one number or one for each segment"),
        (("length_m: 0.130", "length_m: [0.1, 0.2]"), "nor 4, one for each segment"),
        (("name: cdsm_lab", "effects: [{effect: payload}]"), "effects are listed"),
    ],
)
def test_arms_that_the_plant_cannot_build(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(ARM_FILE.read_text().replace(*change))
    with pytest.raises(PlantError, match=message):
        read_nominal(file)


def test_the_second_recording_is_of_the_same_arm_doing_something_else(arm_file: Path) -> None:
    nominal = read_nominal(arm_file)
    both = make_case(nominal, 5, 1, "sensor_offset", second=True).recordings
    alone = make_case(nominal, 5, 1, "sensor_offset").recordings
    np.testing.assert_array_equal(both[""][1], alone[""][1])
    schedule, tensions_n = both["second"]
    assert len(tensions_n) == len(schedule.time_s)
    assert not np.array_equal(schedule.command_rad, both[""][0].command_rad)
