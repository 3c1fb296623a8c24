"""`cablesense dataset` writes as its options state; `train` refuses before it writes."""

import json

import pyarrow.parquet as pq
import pytest
import typer
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_ros.cli.train import command_line, dataset
from cablesense_training.data.parquet import read_dataset

app = typer.Typer()
app.command()(dataset)
runner = CliRunner()


def run(path, *options):
    return runner.invoke(app, ["--out", str(path), "--samples", "100", *options])


def test_figures_agree_with_the_file(tmp_path):
    path = tmp_path / "data.parquet"
    result = run(path, "--pose", "random", "--force-low-n", "5", "--seed", "3", "--json")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    read = read_dataset(path)
    assert figures["rows"] == len(read) == 100
    assert figures["arm"] == read.arm.identity
    assert figures["contact_free"] == (read.segment == 0).sum()
    counts = [int((read.segment == n).sum()) for n in (1, 2, 3, 4)]
    assert figures["contacts_per_segment"] == counts
    assert figures["slack_rows"] == (read.slack_cables > 0).sum()
    touched = read.magnitude_n[read.segment > 0]
    assert figures["force_range_n"] == [touched.min(), touched.max()]
    assert figures["rows_per_second"] > 0


def test_the_command_in_the_file_makes_the_same_file(tmp_path):
    first = tmp_path / "first"
    second = tmp_path / "second"
    options = ["--protocol", "multi", "--max-contacts", "2", "--no-noise", "--seed", "9"]
    assert run(first, *options).exit_code == 0
    stored = pq.read_schema(first).metadata[b"cablesense.command"].decode()
    words = stored.split()
    assert words[:2] == ["cablesense", "dataset"]
    assert runner.invoke(app, [*words[2:], "--out", str(second)]).exit_code == 0
    assert first.read_bytes() == second.read_bytes()


def test_table_without_terminal_has_no_progress_bar(tmp_path):
    result = run(tmp_path / "data.parquet", "--arm", "cdsm_table2")
    assert result.exit_code == 0, result.output
    assert "contacts per segment" in result.stdout
    assert "\x1b" not in result.output
    assert result.stderr == ""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--protocol", "triple"], "must be one of single, multi"),
        (["--samples", "0"], "samples = 0"),
        (["--pose", "bent"], "pose = 'bent': must be"),
        (["--pose", "random", "--pose-range-deg", "90"], "must be at most 45.0"),
        (["--force-high-n", "nan"], "force_high_n = nan"),
        (["--max-contacts", "2"], "unknown option 'max_contacts'"),
        (["--protocol", "multi", "--max-contacts", "9"], "the arm has 4 segments"),
        (["--workers", "0"], "workers = 0"),
        (["--seed", "-1"], "seed = -1"),
        (["--arm", "no-such-arm"], "no-such-arm"),
        (["--out", "."], "is a folder"),
    ],
)
def test_refuses_in_one_line(tmp_path, options, message):
    result = run(tmp_path / "data.parquet", *options)
    assert isinstance(result.exception, CableSenseError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_when_a_network_is_unknown(command, tmp_path):
    ended = command("train", "--network", "magic", "--out", "model.onnx")
    assert (ended.returncode, "two-stage" in ended.stderr) == (2, True)
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_when_a_network_is_one_of_earlier_versions(command, tmp_path):
    ended = command("train", "--network", "temporal", "--out", "model.onnx")
    assert ended.returncode == 2
    assert "cablesense export --arm" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_command_names_what_was_chosen_and_quotes_it():
    options = {"arm": "my arm.yaml", "samples": 5, "data": None, "pose_range_deg": 10.0}
    assert command_line("train", options) == (
        "cablesense train --arm 'my arm.yaml' --samples 5 --pose-range-deg 10.0"
    )
