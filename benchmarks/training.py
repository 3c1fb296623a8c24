"""How long training the shipped model takes, from the arm file to the tested model file.

    python benchmarks/training.py [--arm cdsm] [--threads 2] [--write]

Runs `cablesense train` with its defaults into a temporary folder, as a user would.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time

import harness

BAR_S = 600.0


def main() -> int:
    """Trains, prints, and exits 1 where the bar is missed."""
    parser = harness.parser(__doc__, "results/training.json")
    parser.add_argument("--arm", default="cdsm")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    command = ["train", "--arm", options.arm, "--threads", str(options.threads), "--json"]
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        done = subprocess.run(
            [*harness.CABLESENSE, *command, "--out", "model.onnx"],
            cwd=folder,
            check=True,
            stdout=subprocess.PIPE,
        )
        seconds = time.perf_counter() - start
    trained = json.loads(done.stdout)
    result = {
        **harness.origin(),
        "trained_by": " ".join(["cablesense", *command]),
        "seconds_in_all": round(seconds, 1),
        "seconds_of_training": round(trained["training_seconds"], 1),
        "epochs": trained["epochs"],
        "contact_accuracy": trained["single"]["contact_accuracy"],
        "magnitude_mae_n": trained["single"]["errors"]["magnitude_mae_n"],
        "bar_seconds": BAR_S,
    }
    harness.publish("training.json", result, options)
    return 0 if seconds <= BAR_S else 1


if __name__ == "__main__":
    sys.exit(main())
