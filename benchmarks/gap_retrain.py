"""Force estimators before and after a diagnosis, where the hidden effect hurts the one before.

    python benchmarks/gap_retrain.py [--count 12] [--seed 9102] [--only EFFECT …] [--write]

Draws recordings by the independent plant, measures each with the shipped model of the nominal arm,
and passes on those whose forces it gets wrong by `--least` newtons or more, the worst of each
effect first: each is diagnosed, and estimators are trained for the nominal arm and for what the
diagnosis makes of it (`cablesense_gap.retraining`), as `cablesense gap diagnose --retrain` does.
The seed was not used while the diagnosis was made. Beside it stands the same network trained on
samples of the amended arm as `cablesense train --arm` draws them, which is memoryless; that arm
was fitted to all trials.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import harness
from gap_blind import ARM, drawn
from rich.console import Console

from cablesense_base.installation import config_path
from cablesense_gap.pipeline import diagnose
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.retraining import (
    answered_n,
    arm_alone,
    estimator_errors,
    force_errors,
    tared_loads,
    trained_answering,
)
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_training.inference.estimator import Estimator

RESULT = "gap_retrain.json"
HIDDEN = ("contact_offset", "joint_elasticity", "sensor_lag", "capstan_friction")
"""Effects that can hurt; what a tare takes away, or what acts before it, seldom does."""

LOG = Console(stderr=True)


def main() -> None:
    """Draws, diagnoses, trains and prints; keeps the numbers with `--write`, case by case."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--count", type=int, default=12, help="recordings drawn")
    parser.add_argument("--seed", type=int, default=9102, help="of the plant")
    parser.add_argument("--only", nargs="+", default=HIDDEN, help="effects, hidden in turn")
    parser.add_argument("--least", type=float, default=2.0, help="newtons of force error before")
    parser.add_argument("--most", type=int, default=99, help="cases to go through")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    arm = open_arm(ARM)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        answers = drawn(folder, options.count, options.seed, options.only, options.workers)
        hurt = {}
        for path in sorted(folder.glob("case_*.csv")):
            recording = read_recording(path, arm)
            hurt[path.stem] = _shipped(recording, arm)["force_mae_n"], recording
        worst = _worst_of_each_first(
            {n: (answers[n].effects, e) for n, (e, _) in hurt.items() if e >= options.least}
        )
        result: dict[str, Any] = {
            **harness.origin(),
            "arm": ARM,
            "drawn": options.count,
            "hurt_by_at_least_n": options.least,
            "hurt": len(worst),
            "cases": {},
        }
        LOG.print(f"{len(worst)} of {options.count} are hurt: {', '.join(worst)}")
        for case in worst[: options.most]:
            result["cases"][case] = _case(hurt[case][1], arm, answers[case], options.workers)
            print(json.dumps({case: result["cases"][case]}, indent=1), flush=True)
            if options.write:
                harness.write_result(RESULT, result)


def _worst_of_each_first(hurt: dict[str, tuple[str, float]]) -> list[str]:
    """Cases by effect and error: the worst of each effect, then the second of each, …."""
    by_error = sorted(hurt, key=lambda name: -hurt[name][1])
    seen: Counter[str] = Counter()
    rank = {}
    for name in by_error:
        rank[name] = seen[hurt[name][0]]
        seen[hurt[name][0]] += 1
    return sorted(by_error, key=lambda name: rank[name])


def _case(recording: Recording, arm: Arm, answer: Any, workers: int) -> dict[str, Any]:
    began = time.monotonic()
    found = diagnose(recording, arm, workers=workers)
    diagnosed = time.monotonic()
    LOG.print(f"{recording.name}: {found.verdict.effects}, {diagnosed - began:.0f} s")
    errors = estimator_errors(recording, arm, found.amended, workers=workers)
    trained = time.monotonic()
    case: dict[str, Any] = {
        "hidden": answer.effects,
        "gap_n": answer.gap_n,
        "verdict": list(found.verdict.effects),
        "diagnosis_seconds": round(diagnosed - began, 1),
        "retraining_seconds": round(trained - diagnosed, 1),
        "before": _rounded(errors.before),
        "after": _rounded(errors.after),
        "force_error_left": round(errors.after["force_mae_n"] / errors.before["force_mae_n"], 3),
    }
    if len(arm_alone(found.amended).effects) < len(found.amended.effects):
        case["trained_without_the_past"] = _rounded(_without_past(recording, arm, found.amended))
    return case


def _without_past(recording: Recording, nominal: Arm, amended: Arm) -> dict[str, float]:
    """The network as `cablesense train --arm arm.yaml` makes it, sample by sample."""
    mechanism, loads = mechanism_of(nominal), tared_loads(recording)
    answers = trained_answering(amended, mechanism, recording)(loads)
    return force_errors(mechanism, loads, answers)


def _shipped(recording: Recording, arm: Arm) -> dict[str, float]:
    estimator = Estimator.load(config_path(f"models/{ARM}.onnx"), arm)
    mechanism, loads = mechanism_of(arm), tared_loads(recording)
    estimates = estimator.estimate_batch(loads.tension_difference_n, loads.command_rad)
    return force_errors(mechanism, loads, answered_n(mechanism, loads, estimates))


def _rounded(errors: dict[str, float]) -> dict[str, float]:
    return {name: round(error, 4) for name, error in errors.items()}


if __name__ == "__main__":
    main()
