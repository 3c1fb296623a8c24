"""Several contacts at once: the shipped model beside the two-stage network, trees and the bound.

    python benchmarks/multi_contact.py [--samples 50000] [--write]

Straight arm, none to four forces of 0 to 60 N, sensor noise and step on; recognition counts
contacts from 5 N and all untouched segments. Gradient boosting is trained here on 50,000 samples.
Table II's physical rows are put to gradient boosting as well.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import harness
import numpy as np

from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.comparison import (
    MULTI_ARM,
    WEAKEST_MULTI_N,
    evaluate_multi_answer,
    evaluate_multi_models,
    multi_protocol,
)
from cablesense_training.evaluation.noise_bound import multi_contact_bound_n
from cablesense_training.evaluation.table2 import read_table2
from examples.paper.boosting import BoostingBaseline, MultiBoostingBaseline

TEST_SEED = 20_260_001
TRAINING_SAMPLES = 50_000


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/multi_contact.json")
    parser.add_argument("--samples", type=int, default=50_000, help="test samples")
    options = parser.parse_args()
    arm = open_arm(MULTI_ARM)
    test = draw_dataset(arm, multi_protocol(options.samples), TEST_SEED)
    metrics = {name: asdict(found.metrics) for name, found in evaluate_multi_models(test).items()}
    training = draw_dataset(arm, multi_protocol(TRAINING_SAMPLES), seed=0)
    answer = MultiBoostingBaseline(training).answer(test)
    metrics["gradient_boosting"] = asdict(evaluate_multi_answer(*answer, test).metrics)
    bound = multi_contact_bound_n(test, WEAKEST_MULTI_N)
    metrics["noise_bound"] = {"magnitude_mae_n": bound.tolist()}
    result = {
        **harness.origin(),
        "seed": TEST_SEED,
        "samples": options.samples,
        "several_contacts": metrics,
        "table2_gradient_boosting": _table2(),
    }
    harness.publish("multi_contact.json", result, options)


def _table2() -> list[dict[str, Any]]:
    """The physical rows as boosted trees of the three-segment arm see them."""
    arm, rows = open_arm("cdsm_table2"), [r for r in read_table2() if r.source == "physical"]
    trees = BoostingBaseline(
        draw_dataset(arm, SingleContact(samples=TRAINING_SAMPLES, pose="straight"), 0)
    )
    blank = draw_dataset(arm, SingleContact(samples=len(rows), pose="straight"), 1)
    measured = np.stack([row.tension_difference_n for row in rows])
    answer = trees.answer(replace(blank, tension_difference_n=measured))
    return [
        {
            "true_segment": row.segment,
            "true_n": row.weight_n,
            "segment": int(answer.segment[i]),
            "angle_deg": float(answer.angle_deg[i]),
            "magnitude_n": float(answer.magnitude_n[i]),
        }
        for i, row in enumerate(rows)
    ]


if __name__ == "__main__":
    main()
