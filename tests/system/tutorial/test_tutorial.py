"""The command lines of the tutorial, in order, as someone types them.

The recording is cut short, so that no line takes minutes.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cablesense_contact.inference.law_model import LawModel
from cablesense_ros.cli.app import app
from tests.helpers.checkout import CHECKOUT

pytestmark = [pytest.mark.exports, pytest.mark.slow, pytest.mark.timeout(240)]

PAGE = CHECKOUT / "docs/tutorial.md"
BLOCKS = re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.replace("\\\n", "").splitlines()]
ELSEWHERE = ("make demo", "make setup", ". .venv")  # other tests, or what runs the tests
SHORTER = {
    "cablesense gap adapt": "cablesense gap adapt --workers 1",
    "cablesense evaluate": "cablesense evaluate --json",
    "rate_hz: 10/": "rate_hz: 1/",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the lines are typed, one after the other."""
    pytest.importorskip("torch")
    return tmp_path_factory.mktemp("tutorial")


@pytest.mark.parametrize("line", [line for line in LINES if not line.startswith(ELSEWHERE)])
def test_a_line_runs(line, folder, monkeypatch):
    monkeypatch.chdir(folder)
    for given, short in SHORTER.items():
        line = line.replace(given, short)
    command, _, file = line.partition(" > ")
    name, *words = shlex.split(command)
    if name != "cablesense":
        program = sys.executable if name == "python" else name
        subprocess.run(
            [program, *words], check=True, env={**os.environ, "PYTHONPATH": str(CHECKOUT)}
        )
        return
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, f"{done.output} {done.exception}"
    if file:
        Path(file).write_text(done.stdout, encoding="utf-8")


def test_the_hidden_effect_is_found_and_the_estimator_repaired(folder):
    verdict = json.loads((folder / "adapted/verdict.json").read_text(encoding="utf-8"))
    assert verdict["effects"] == ["sensor_gain"]
    before, after = (verdict["estimator"][when]["force_mae_n"] for when in ("before", "after"))
    assert after < 0.5 * before
    answers = (folder / "bench/answers/answers.csv").read_text(encoding="utf-8")
    assert all(cable in answers for cable in verdict["where"]["cables"])
    assert (folder / "errors.png").is_file()
    assert LawModel(folder / "my_arm.onnx").arm.name
