"""Breathing on the independent plant: forces under friction, passive and after a breath.

    python benchmarks/breathing.py [--arms 32] [--write]

Cables stick rigidly at every guide and at a pulley of a quarter turn. Half of the arms are
straight and half bent by up to 8 degrees. They are loaded with 5 to 100 N on one segment; the load
is lowered, then removed. At each of these rests they breathe once. The shipped static model, of
the arm without friction, answers from one reading after the breath, with noise and step. The model
of contacts anywhere does the same without the place. The same course is also run without
breathing (`passive`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import harness
import numpy as np
import pandas as pd

from cablesense_base import Array
from cablesense_online.breathing import (
    SET_POINTS_A_TURN,
    Breath,
    BreathReadings,
    breath_circle,
    tip_m,
)
from cablesense_plants.arm.arm import ideal_arm
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.friction import PlantFriction
from cablesense_sim.arm import Arm, find_arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n
from cablesense_training.evaluation.metrics import angle_difference_deg
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

SEED = 20_261_122
FRICTIONS = (0.05, 0.10, 0.15)
TURN_S, SETTLE_S = 0.4, 0.5
_PULLEY_RAD, _BENT_DEG, _FORCES_N = np.pi / 2, 8.0, (5.0, 100.0)
_STEPS = 4
"""The steps of a load, and of a move."""


class Course:
    """B arms of the plant that are moved and loaded together; loads are theirs alone."""

    def __init__(self, name: str, coefficient: float, arms: int) -> None:
        self.arm = open_arm(name)
        drawn = ideal_arm(read_nominal(find_arm(name)))
        each = np.full(self.arm.cable_count, coefficient)
        self._plant = replace(drawn, friction=PlantFriction(each, pulley_rad=_PULLEY_RAD))
        self.rng = np.random.default_rng(SEED)
        self.base_rad = np.radians(_BENT_DEG) * self.rng.uniform(-1.0, 1.0, (arms, 8))
        self.base_rad[: arms // 2] = 0.0
        self._command_rad, self._forces_n = np.zeros((arms, 8)), np.zeros((arms, 4, 3))
        straight = self._command_rad, self._plant.held_m(self._command_rad), self._forces_n
        self._path = self._plant.path()
        self._states = [self._path.start(*each) for each in zip(*straight, strict=True)]
        overshot = 1.1 * self.base_rad + np.radians(0.5) * self.rng.uniform(-1.0, 1.0, (arms, 8))
        for pose in (overshot, self.base_rad):
            self._go(pose, self._forces_n)

    def step(self, command_rad: Array) -> None:
        """Go to commands (B, 8) at once."""
        self._command_rad = command_rad
        there = self._states, self._plant.held_m(command_rad), self._forces_n
        self._states = [self._path.advance(*each, 1.0) for each in zip(*there, strict=True)]

    def load(self, forces_n: Array) -> None:
        """Come to loads (B, 4, 3) step by step."""
        self._go(self._command_rad, forces_n)

    def _go(self, command_rad: Array, forces_n: Array) -> None:
        pose_rad, loads_n = self._command_rad, self._forces_n
        for share in np.linspace(0.0, 1.0, _STEPS + 1)[1:]:
            self._forces_n = loads_n + share * (forces_n - loads_n)
            self.step(pose_rad + share * (command_rad - pose_rad))

    def read_n(self) -> Array:
        """(B, M) readings."""
        sensed_n = np.array([state.sensed_n for state in self._states])
        return read_tensions_n(sensed_n, self.arm.sensors, self.rng)

    @property
    def tips_m(self) -> Array:
        """(B, 3) where the arms' ends are."""
        angles_rad = np.array([state.angles_rad for state in self._states])
        return tip_m(mechanism_of(self.arm), angles_rad)


class Breathing:
    """Breathes the arms of a course.

    Attributes:
        tip_mm: by how much tips went from their mean, of every turn that counted.
        took_s: from the beginning of a breath to the first reading that is corrected.
    """

    def __init__(self, course: Course, coefficient: float) -> None:
        """With the least circle that turns every guide."""
        parameters = {"coefficient": coefficient, "pulley_wrap_rad": _PULLEY_RAD}
        effect = {"effect": "capstan_friction", "at": "arm", "parameters": parameters}
        arm = Arm.model_validate(course.arm.model_dump() | {"effects": [effect]})
        self._course = course
        self.circles = [breath_circle(arm, base) for base in course.base_rad]
        self.tip_mm: list[float] = []
        self.took_s = 0.0

    def read_n(self) -> Array:
        """(B, M) one reading of each arm after a breath, corrected by it."""
        course, tick_s = self._course, TURN_S / SET_POINTS_A_TURN
        readings = [BreathReadings(SETTLE_S) for _ in self.circles]
        breaths = [Breath(circle, 1) for circle in self.circles]
        now_ns, tips = 1, []
        while not breaths[0].over:
            points = [breath.next() for breath in breaths]
            now_ns += round(tick_s * 1e9)
            turn = points[0][1]
            for reading in readings:
                reading.mark(turn, now_ns)
            course.step(course.base_rad + np.array([point for point, _ in points]))
            for reading, tensions in zip(readings, course.read_n(), strict=True):
                reading.without_friction(tensions.tolist(), now_ns)
            if turn > 0:
                tips.append(course.tips_m)
        away_m = np.linalg.norm(np.array(tips) - np.mean(tips, axis=0), axis=-1)
        self.tip_mm += (1e3 * away_m.max(axis=0)).tolist()
        while not all(reading.state.offset_n.size for reading in readings):
            now_ns += round(tick_s * 1e9)
            answers = [
                reading.without_friction(tensions.tolist(), now_ns)
                for reading, tensions in zip(readings, course.read_n(), strict=True)
            ]
        self.took_s = 1e-9 * now_ns
        return np.array(answers)


