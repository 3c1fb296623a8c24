"""Accuracy of the shipped models and their baselines on fresh samples, with the noise bound.

    python benchmarks/accuracy.py [--samples 100000] [--write]

One contact at rest in every setting of `cablesense evaluate`, which prints the same as tables, and
several contacts at once. There recognition counts contacts from 5 N and all untouched segments.

    python benchmarks/accuracy.py --moving cdsm_friction [--write]

Sequences of commands and contacts with sensor noise, on seeds that no training has seen, under
friction or without. Memoryless estimators get the set-point at every tick, which is more than the
node gives them: there they are silent until the arm rests again. Without friction a long sequence
shows whether the state stays right. Stated intervals are judged under a load and after it, as
friction hides most of it then.
"""

from __future__ import annotations

import sys
from typing import Any

import harness
import numpy as np

from cablesense_base.progress import progress_bar
from cablesense_sim.arm import open_arm
from cablesense_training.data.sequences import MotionProtocol, Sequences, draw_sequences
from cablesense_training.evaluation.comparison import compare, metrics_json
from cablesense_training.evaluation.metrics import ContactAnswer, sequence_metrics
from cablesense_training.inference.estimator import Estimates
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import open_estimator

SEED, MOVING_SEED, LONG_SEED = 20_260_001, 7_000_001, 7_000_002
LONG_S, RELEASED_S = 300.0, 2.0
# an interval's share under friction is judged by its contacts, not its ticks
SEQUENCES = {"cdsm": 16, "cdsm_friction": 24}
ESTIMATORS = {
    # without friction, in time by MuJoCo: it has inertia and swings
    "cdsm": ("cdsm_moving", "cdsm"),
    # from rest to rest; the last is of the arm without friction
    "cdsm_friction": ("cdsm_friction_simulated", "cdsm_friction", "cdsm"),
}


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/accuracy.json or temporal_*.json")
    parser.add_argument("--samples", type=int, default=100_000, help="test samples per setting")
    parser.add_argument("--moving", choices=SEQUENCES, help="instead: sequences of this arm")
    parser.add_argument("--workers", type=int, default=2, help="processes that draw samples")
    options = parser.parse_args()
    if options.moving:
        found = {"seeds": [MOVING_SEED, LONG_SEED], **_moving(options.moving, options.workers)}
        harness.publish(f"temporal_{options.moving}.json", found, options)
        return
    compared = compare(
        SEED, options.samples, options.workers, lambda name: print(f"{name} …", file=sys.stderr)
    )
    harness.publish("accuracy.json", compared, options)


def _moving(arm: str, workers: int) -> dict[str, Any]:
    sequences = _drawn(arm, MotionProtocol(sequences=SEQUENCES[arm]), MOVING_SEED, workers)
    friction = bool(sequences.arm.effects)
    metrics: dict[str, Any] = {}
    if friction:
        # the estimator has all commands there, and not only those after a late start
        before_rad = sequences.before_rad
        followed = np.abs(before_rad - before_rad[:, -1:]).max((1, 2)) > 0.0
    else:
        long = _drawn(arm, MotionProtocol(sequences=1, duration_s=LONG_S), LONG_SEED, workers)
    for model in ESTIMATORS[arm]:
        estimator = open_estimator(find_model(model))
        found = estimator.estimate_sequences(sequences)
        answer = ContactAnswer.of(found)
        metrics[model] = _errors(answer, sequences)
        metrics[model]["intervals95"] = _intervals(found, sequences)
        if friction:
            told = answer.select(np.repeat(followed, sequences.segment.shape[1]))
            since_before = _errors(told, sequences.select(followed))
            metrics[model]["where it ran before the arm moved"] = since_before
        else:
            told = ContactAnswer.of(estimator.estimate_sequences(long))
            # where nothing is answered, the whole force is the error
            off_n = np.abs(told.force_n - long.magnitude_n.ravel())
            tenths = [float(part.mean()) for part in np.array_split(off_n, 10)]
            metrics[model]["by_tenth_of_the_long_course_n"] = tenths
    return {"sequences": len(sequences), "estimators": metrics}


def _drawn(arm: str, protocol: MotionProtocol, seed: int, workers: int) -> Sequences:
    with progress_bar(protocol.sequences, shown=True, what=f"sequences of {arm}") as advance:
        return draw_sequences(open_arm(arm), protocol, seed, workers=workers, on_done=advance)


def _errors(answer: ContactAnswer, sequences: Sequences) -> dict[str, Any]:
    found = sequence_metrics(answer, sequences)
    return {
        "moving": metrics_json(found.moving),
        "rest": metrics_json(found.rest),
        "false_force_moving_n": found.false_force_moving_n,
        "false_force_rest_n": found.false_force_rest_n,
    }


def _intervals(found: Estimates, sequences: Sequences) -> dict[str, dict[str, float]]:
    """Share of the 95 % intervals of the force that hold it, and half their mean width, N.

    The interval begins at 0 N where no contact is answered, as a force may be hidden.
    """
    low_n = np.where(found.segment > 0, found.low_n, 0.0).reshape(sequences.segment.shape)
    high_n = found.high_n.reshape(low_n.shape)
    force_n, touched = sequences.magnitude_n, sequences.segment > 0
    since = round(RELEASED_S / sequences.protocol.tick_s)
    padded = np.pad(touched, ((0, 0), (since, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, since + 1, axis=1)
    lately = np.asarray(windows.any(axis=-1))
    phases = {
        "all": np.ones_like(touched),
        "touched": touched,
        f"within {RELEASED_S:g} s of a release": lately & ~touched,
        "untouched for longer": ~lately,
    }
    holds = (low_n <= force_n) & (force_n <= high_n)
    return {
        name: {
            "share": float(rows.mean()),
            "coverage95": float(holds[rows].mean()),
            "half_width_n": float(0.5 * (high_n - low_n)[rows].mean()),
        }
        for name, rows in phases.items()
    }


if __name__ == "__main__":
    main()
