"""`cablesense estimate`: recordings of any columns and units become a table and a plot."""

from __future__ import annotations

import csv
import io
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_base.progress import progress_bar
from cablesense_msgs_py import topics
from cablesense_recording.column_map import read_column_map
from cablesense_recording.csv_file import write_table
from cablesense_recording.reading import read_recording
from cablesense_ros.cli.app import app
from cablesense_sim import (
    mechanism_of,
    normal_force_n,
    open_arm,
    read_tensions_n,
    solve_equilibrium,
)
from cablesense_sim.joint_motion import JointMotion
from tests.helpers.bags import Bag
from tests.helpers.checkout import CHECKOUT

ARM = open_arm("cdsm_lab")
ROWS = 120
PUSHED = slice(40, 100)
PUSH_N = 25.0
PUSH_DEG = 200.0
PUSH_ACROSS_N = [PUSH_N * np.sin(np.deg2rad(PUSH_DEG)), PUSH_N * np.cos(np.deg2rad(PUSH_DEG))]
CABLES = [f"Kraft {number} [kgf]" for number in range(1, 13)]
JOINTS = [f"axis{number}" for number in range(1, 9)]
KGF_N = 9.80665


@pytest.fixture(scope="module")
def run() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A push on segment 3 of a bent arm: times, s, commands, rad, and readings, N."""
    mechanism = mechanism_of(ARM)
    pose_rad = np.deg2rad([4.0, 0.0, -3.0, 5.0, 0.0, 0.0, 2.0, -4.0])
    push_n = normal_force_n(mechanism, pose_rad, segment=3, angle_deg=PUSH_DEG, magnitude_n=PUSH_N)
    rest, pushed = solve_equilibrium(
        mechanism, [pose_rad, pose_rad], [0.0 * push_n, push_n]
    ).tensions_n
    tensions_n = np.tile(rest, (ROWS, 1))
    tensions_n[PUSHED] = pushed
    time_s = 0.2 * np.arange(ROWS)
    read_n = read_tensions_n(tensions_n, ARM.sensors, np.random.default_rng(0))
    return time_s, np.tile(pose_rad, (ROWS, 1)), read_n


@pytest.fixture
def foreign(run: tuple[np.ndarray, ...], tmp_path: Path) -> tuple[Path, Path]:
    """A CSV of a stranger's names and units, and the map that says what they mean."""
    time_s, command_rad, tensions_n = run
    recording = tmp_path / "my.csv"
    rows = np.column_stack([1e3 * time_s + 5e8, np.rad2deg(command_rad), tensions_n / KGF_N])
    with recording.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Zeit", *JOINTS, *CABLES])
        table.writerows(rows.tolist())
    described = {
        "time": {"column": "Zeit", "unit": "ms"},
        "tensions": {"columns": CABLES, "unit": "kgf"},
        "commands": {"columns": JOINTS, "unit": "deg"},
    }
    meant = tmp_path / "map.yaml"
    meant.write_text(yaml.safe_dump(described, allow_unicode=True), encoding="utf-8")
    return recording, meant


