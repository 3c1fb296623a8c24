"""What system identification makes of arms with several effects: all static numbers at once.

    python benchmarks/gap_all_parameters.py --folder DIR [--minutes 20] [--write]

As `mujoco.sysid` does, least squares within bounds fit every number that can be off in a model
without a past: masses, tilt, stiffness, pretension, holes, springs and contact points of each
segment or cable, gains, offsets and crosstalk of sensors. No number is left out, so no cause is
named. `DIR` is the folder of arms with several effects that `gap_blind.py` has recorded twice and
diagnosed. Both fits are judged on the second recording; the simulation is the same in both.
"""

from __future__ import annotations

import json
import os
import time
from functools import partial
from pathlib import Path
from typing import Any

import harness
import numpy as np
from gap_blind import ARM, SETTLED_ROWS, in_pool
from scipy.optimize import least_squares

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator, amended_arm, counted_rows
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.scoring import read_answers
from cablesense_gap.settling import removed_on
from cablesense_gap.simulator import Term
from cablesense_sim.arm import open_arm
from cablesense_sim.effects.effect import WHOLE_ARM, Parameter
from cablesense_sim.effects.registry import known_effects

os.environ.setdefault("OMP_NUM_THREADS", "1")

RESULT = "gap_all_parameters.json"
MOST_EVALUATIONS = 30
DIFF_STEP = 1e-3
NOWHERE_N = 1e3
"""What numbers leave with which the arm finds no rest."""


def main() -> None:
    """Fits, predicts the second recordings and prints; keeps the figures with `--write`."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--folder", type=Path, required=True, help="of `gap_blind.py`")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further arm")
    options = parser.parse_args()
    answers = read_answers(options.folder / "answers" / "answers.csv")
    recordings = [options.folder / f"{answer.recording}.csv" for answer in answers]
    work = partial(_fitted, until=time.time() + 60.0 * options.minutes)
    cases = [case for case in in_pool(work, recordings, options.workers) if case]
    names = ("all_parameters", "diagnosis")
    result = {
        **harness.origin("scipy"),
        "arm": ARM,
        "numbers": len(_numbers(ArmSimulator(open_arm(ARM), _read(recordings[0])))),
        "arms": len(cases),
        **{
            f"removed_on_second_by_{name}": harness.percentiles(
                [case[name] for case in cases], ("5 %", "median", "95 %")
            )
            for name in names
        },
        "diagnosis_removes_more": sum(
            case["diagnosis"] > case["all_parameters"] for case in cases
        ),
        "seconds": harness.percentiles([case["seconds"] for case in cases], ("median", "worst")),
        "cases": cases,
    }
    harness.publish(RESULT, result, options)


def _read(path: Path) -> Any:
    return read_recording(path, open_arm(ARM))


def _numbers(simulator: ArmSimulator) -> dict[Term, Parameter]:
    """Sizes of effects without a past in each place, or of the whole arm where that is all."""
    effects = known_effects()
    found: dict[Term, Parameter] = {}
    for candidate in simulator.candidates:
        effect = effects[candidate.effect]
        if effect.acts_on not in ("load", "arm", "sensor") or effect.needs_time:
            continue
        pairs = any("_into_" in place for place in candidate.places)
        places = [p for p in candidate.places if (p == WHOLE_ARM) == pairs]
        for place in places or candidate.places:
            for term, parameter in zip(candidate.terms(place), candidate.parameters, strict=True):
                if parameter.role == "size":
                    found[term] = parameter
    return found


def _fitted(path: Path, until: float) -> dict[str, Any] | None:
    arm, kept = open_arm(ARM), path.with_name(f"{path.stem}.all_parameters.json")
    if not kept.exists():
        if time.time() > until:
            return None
        recording = _read(path)
        simulator = ArmSimulator(arm, recording)
        numbers = _numbers(simulator)
        nominal_n = simulator.predict([{}])[0]
        used = counted_rows(arm, recording, nominal_n)
        typical = np.array([p.typical for p in numbers.values()])
        low, high = np.array([[p.low, p.high] for p in numbers.values()]).T / typical

        def left(scaled: Array) -> Array:
            values = dict(zip(numbers, (scaled * typical).tolist(), strict=True))
            residual = recording.tensions_n - simulator.predict([values])[0]
            return np.nan_to_num(residual[used], nan=NOWHERE_N).ravel()

        began = time.monotonic()
        found = least_squares(
            left,
            np.clip(np.zeros(len(typical)), low + 1e-6, high - 1e-6),
            bounds=(low, high),
            diff_step=DIFF_STEP,
            max_nfev=MOST_EVALUATIONS,
        )
        seconds = time.monotonic() - began
        amended = amended_arm(arm, dict(zip(numbers, found.x * typical, strict=True)), {})
        again = _read(path.parent / "second" / path.name)
        removed = removed_on(again, arm, amended, SETTLED_ROWS, simulator.floor)
        rmse_n = float(np.sqrt((found.fun**2).mean()))
        kept.write_text(json.dumps([removed, rmse_n, seconds]))
    removed, rmse_n, seconds = json.loads(kept.read_text())
    return {
        "recording": path.stem,
        "all_parameters": round(removed, 3),
        "diagnosis": round(json.loads(path.with_name(f"{path.stem}.second.json").read_text()), 3),
        "left_n": round(rmse_n, 3),
        "seconds": round(seconds, 1),
    }


if __name__ == "__main__":
    main()
