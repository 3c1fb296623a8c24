"""An arm file of one's own, and a small model that is trained for it.

    python -m examples.own_arm

The whole way needs more samples: `cablesense train --arm my_arm.yaml` (docs/arm_file.md).
"""

from __future__ import annotations

import sys
from pathlib import Path

from typer.testing import CliRunner

from cablesense_base.installation import config_path
from cablesense_ros.cli.app import app

OUT = Path("out/own_arm")
SAMPLES = 300


def make(folder: Path) -> Path:
    """Write an arm file, show it, train a model; the path of the model file."""
    folder.mkdir(parents=True, exist_ok=True)
    arm, model = folder / "my_arm.yaml", folder / "my_arm.onnx"
    text = config_path("arm_template.yaml").read_text(encoding="utf-8")
    text = text.replace("stiffness_n_m: 1.0e5", "stiffness_n_m: 2.0e5")
    arm.write_text(text, encoding="utf-8")
    small = ["--network", "closed-form", "--samples", str(SAMPLES), "--out", str(model), "--force"]
    for arguments in (["info", str(arm)], ["train", "--arm", str(arm), *small]):
        print("cablesense", *arguments)
        done = CliRunner().invoke(app, arguments, catch_exceptions=False)
        print(done.output)
    return model


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