def estimated(*arguments: object) -> dict:
    result = CliRunner().invoke(app, ["estimate", *map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return json.loads(result.stdout)


def refused(*arguments: object) -> str:
    error = CliRunner().invoke(app, [*map(str, arguments)]).exception
    assert isinstance(error, CableSenseError), error
    return str(error)


@pytest.mark.slow
def test_a_csv_of_other_names_and_units_becomes_a_table_and_a_plot(
    foreign: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, meant = foreign
    out = tmp_path / "found.csv"
    summary = estimated(recording, "--columns", meant, "--out", out)
    assert summary["rows"] == ROWS
    assert summary["strongest"]["segment"] == 3
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == ROWS
    assert float(rows[-1]["time_s"]) == pytest.approx(0.2 * (ROWS - 1))
    settled = rows[60:100]
    assert {row["segment"] for row in settled} == {"3"}
    for row in settled:
        assert float(row["magnitude_n"]) == pytest.approx(PUSH_N, rel=0.1)
        across_n = [float(row[f"force_{axis}_n"]) for axis in "yz"]
        assert across_n == pytest.approx(PUSH_ACROSS_N, abs=0.1 * PUSH_N)
        assert float(row["magnitude_low_n"]) < PUSH_N < float(row["magnitude_high_n"])
        assert float(row["place_low_m"]) <= float(row["place_m"]) <= float(row["place_high_m"])
    assert {row["state"] for row in rows[:10]} <= {"moving", "untared"}
    assert {row["segment"] for row in rows[-10:]} == {"0"}
    assert (tmp_path / "found.png").read_bytes().startswith(b"\x89PNG")
    assert "exists already" in refused("estimate", recording, "--columns", meant, "--out", out)


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_a_terminal_shows_how_many_rows_are_answered(
    foreign: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...],
) -> None:
    terminal = Console(file=io.StringIO(), force_terminal=True)
    shown_there = partial(progress_bar, console=terminal)
    monkeypatch.setattr("cablesense_ros.cli.estimate.progress_bar", shown_there)
    recording, meant = foreign
    command = ["estimate", recording, "--columns", meant, "--out", tmp_path / "found.csv"]
    result = CliRunner().invoke(app, [*map(str, command), *options])
    assert result.exit_code == 0, result.output + repr(result.exception)
    assert f"{ROWS}/{ROWS}" in terminal.file.getvalue()
    assert f"{ROWS}/{ROWS}" not in result.output


@pytest.mark.slow
def test_a_bag_of_other_topics_is_estimated_too(
    run: tuple[np.ndarray, ...], tmp_path: Path
) -> None:
    time_s, command_rad, tensions_n = run
    bag = tmp_path / "my.mcap"
    with Bag(bag) as written:
        for time, command, reading in zip(time_s, command_rad, tensions_n, strict=True):
            stamp = int(1e9 * time) + 10**18
            angles_deg = np.rad2deg(command)
            written.joint_state("/axes", stamp, stamp, JOINTS, position=angles_deg)
            written.joint_state("/loadcells", stamp, stamp, CABLES, effort=-reading / 1e3)
    meant = tmp_path / "map.yaml"
    tensions = {"topic": "/loadcells", "columns": CABLES, "unit": "kN", "scale": -1.0}
    commands = {"topic": "/axes", "columns": JOINTS, "unit": "deg"}
    meant.write_text(
        yaml.safe_dump({"tensions": tensions, "commands": commands}), encoding="utf-8"
    )
    summary = estimated(bag, "--columns", meant, "--out", tmp_path / "found.csv")
    assert summary["strongest"]["segment"] == 3
    assert summary["strongest"]["magnitude_n"] == pytest.approx(PUSH_N, rel=0.1)


@pytest.mark.slow
def test_rows_without_an_answer_say_why_no_tare_is_taken(
    run: tuple[np.ndarray, ...], tmp_path: Path
) -> None:
    time_s, command_rad, tensions_n = run
    pushed_first = np.roll(tensions_n, -PUSHED.start, axis=0)
    recording = tmp_path / "my.csv"
    joints = {f"q{number + 1}_cmd_rad": command_rad[:, number] for number in range(8)}
    cables = {f"tension_{number + 1}_n": pushed_first[:, number] for number in range(12)}
    write_table(recording, {"time_s": time_s, **joints, **cables}, "%.9g")
    out = tmp_path / "found.csv"
    estimated(recording, "--out", out, "--tare-rows", 10)
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    untared = [row for row in rows if row["state"] == "untared"]
    assert len(untared) > 20
    assert all(row["doubt"] for row in untared)
    assert "tare_force" in untared[15]["doubt"]


@pytest.mark.slow
def test_an_arm_on_its_way_to_its_first_command_is_not_tared(tmp_path: Path) -> None:
    """It is commanded to another pose, half a second after the recording has begun."""
    rate_hz, before = 50.0, 25
    pose_rad = np.deg2rad([7.0, -5.0, 6.0, 7.0, -7.0, 5.0, 6.0, -7.0])
    time_s = np.arange(450) / rate_hz
    course = JointMotion.at_rest(np.zeros(8), np.deg2rad(20.0)).towards(pose_rad)
    poses_rad = np.array([course.at(max(0.0, t - time_s[before])).angle_rad for t in time_s])
    tensions_n = solve_equilibrium(mechanism_of(ARM), poses_rad).tensions_n
    read_n = read_tensions_n(tensions_n, ARM.sensors, np.random.default_rng(0))
    bag = tmp_path / "run.mcap"
    with Bag(bag) as written:
        for row, reading_n in enumerate(read_n):
            stamp = int(1e9 * time_s[row]) + 10**18
            if row == before:
                written.joint_state(
                    topics.JOINT_COMMANDS, stamp, stamp, ARM.joint_names, position=pose_rad
                )
            written.joint_state(
                topics.CABLE_TENSIONS, stamp, stamp, ARM.cable_names, effort=reading_n
            )
    out = tmp_path / "found.csv"
    result = CliRunner().invoke(app, ["estimate", str(bag), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "Left out: 25 rows before the first message on joint_commands" in result.output
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(read_n) - before
    assert {row["state"] for row in rows[:50]} == {"moving"}
    assert {row["segment"] for row in rows} == {"0"}
    assert rows[-1]["state"] in ("free", "hidden")


def test_the_sensors_check_reads_by_the_same_map(foreign: tuple[Path, Path]) -> None:
    recording, meant = foreign
    command = ["sensors", "check", recording, "--arm", "cdsm_lab", "--columns", meant, "--json"]
    result = CliRunner().invoke(app, list(map(str, command)))
    report = json.loads(result.stdout)
    assert report["timing"]["samples"] == ROWS


def test_a_diagnosis_reads_loads_by_the_same_map_and_says_where_they_are_missing(
    foreign: tuple[Path, Path], run: tuple[np.ndarray, ...], tmp_path: Path
) -> None:
    recording, meant = foreign
    command = ["gap", "diagnose", recording, "--columns", meant, "--out", tmp_path / "found"]
    assert "has no column load_segment, load_x_n" in refused(*command)
    described = yaml.safe_load(meant.read_text(encoding="utf-8"))
    described["loads"] = {"segment": "Segment", "force": ["Fx", "Fy", "Fz"], "unit": "kgf"}
    meant.write_text(yaml.safe_dump(described, allow_unicode=True), encoding="utf-8")
    with recording.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    rows[0] += ["Segment", "Fx", "Fy", "Fz"]
    for number, row in enumerate(rows[1:]):
        row += ["3", "0", "1.0", "0"] if 40 <= number < 100 else ["0", "0", "0", "0"]
    with recording.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    read = read_recording(recording, ARM, columns=read_column_map(meant, ARM))
    time_s, command_rad, tensions_n = run
    np.testing.assert_allclose(read.time_s, time_s, atol=1e-6)
    np.testing.assert_allclose(read.command_rad, command_rad, atol=1e-12)
    np.testing.assert_allclose(read.tensions_n, tensions_n, rtol=1e-12)
    np.testing.assert_allclose(read.load_n[50], [0.0, KGF_N, 0.0])
    assert read.load_segment[50] == 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tensions": {"columns": CABLES[:11]}}, "tensions.columns has 11 entries; arm cdsm_lab"),
        ({"tensions": {"unit": "oz"}}, "tensions.unit = 'oz': must be one of N, mN, kN"),
        ({"tensions": {"columns": [*CABLES[:11], CABLES[0]]}}, "twice"),
        ({"forces": {}}, "forces"),
        ({"commands": {"held": [0.0] * 8, "columns": JOINTS}}, "held"),
        ({"time": {"unit": "min"}}, "time.unit"),
    ],
)
def test_a_map_that_cannot_be_meant_is_refused_in_one_line(
    tmp_path: Path, change: dict, said: str
) -> None:
    meant = tmp_path / "map.yaml"
    meant.write_text(yaml.safe_dump(change), encoding="utf-8")
    with pytest.raises(CableSenseError) as raised:
        read_column_map(meant, ARM)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_map_of_the_docs_is_one(tmp_path: Path) -> None:
    page = (CHECKOUT / "docs/recordings.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    meant = tmp_path / "map.yaml"
    meant.write_text(example, encoding="utf-8")
    described = read_column_map(meant, ARM)
    assert described.readings(np.ones(12)) == pytest.approx(-KGF_N * np.ones(12))
    assert described.loads is not None


def test_an_arm_that_stands_still_needs_no_columns_of_commands(
    run: tuple[np.ndarray, ...], tmp_path: Path
) -> None:
    time_s, _, tensions_n = run
    recording = tmp_path / "my.csv"
    names = [f"tension_{number}_n" for number in range(1, 13)]
    write_table(
        recording, {"time_s": time_s, **dict(zip(names, tensions_n.T, strict=True))}, "%.9g"
    )
    meant = tmp_path / "map.yaml"
    held = {"commands": {"held": [4.0, 0, 0, 0, 0, 0, 0, 0], "unit": "deg"}}
    meant.write_text(yaml.safe_dump(held), encoding="utf-8")
    read = read_recording(recording, ARM, columns=read_column_map(meant, ARM))
    np.testing.assert_allclose(read.command_rad[:, 0], np.deg2rad(4.0))
    np.testing.assert_allclose(read.tensions_n, tensions_n, rtol=1e-8)


def test_a_recording_without_the_untouched_arm_is_refused(
    foreign: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, meant = foreign
    command = ["estimate", recording, "--columns", meant, "--tare-rows", 500]
    assert "--tare-rows" in refused(*command, "--out", tmp_path / "found.csv")
    assert not (tmp_path / "found.csv").exists()
