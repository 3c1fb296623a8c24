"""The command lines of the tutorial, in order, as someone types them; training is cut short."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
TRAIN, SHORT = "cablesense train", "cablesense train --samples 3000 --epochs 6"
EVALUATE, QUIET = "cablesense evaluate", "cablesense evaluate --json"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_tutorial_finds_the_hidden_effect_and_repairs_the_estimator(tmp_path):
    pytest.importorskip("torch")
    page = (CHECKOUT / "docs/tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", "").splitlines()]
    typed = [line for line in lines if not line.startswith(("make ", ". .venv"))]
    assert len(lines) - len(typed) == 3  # demo, set-up and environment have tests of their own
    here = {"PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])}
    said = {}
    for line in typed:
        command = line.replace(TRAIN, SHORT).replace(EVALUATE, QUIET)
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=os.environ | here,
            capture_output=True,
            check=False,
            text=True,
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        said[" ".join(line.split()[:3])] = done.stdout
    verdict = json.loads((tmp_path / "adapted/verdict.json").read_text(encoding="utf-8"))
    assert verdict["effects"] == ["sensor_gain"]
    assert verdict["estimator"]["after"]["force_mae_n"] < (
        0.2 * verdict["estimator"]["before"]["force_mae_n"]
    )
    assert (tmp_path / "errors.png").is_file()
    (place,) = verdict["where"]["cables"]
    assert place in said["cat bench/answers/answers.csv"]
