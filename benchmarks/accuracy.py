"""Accuracy of the estimator and the paper's networks on fresh samples, with the noise bound.

    python benchmarks/accuracy.py [--samples 100000] [--write]

One contact at rest in every setting of `cablesense evaluate`, which prints the same as tables, and
several contacts at once. There recognition counts contacts from 5 N and all untouched segments.
"""

from __future__ import annotations

import sys

import harness

from cablesense_training.evaluation.comparison import compare

SEED = 20_260_001


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/accuracy.json")
    parser.add_argument("--samples", type=int, default=100_000, help="test samples per setting")
    parser.add_argument("--workers", type=int, default=2, help="processes that draw samples")
    options = parser.parse_args()
    compared = compare(
        SEED, options.samples, options.workers, lambda name: print(f"{name} …", file=sys.stderr)
    )
    harness.publish("accuracy.json", compared, options, "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
