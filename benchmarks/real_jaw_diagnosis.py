"""What makes the recorded transmission differ from one without friction: verdict and its figures.

The search of `cablesense_gap` judges every explanation on levels of the brake that it was not
fitted to; here it is judged once more on recordings that took no part at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from real_jaw_mechanism import CANDIDATES, JawSimulator

from cablesense_base import Array
from cablesense_gap.diagnosis.probability import Ranked, bundled_calibration, posterior
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Term, parameters_of
from cablesense_gap.verdict import removed_fraction


def diagnose(problem: Problem) -> list[Ranked]:
    """Explanations of what the recordings differ by, the most probable first."""
    return posterior(search(problem), problem.floor, bundled_calibration())


def best_of(ranked: Sequence[Ranked]) -> Explanation:
    """The most probable explanation that can be simulated."""
    return next(r.explanation for r in ranked if r.explanation is not None)


def amended(fitted: Explanation) -> dict[Term, float]:
    """Effects and tolerances of an explanation."""
    return {**fitted.values, **fitted.tolerances}


def described(ranked: Sequence[Ranked], fitted_to: Problem, unseen: Problem) -> dict[str, Any]:
    """The verdict, its numbers, and how much of the gap on unseen recordings it removes.

    Sizes are root mean squares of the drive's torque, mN·m.
    """
    best, units = best_of(ranked), parameters_of(CANDIDATES)
    before = _left_mnm(unseen, {})
    return {
        "effects": ranked[0].effects,
        "probability": round(ranked[0].probability, 3),
        "numbers": {
            str(term): f"{value:.3g} ± {best.deviations[term]:.1g} {units[term].unit}"
            for term, value in best.values.items()
        },
        "gap before": before,
        "gap after": (after := _left_mnm(unseen, amended(best))),
        "removed": round(removed_fraction(before, after, 1e3 * unseen.floor), 3),
        "explanations": [
            {
                "effects": each.effects,
                "probability": round(each.probability, 3),
                "levels held out": round(1e3 * each.explanation.held_out_rmse, 2),
                "unseen": _left_mnm(unseen, amended(each.explanation)),
            }
            for each in ranked
            if each.explanation is not None
        ],
        "trials": len(fitted_to.fold),
        "unseen trials": len(unseen.fold),
    }


def loops_nm(problem: Problem, fitted: Explanation) -> tuple[Array, Array, Array, Array]:
    """Drive angles, and torques measured, nominal and amended, each (N, T)."""
    simulator = problem.simulator
    assert isinstance(simulator, JawSimulator)
    angle = simulator.rows("drive_angle_rad")
    torques = (problem.readings, *(simulator.predict([v])[0] for v in ({}, amended(fitted))))
    measured, nominal, after = (t.reshape(angle.shape) for t in torques)
    return angle, measured, nominal, after


def _left_mnm(problem: Problem, values: dict[Term, float]) -> float:
    left = (problem.readings - problem.simulator.predict([values])[0])[problem.used]
    return round(1e3 * float(np.sqrt((left**2).mean())), 2)
