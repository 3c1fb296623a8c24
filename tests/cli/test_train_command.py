"""What `cablesense train` refuses and asks for; test_five_by_four.py trains."""

import typer
from typer.testing import CliRunner

from cablesense_ros.cli.train import command_line, train
from cablesense_training.errors import TrainingError

app = typer.Typer(pretty_exceptions_enable=False)
app.command()(train)


def _run(*words):
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "200"})


def test_nothing_is_written_when_a_network_is_unknown(tmp_path):
    result = _run("--network", "magic", "--out", str(tmp_path / "model.onnx"))
    assert isinstance(result.exception, TrainingError)
    assert "two-stage" in str(result.exception)
    assert not list(tmp_path.iterdir())


def test_the_command_names_what_was_chosen_and_quotes_it():
    options = {"arm": "my arm.yaml", "samples": 5, "data": None, "pose_range_deg": 10.0}
    assert command_line("train", options) == (
        "cablesense train --arm 'my arm.yaml' --samples 5 --pose-range-deg 10.0"
    )
