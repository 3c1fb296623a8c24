"""Estimators along sequences: in motion and at rest, history-dependent or not, under friction.

    python benchmarks/temporal.py --arm cdsm_friction [--write]

Fresh sequences of commands and contacts, seeds that no training has seen, sensor noise on.
Memoryless estimators get the set-point at every tick, which is more than the node gives them:
there they are silent until the arm rests again. Without friction a long sequence shows whether
the state stays right. Stated intervals are judged under a load and after it, as friction hides
most of it then.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any, NamedTuple

import harness
import numpy as np
from numpy.typing import NDArray

from cablesense_base.progress import progress_bar
from cablesense_sim.arm import open_arm
from cablesense_training.data.sequences import MotionProtocol, Sequences, draw_sequences
from cablesense_training.evaluation.metrics import ContactAnswer, SequenceMetrics, sequence_metrics
from cablesense_training.inference.estimator import Estimates, SequenceEstimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import open_estimator

SEED, LONG_SEED = 7_000_001, 7_000_002
LONG_S = 300.0
RELEASED_S = 2.0


class SequenceCase(NamedTuple):
    """The number of sequences of an arm, and its estimators by their names in the table.

    Under friction there are more: an interval's share is judged by its contacts, not its ticks.
    """

    sequences: int
    estimators: dict[str, str]
    long: bool = False


CASES = {
    # without friction, in time by MuJoCo: it has inertia and swings
    "cdsm": SequenceCase(
        16, {"temporal (shipped)": "cdsm_moving", "statics (shipped)": "cdsm"}, long=True
    ),
    # from rest to rest
    "cdsm_friction": SequenceCase(
        24,
        {
            "simulated beside (shipped)": "cdsm_friction_simulated",
            "temporal (shipped)": "cdsm_friction",
            "statics of the arm without friction": "cdsm",
        },
    ),
}


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/temporal_*")
    parser.add_argument("--arm", choices=CASES, required=True)
    parser.add_argument("--workers", type=int, default=2, help="processes that simulate")
    options = parser.parse_args()
    protocol = MotionProtocol()
    result: dict[str, Any] = {
        "seeds": [SEED, LONG_SEED],
        "protocol": asdict(protocol),
        "arms": {options.arm: _arm(options.arm, protocol, options.workers)},
    }
    harness.publish(f"temporal_{options.arm}.json", result, options)


def _arm(arm: str, protocol: MotionProtocol, workers: int) -> dict[str, Any]:
    case = CASES[arm]
    sequences = _drawn(arm, replace(protocol, sequences=case.sequences), SEED, workers)
    long = None
    if case.long:
        long = _drawn(arm, replace(protocol, sequences=1, duration_s=LONG_S), LONG_SEED, workers)
    metrics: dict[str, Any] = {}
    for name, model in case.estimators.items():
        estimator = open_estimator(find_model(model))
        found = estimator.estimate_sequences(sequences)
        answer = ContactAnswer.of(found)
        metrics[name] = _plain(sequence_metrics(answer, sequences))
        metrics[name]["intervals95"] = _intervals(found, sequences)
        followed = _moved_before(sequences)
        if sequences.arm.effects and isinstance(estimator, SequenceEstimator) and followed.any():
            told = answer.select(np.repeat(followed, sequences.segment.shape[1]))
            part = _plain(sequence_metrics(told, sequences.select(followed)))
            metrics[f"{name}, where it ran before the arm moved"] = part
        if long is not None:
            told = ContactAnswer.of(estimator.estimate_sequences(long))
            # where nothing is answered, the whole force is the error
            off_n = np.abs(told.force_n - long.magnitude_n.ravel())
            tenths = [float(part.mean()) for part in np.array_split(off_n, 10)]
            metrics[name]["by_tenth_of_the_long_courses"] = tenths
        metrics[name]["trained by"] = estimator.metadata.command
    return {"sequences": len(sequences), "estimators": metrics}


def _moved_before(sequences: Sequences) -> NDArray[np.bool_]:
    """(S,) whether the estimator has all commands, and not only those after a late start."""
    before = sequences.before_rad
    return np.asarray(np.abs(before - before[:, -1:]).max((1, 2)) > 0.0)


def _drawn(arm: str, protocol: MotionProtocol, seed: int, workers: int) -> Sequences:
    with progress_bar(protocol.sequences, shown=True, what=f"sequences of {arm}") as advance:
        return draw_sequences(open_arm(arm), protocol, seed, workers=workers, on_done=advance)


def _plain(metrics: SequenceMetrics) -> dict[str, Any]:
    plain = asdict(metrics)
    for part in ("every", "moving", "rest"):
        for bulky in ("confusion", "bins"):
            del plain[part][bulky]
        errors = plain[part]["errors"]
        plain[part]["errors"] = {k: v if np.isfinite(v) else None for k, v in errors.items()}
    return plain


def _intervals(found: Estimates, sequences: Sequences) -> dict[str, dict[str, float]]:
    """Share of the 95 % intervals of the force that hold it, and half their mean width, N.

    The interval begins at 0 N where no contact is answered, as a force may be hidden.
    """
    low = np.where(found.segment > 0, found.low_n, 0.0).ravel()
    high = found.high_n.ravel()
    force, touched = sequences.magnitude_n, sequences.segment > 0
    since = round(RELEASED_S / sequences.protocol.tick_s)
    padded = np.pad(touched, ((0, 0), (since, 0)))
    lately = np.lib.stride_tricks.sliding_window_view(padded, since + 1, axis=1).any(-1)
    phases = {
        "all": np.ones_like(touched),
        "touched": touched,
        f"within {RELEASED_S:g} s of a release": lately & ~touched,
        "untouched for longer": ~lately,
    }
    holds = (low <= force.ravel()) & (force.ravel() <= high)
    return {
        name: {
            "share": float(rows.mean()),
            "coverage95": float(holds[rows.ravel()].mean()),
            "half_width_n": float(0.5 * (high - low)[rows.ravel()].mean()),
        }
        for name, rows in phases.items()
        if rows.any()
    }


if __name__ == "__main__":
    main()
