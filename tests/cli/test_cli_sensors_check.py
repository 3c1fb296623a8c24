"""`sensors check` of recordings: exit codes, the table, JSON, and both file formats."""

import json

import numpy as np
import pytest
from sensor_series import ARM, RATE_HZ, good_tensions_n
from typer.testing import CliRunner

from cablesense_base.errors import CableSenseError
from cablesense_cli.app import app
from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.mcap_file import write_mcap
from cablesense_gap.recordings.recording import Recording


def run(*arguments):
    return CliRunner().invoke(app, ["sensors", "check", *map(str, arguments)])


def recording(tensions_n):
    rows = len(tensions_n)
    return Recording(
        "run",
        np.arange(rows) / RATE_HZ,
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, ARM.joint_count)),
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, 3)),
        tensions_n,
    )


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_good_sensors_give_a_table_and_exit_code_0(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    made = recording(good_tensions_n())
    if suffix == "csv":
        write_csv(path, made)
    else:
        write_mcap(path, made, ARM)
    result = run(path)
    assert result.exit_code == 0, result.output
    assert "1,000 samples at 100.0 Hz" in result.output
    assert "cable_12" in result.output
    assert "Nothing wrong" in result.output


def test_what_is_wrong_gives_exit_code_1_and_says_where(tmp_path):
    tensions_n = good_tensions_n()
    tensions_n[:, 3] += np.random.default_rng(0).normal(0.0, 1.0, len(tensions_n))
    write_csv(tmp_path / "run.csv", recording(tensions_n))
    result = run(tmp_path / "run.csv")
    assert result.exit_code == 1
    assert "wrong: cable_4 varies by" in result.output
    assert "Nothing wrong" not in result.output


def test_json_has_the_figures_and_what_was_expected(tmp_path):
    tensions_n = good_tensions_n()
    tensions_n[400:600, 6] += 25.0
    write_csv(tmp_path / "run.csv", recording(tensions_n))
    pulls = tmp_path / "pulls.csv"
    pulls.write_text("cable,start_s,end_s\ncable_1,3.5,6.5\n", encoding="utf-8")
    result = run(tmp_path / "run.csv", "--pulls", pulls, "--json")
    content = json.loads(result.stdout)
    assert result.exit_code == 1
    assert not content["usable"]
    assert content["timing"]["rate_hz"] == pytest.approx(100.0)
    assert content["expected"]["rate_hz"] == 100.0
    assert content["channels"][0]["noise_n"] < content["expected"]["noise_n"]
    assert content["pulls"][0]["moved"] == "cable_7"
    assert content["findings"][0]["kind"] == "swapped"


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["none.csv"], "no such file"),
        (["none.csv", "--pull", "all"], "--pulls FILE"),
        (["--pulls", "p.csv"], "--pull all"),
        (["--pull", "cable_99"], "no cable 'cable_99'"),
        (["--arm", "nonsense"], "bundled arms are"),
    ],
)
def test_wrong_input_is_refused(arguments, remedy):
    result = run(*arguments)
    assert isinstance(result.exception, CableSenseError)
    assert remedy in str(result.exception)
