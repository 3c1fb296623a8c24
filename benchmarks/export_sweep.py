"""Which arms `cablesense export` accepts, and how well their estimators hold on fresh readings.

    python benchmarks/export_sweep.py [--count 200] [--seed 6101] [--samples 800] [--write]

Arms are drawn: 2 to 5 segments of 60 to 400 mm with 3 or 4 cables each of 1 kN/m to 10 MN/m, spans
across the joints of 12 to 80 mm, routing radii of 15 to 80 mm, pretensions of 10 to 200 N, and
springs of 0.1 to 200 N·m/rad in some joints. An arm is refused with a reason, or accepted by the
check of the export (`cablesense_training.law_check`). The estimator of an accepted one is judged
on poses, contacts and noise of another seed. Its bound is what it states of its own errors. Errors
of the moment are also given over the Cramér-Rao bound, which no estimator reaches that allows for
torsion by friction, as this one does.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import harness
import numpy as np
from rich.progress import track

from cablesense_base import CableSenseError
from cablesense_sim.arm import Arm
from cablesense_training.evaluation.law import evaluate_exact, law_protocol
from cablesense_training.law.build import TorchLaw
from cablesense_training.law_check import MOST_OVER_BOUND, check_law, require_sound

SPRING_SHARE = 0.4
"""Of the joints."""


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number of which the logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def drawn_arm(rng: np.random.Generator, number: int) -> Arm:
    """An arm of a plausible size; whether it can stand is not asked.

    Raises:
        ArmFileError: the numbers do not make an arm.
    """
    segments = int(rng.integers(2, 6))
    cables = int(rng.integers(3, 5))
    length_m = between(rng, 0.06, 0.4)
    radius_m = between(rng, 0.015, 0.08)
    plate_offset_m = min(between(rng, 0.006, 0.04), 0.3 * length_m)
    description: dict[str, Any] = {
        "name": f"drawn_{number}",
        "gravity_m_s2": [0.0, 0.0, -9.81],
        "segments": {
            "count": segments,
            "length_m": length_m,
            "mass_kg": between(rng, 0.03, 1.0),
            "plate_offset_m": plate_offset_m,
            "contact_m": 0.5 * length_m,
        },
        "cables": {
            "per_segment": cables,
            "routing_radius_m": radius_m,
            "angle_deg": {
                "first": 0.0,
                "per_segment": 360.0 / (segments * cables),
                "per_cable": -360.0 / cables,
            },
            "stiffness_n_m": between(rng, 1e3, 1e7),
            "pretension_n": between(rng, 10.0, 200.0),
            "run_m": 0.2,
        },
        "actuators": {"kind": "position", "kp_n_m": float("inf")},
        "sensors": {
            "place": "actuator end",
            "rate_hz": 100.0,
            "noise_std_n": between(rng, 0.01, 0.3),
            "step_n": float(rng.choice([0.0, 0.05, 0.2])),
        },
    }
    sprung = np.flatnonzero(rng.random(segments) < SPRING_SHARE) + 1
    description["effects"] = [
        {
            "effect": "joint_elasticity",
            "at": f"joint_{joint}",
            "parameters": {"stiffness_n_m_rad": between(rng, 0.1, 200.0)},
        }
        for joint in sprung
    ]
    return Arm.model_validate(description)


def judged(number: int, given: argparse.Namespace) -> dict[str, Any]:
    """One arm: the reason why it was refused, or the figures of its estimator."""
    arm = drawn_arm(np.random.default_rng([given.seed, number]), number)
    law = TorchLaw(arm)
    try:
        require_sound(law, arm)
    except CableSenseError as refusal:
        return {"arm": number, "refused": str(refusal)}
    fresh = check_law(law, arm, given.samples, seed=given.seed + 1)
    protocol = law_protocol(arm, given.samples)
    exact = evaluate_exact(law, arm, protocol, seed=given.seed + 2).touched
    return {
        "arm": number,
        "over_stated_bound": round(fresh.worst, 3),
        "moment_over_cramer_rao": round(exact.moment_n_m.median_over_bound, 3),
        "false_contacts": round(fresh.false_contacts, 4),
        "answered": round(fresh.answered, 3),
    }


def main() -> int:
    """Draws arms, checks and judges, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "export_sweep.json")
    options.add_argument("--count", type=int, default=200, help="of arms")
    options.add_argument("--seed", type=int, default=6101, help="of arms, contacts and noise")
    options.add_argument("--samples", type=int, default=800, help="that judge an accepted one")
    given = options.parse_args()
    arms = [judged(number, given) for number in track(range(given.count), "arms")]
    refused = [arm for arm in arms if "refused" in arm]
    accepted = [arm for arm in arms if "refused" not in arm]
    cannot_stand = [arm for arm in refused if "cannot stand" in arm["refused"]]
    over_stated = [arm["over_stated_bound"] for arm in accepted]
    over_cramer_rao = [arm["moment_over_cramer_rao"] for arm in accepted]
    names = ("median", "95 %", "worst")
    result = {
        "arms": given.count,
        "accepted": len(accepted),
        "refused": len(refused),
        "refused_as_they_cannot_stand": len(cannot_stand),
        "over_stated_bound": harness.percentiles(over_stated, names),
        "moment_over_cramer_rao": harness.percentiles(over_cramer_rao, names),
        "false_contacts": harness.percentiles([arm["false_contacts"] for arm in accepted], names),
        "reasons": [arm for arm in refused if arm not in cannot_stand],
        "bars": {
            f"no accepted one worse than {MOST_OVER_BOUND:g} times what it states": max(
                over_stated
            )
            <= MOST_OVER_BOUND,
            f"no moment worse than {MOST_OVER_BOUND:g} times the Cramér-Rao bound": max(
                over_cramer_rao
            )
            <= MOST_OVER_BOUND,
        },
    }
    return harness.publish("export_sweep.json", result, given, "numpy", "torch")


if __name__ == "__main__":
    sys.exit(main())
