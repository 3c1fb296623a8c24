"""`cablesense gap protocol`: a table for people, and rows for programs."""

import csv
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_gap.protocol import standard_protocol
from cablesense_ros.cli.app import app
from cablesense_sim.arm import open_arm
from tests.helpers.two_link import write_model


@pytest.mark.slow
def test_the_table_has_a_line_for_every_block():
    result = CliRunner().invoke(
        app, ["gap", "protocol", "--arm", "cdsm_lab"], env={"COLUMNS": "200"}
    )
    assert result.exit_code == 0, result.output
    assert "cablesense gap record --arm cdsm_lab --out recording.mcap" in result.output
    for block in standard_protocol(open_arm("cdsm_lab")):
        assert block.does.split(" (")[0][:60] in result.output


@pytest.mark.slow
def test_rows_have_the_columns_of_a_recording_but_tensions(tmp_path):
    out = tmp_path / "protocol.csv"
    result = CliRunner().invoke(
        app, ["gap", "protocol", "--arm", "cdsm_table2", "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    with out.open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header[:2] == ["time_s", "trial"]
    loads = ["load_segment", "load_x_n", "load_y_n", "load_z_n", "load_at_m"]
    assert header[7:] == ["q6_cmd_rad", *loads]
    values = np.array([[cell or "nan" for cell in row] for row in rows], dtype=float)
    np.testing.assert_array_equal(np.isnan(values[:, -1]), values[:, 8] == 0.0)
    assert (np.diff(values[:, 0]) > 0.0).all()
    assert np.abs(values[:, 2:8]).max() < math.radians(15.0)


def robot_protocol(tmp_path, *options):
    asked = ["gap", "protocol", "--model", str(write_model(tmp_path)), *map(str, options)]
    return CliRunner().invoke(app, asked, env={"COLUMNS": "200"})


@pytest.mark.slow
def test_a_robots_protocol_says_what_it_shows_and_draws_it(tmp_path):
    picture = tmp_path / "pairs.png"
    result = robot_protocol(tmp_path, "--picture", picture)
    assert result.exit_code == 0, result.output
    assert "may be taken for" in result.output
    lines = [line for line in result.output.splitlines() if "base_tilt" in line]
    assert any("joint_zero" in line for line in lines)  # the same in a plane
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_motions_for_a_question_are_written_five_times(tmp_path):
    out = tmp_path / "motion.csv"
    pair = "rotor_inertia", "payload"
    result = robot_protocol(tmp_path, "--tell-apart", *pair, "--out", out)
    assert result.exit_code == 0, result.output
    assert "To tell rotor_inertia from payload" in result.output
    with out.open(encoding="utf-8") as file:
        trials = {row["trial"] for row in csv.DictReader(file)}
    assert len(trials) % 5 == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--tell-apart", "friction", "payload"), "friction: no effect of"),
        (("--channels", "external"), "without a position servo"),
        (("--picture", "pairs.pdf"), "ends with .svg or .png"),
    ],
)
def test_what_cannot_be_planned_is_refused(tmp_path, options, said):
    result = robot_protocol(tmp_path, *options)
    assert isinstance(result.exception, CableSenseError)
    assert said in str(result.exception)


def test_options_of_robots_are_refused_for_an_arm():
    result = CliRunner().invoke(app, ["gap", "protocol", "--channels", "commands"])
    assert isinstance(result.exception, CableSenseError)
    assert "--model" in str(result.exception)
