"""The command lines of the tutorial, in order, as someone types them.

Training and the recording are cut short, so that no line takes minutes.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(145)]

PAGE = Path(__file__).resolve().parents[2] / "docs/tutorial.md"
BLOCKS = re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.replace("\\\n", "").splitlines()]
ELSEWHERE = ("make demo", "make setup", ". .venv")  # other tests, or what runs the tests
SHORTER = {
    "cablesense train": "cablesense train --samples 3000 --epochs 6",
    "cablesense evaluate": "cablesense evaluate --json",
    "rate_hz: 10/": "rate_hz: 3/",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the lines are typed, one after the other."""
    pytest.importorskip("torch")
    return tmp_path_factory.mktemp("tutorial")


@pytest.mark.parametrize("line", [line for line in LINES if not line.startswith(ELSEWHERE)])
def test_a_line_runs(line, folder):
    for given, short in SHORTER.items():
        line = line.replace(given, short)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_hidden_effect_is_found_and_the_estimator_repaired(folder):
    verdict = json.loads((folder / "adapted/verdict.json").read_text(encoding="utf-8"))
    assert verdict["effects"] == ["sensor_gain"]
    before, after = (verdict["estimator"][when]["force_mae_n"] for when in ("before", "after"))
    assert after < 0.2 * before
    answers = (folder / "bench/answers/answers.csv").read_text(encoding="utf-8")
    assert all(cable in answers for cable in verdict["where"]["cables"])
    assert (folder / "errors.png").is_file()