def errors(course: Course, read: Callable[[], Array], loads: int) -> dict[str, Any]:
    """Figures of one course, answered from `read` at every rest."""
    arms = len(course.base_rad)
    estimator = Estimator.load(find_model(course.arm.name), course.arm)
    anywhere = AnywhereEstimator.load(find_model(f"{course.arm.name}_anywhere"), course.arm)
    mechanism, rng = mechanism_of(course.arm), np.random.default_rng(SEED + 1)
    unloaded_n, rests, ghost_n = read(), [], []
    for _ in range(loads):
        segment, angle = rng.integers(1, 5, arms), rng.uniform(0.0, 360.0, arms)
        highest = rng.uniform(*_FORCES_N, arms)
        lower = np.maximum(_FORCES_N[0], highest * rng.uniform(0.2, 0.8, arms))
        for force in (highest, lower, np.zeros(arms)):
            course.load(normal_force_n(mechanism, course.base_rad, segment, angle, force))
            difference_n = read() - unloaded_n
            found = estimator.estimate_batch(difference_n, course.base_rad)
            touched = found.probabilities[:, 0] < 0.5
            if not force.any():
                ghost_n.append(np.where(touched, found.magnitude_n, 0.0).mean())
                continue
            likeliest = 1 + found.probabilities[:, 1:].argmax(axis=1)
            there, _ = anywhere.locate_batch(difference_n, course.base_rad)
            at_m, size_n = mechanism.contact_m[segment - 1], np.hypot(*there.force_n[:, 1:].T)
            figures = {
                "segment": segment,
                "right": touched & (likeliest == segment),
                "off_n": np.abs(found.magnitude_n - force),
                "off_deg": np.abs(angle_difference_deg(found.angle_deg, angle)),
                "located": there.segment == segment,
                "place_off_mm": 1e3 * np.abs(there.place_m - at_m),
                "off_there_n": np.abs(size_n - force),
            }
            rests.append(pd.DataFrame(figures))
    loaded = pd.concat(rests)
    far = loaded[loaded.located & (loaded.segment > 1)]  # on segment 1 only a moment is determined
    return {
        "anywhere": {
            "contact": float(loaded.located.mean()),
            "place_mm": harness.percentiles(far.place_off_mm, ["median", "95 %"]),
            "force_n": harness.percentiles(far.off_there_n, ["median", "95 %"]),
        },
        "samples": len(loaded),
        "contact": float(loaded.right.mean()),
        "force_mae_n": round(float(loaded.off_n.mean()), 3),
        "direction_mae_deg": round(float(loaded.off_deg.mean()), 3),
        "ghost_n": round(float(np.mean(ghost_n)), 3),
    }


def breathed(name: str, coefficient: float, options: Any) -> dict[str, Any]:
    """Figures of a course with breaths."""
    course = Course(name, coefficient, options.arms)
    breathing = Breathing(course, coefficient)
    found = errors(course, breathing.read_n, options.loads)
    joints_deg = np.degrees(max(circle.largest_rad for circle in breathing.circles))
    return found | {
        "took_s": round(breathing.took_s, 3),
        "joints_deg": round(float(joints_deg), 3),
        "tip_commanded_mm": round(1e3 * max(c.tip_m for c in breathing.circles), 3),
        "tip_mm": harness.percentiles(breathing.tip_mm, ["median", "95 %", "worst"]),
    }


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/breathing.json")
    parser.add_argument("--arms", type=int, default=32, help="side by side")
    parser.add_argument("--loads", type=int, default=2, help="of each arm")
    options = parser.parse_args()
    cases: list[dict[str, Any]] = []
    for name in ("cdsm", "cdsm_lab"):
        for coefficient in FRICTIONS:
            breath = breathed(name, coefficient, options)
            course = Course(name, coefficient, options.arms)
            passive = errors(course, course.read_n, options.loads)
            case = {"arm": name, "friction": coefficient}
            cases.append(case | {"breath": breath, "passive": passive})
    result = {"seed": SEED, "arms": options.arms, "cases": cases}
    harness.publish("breathing.json", result, options, "numpy")


if __name__ == "__main__":
    main()
