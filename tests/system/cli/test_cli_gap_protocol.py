"""`cablesense gap protocol`: a table for people, and rows for programs."""

import csv
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_gap.protocol import standard_protocol
from cablesense_ros.cli.app import app
from cablesense_sim.arm import open_arm


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
