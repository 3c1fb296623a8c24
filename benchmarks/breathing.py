"""Breathing on the independent plant: forces under friction, passive and after a breath.

    python benchmarks/breathing.py [--folder DIR] [--arms 32] [--write]

Cables stick rigidly at every guide and at a pulley of a quarter turn. Half of the arms are
straight and half bent by up to 8 degrees. They are loaded with 5 to 100 N on one segment; the load
is lowered, then removed. At each of these rests they breathe once. The law of the arm, whose file
lists the friction, answers from one reading after the breath, with noise and step. The same course
is also run without breathing (`passive`): answers then rest on how readings have changed since the
untouched arm rested in the same pose. Errors are of what is stated, `contact` or `moment`; stated
95 % intervals hold or do not.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
import pandas as pd
from estimation_settings import estimation_settings
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState, Judge
from cablesense_online.breath_readings import BreathState, Mark, after_reading
from cablesense_online.breathing import SET_POINTS_A_TURN, Breath, breath_circle, tip_m
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_online.tare import with_reading
from cablesense_plants.arm.arm import ideal_arm
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.friction import PlantFriction
from cablesense_sim.arm import Arm, find_arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n
from cablesense_training.law.build import TorchLaw

Ints = NDArray[np.int64]

SEED = 20_261_122
ARMS = ("cdsm", "cdsm_lab")
FRICTIONS = (0.05, 0.10, 0.15)
TURN_S = 0.4
SETTLE_S = 0.5
_PULLEY_RAD = np.pi / 2
_BENT_DEG = 8.0
_FORCES_N = (5.0, 100.0)
_STEPS = 4
"""The steps of a load, and of a move."""
STATED = (ContactState.CONTACT, ContactState.MOMENT)


class Course:
    """B arms of the plant that are moved and loaded together; loads are theirs alone."""

    def __init__(self, name: str, coefficient: float, arms: int) -> None:
        self.arm = open_arm(name)
        drawn = ideal_arm(read_nominal(find_arm(name)))
        coefficients = np.full(self.arm.cable_count, coefficient)
        self._plant = replace(drawn, friction=PlantFriction(coefficients, pulley_rad=_PULLEY_RAD))
        self.rng = np.random.default_rng(SEED)
        self.base_rad = np.radians(_BENT_DEG) * self.rng.uniform(-1.0, 1.0, (arms, 8))
        self.base_rad[: arms // 2] = 0.0
        self._command_rad = np.zeros((arms, 8))
        self._forces_n = np.zeros((arms, 4, 3))
        straight = self._command_rad, self._plant.held_m(self._command_rad), self._forces_n
        self._path = self._plant.path()
        self._states = [self._path.start(*each) for each in zip(*straight, strict=True)]
        overshot = 1.1 * self.base_rad + np.radians(0.5) * self.rng.uniform(-1.0, 1.0, (arms, 8))
        for pose in (overshot, self.base_rad):
            self._go(pose, self._forces_n)

    def step(self, command_rad: Array) -> None:
        """Go to commands (B, 8) at once."""
        self._command_rad = command_rad
        moves = self._states, self._plant.held_m(command_rad), self._forces_n
        self._states = [self._path.advance(*each, 1.0) for each in zip(*moves, strict=True)]

    def load(self, forces_n: Array) -> None:
        """Come to loads (B, 4, 3) step by step."""
        self._go(self._command_rad, forces_n)

    def _go(self, command_rad: Array, forces_n: Array) -> None:
        pose_rad = self._command_rad
        loads_n = self._forces_n
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


def with_friction(arm: Arm, coefficient: float) -> Arm:
    """An arm whose file lists the friction of the course."""
    parameters = {"coefficient": coefficient, "pulley_wrap_rad": _PULLEY_RAD}
    effect = {"effect": "capstan_friction", "at": "arm", "parameters": parameters}
    return Arm.model_validate(arm.model_dump() | {"effects": [effect]})


class Breathing:
    """Breathes the arms of a course.

    Attributes:
        tip_mm: by how much tips went from their mean, of every turn that counted.
        took_s: from the beginning of a breath to the first reading that is corrected.
    """

    def __init__(self, course: Course, arm: Arm) -> None:
        """With the least circle that turns every guide of an arm with friction."""
        self._course = course
        self.circles = [breath_circle(arm, base) for base in course.base_rad]
        self.tip_mm: list[float] = []
        self.took_s = 0.0

    def read_n(self) -> Array:
        """(B, M) one reading of each arm after a breath, corrected by it."""
        course = self._course
        tick_s = TURN_S / SET_POINTS_A_TURN
        states = [BreathState() for _ in self.circles]
        breaths = [Breath(circle, 1) for circle in self.circles]
        now_ns = 1
        tips = []
        while not breaths[0].over:
            points = [breath.next() for breath in breaths]
            now_ns += round(tick_s * 1e9)
            turn = points[0][1]
            states = [state.marked(Mark(turn, now_ns)) for state in states]
            course.step(course.base_rad + np.array([point for point, _ in points]))
            states, _ = _after_readings(states, course.read_n(), now_ns)
            if turn > 0:
                tips.append(course.tips_m)
        away_m = np.linalg.norm(np.array(tips) - np.mean(tips, axis=0), axis=-1)
        self.tip_mm += (1e3 * away_m.max(axis=0)).tolist()
        while not all(state.offset_n.size for state in states):
            now_ns += round(tick_s * 1e9)
            states, answers = _after_readings(states, course.read_n(), now_ns)
        self.took_s = 1e-9 * now_ns
        return np.array(answers)


def _after_readings(
    states: Sequence[BreathState], readings_n: Array, now_ns: int
) -> tuple[list[BreathState], list[Sequence[float] | None]]:
    """The states of breaths after readings (B, M), and the tensions to answer from."""
    settle_ns = round(SETTLE_S * 1e9)
    next_states = []
    freed_n = []
    for state, reading_n in zip(states, readings_n.tolist(), strict=True):
        next_state, tensions_n = after_reading(state, reading_n, now_ns, settle_ns)
        next_states.append(next_state)
        freed_n.append(tensions_n)
    return next_states, freed_n


class Answered(NamedTuple):
    """Answers to one reading of each of B arms, judged.

    Attributes:
        state: (B,) of `ContactState`.
        segment: (B,) of the likeliest contact, from 1 on.
        place_m, size_n: (B,) of it: from the joint centre, and its lateral force.
        region_m, interval_n: (B, 2) with 95 %: the place from the first joint centre on, and the
            lateral force.
    """

    state: list[ContactState]
    segment: Ints
    place_m: Array
    size_n: Array
    region_m: Array
    interval_n: Array


class Estimates:
    """Answers the arms of a course by the law of an arm whose file lists their friction.

    Each is tared unloaded at its pose. Readings that no breath has freed from friction are
    answered by how they have changed since the untouched arm rested there.
    """

    def __init__(
        self, course: Course, arm: Arm, read: Callable[[], Array], *, freed: bool
    ) -> None:
        self._course = course
        self._read = read
        self._freed = freed
        self._law = TorchLaw(arm)
        self._judge = Judge(FeltArm(arm))
        self._still = np.zeros((arm.joint_count, arm.joint_count))
        settings = estimation_settings()
        self._unloaded = CalibratedArm(FeltArm(arm), self._law, settings)
        self._states = []
        readings = [read() for _ in range(1 if freed else settings.tare_samples)]
        for number, base_rad in enumerate(course.base_rad):
            state = self._unloaded.at(self._unloaded.begin(), base_rad)
            untouched_n = [
                readings[k % len(readings)][number] for k in range(settings.tare_samples)
            ]
            for reading_n in untouched_n:
                state = with_reading(state, reading_n.tolist(), settings.tare_samples)
            state = self._unloaded.taken(state, 0)
            for reading_n in untouched_n:
                state = self._unloaded.with_untouched(state, reading_n)
            self._states.append(state)

    def answered(self) -> Answered:
        """What is stated of the next reading of each arm."""
        readings_n = self._read()
        answers = []
        for number, base_rad in enumerate(self._course.base_rad):
            answers.append(self._answer(number, readings_n[number], base_rad))
        states, *numbers = zip(*answers, strict=True)
        return Answered(list(states), *(np.array(column) for column in numbers))

    def _answer(self, number: int, reading_n: Array, base_rad: Array) -> tuple[Any, ...]:
        self._states[number], belief = self._unloaded.belief(
            self._states[number], reading_n, 0, freed=self._freed
        )
        seen = self._law(
            reading_n[None], base_rad[None], belief.mean, belief.covariance, self._still
        )
        judgement = self._judge(seen, reading_n)
        return (
            judgement.state,
            judgement.segment,
            float(seen.place_m[0]),
            float(np.hypot(*seen.force_n[0, 1:])),
            seen.region_m[0],
            seen.magnitude_ci95_n[0],
        )


def errors(course: Course, estimates: Estimates, loads: int) -> dict[str, Any]:
    """Figures of one course, answered at every rest."""
    arms = len(course.base_rad)
    mechanism = mechanism_of(course.arm)
    joint_m = np.concatenate([[0.0], np.cumsum(mechanism.segment_length_m)[:-1]])
    rng = np.random.default_rng(SEED + 1)
    rests = []
    untouched: list[ContactState] = []
    ghosts_n = []
    for _ in range(loads):
        segment = rng.integers(1, 5, arms)
        angle = rng.uniform(0.0, 360.0, arms)
        highest = rng.uniform(*_FORCES_N, arms)
        lower = np.maximum(_FORCES_N[0], highest * rng.uniform(0.2, 0.8, arms))
        for force in (highest, lower, np.zeros(arms)):
            course.load(normal_force_n(mechanism, course.base_rad, segment, angle, force))
            estimated = estimates.answered()
            if not force.any():
                untouched += estimated.state
                stated = [state in STATED for state in estimated.state]
                ghosts_n.append(np.where(stated, estimated.size_n, 0.0).max())
                continue
            along_m = joint_m[segment - 1] + mechanism.contact_m[segment - 1]
            estimated_m = joint_m[estimated.segment - 1] + estimated.place_m
            low_n, high_n = estimated.interval_n.T
            low_m, high_m = estimated.region_m.T
            figures = {
                "state": [state.value for state in estimated.state],
                "stated": [state in STATED for state in estimated.state],
                "segment": segment,
                "right": estimated.segment == segment,
                "off_n": np.abs(estimated.size_n - force),
                "off_mm": 1e3 * np.abs(estimated_m - along_m),
                "half_n": 0.5 * (high_n - low_n),
                "force_holds": (low_n <= force) & (force <= high_n),
                "place_holds": (low_m <= along_m) & (along_m <= high_m),
            }
            rests.append(pd.DataFrame(figures))
    loaded = pd.concat(rests)
    stated = loaded[loaded.stated]
    far = stated[stated.segment > 1]  # on segment 1 only a moment is determined
    names = ["median", "95 %"]
    return {
        "samples": len(loaded),
        "states": dict(loaded.state.value_counts().sort_index().items()),
        "segment_right": _share(stated.right),
        "place_mm": harness.percentiles(far.off_mm, names),
        "force_n": harness.percentiles(far.off_n, names),
        "half_width_n": harness.percentiles(far.half_n, names),
        "force_holds": _share(stated.force_holds),
        "place_holds": _share(stated.place_holds),
        "force_holds_of_all": _share(loaded.force_holds),
        "untouched_free": _share(pd.Series([state is ContactState.FREE for state in untouched])),
        "ghost_at_most_n": round(float(np.max(ghosts_n)), 3),
    }


def _share(true: pd.Series) -> float | None:
    return round(float(true.mean()), 4) if len(true) else None


def breathed(name: str, coefficient: float, options: Any) -> dict[str, Any]:
    """Figures of a course with breaths."""
    course = Course(name, coefficient, options.arms)
    arm = with_friction(course.arm, coefficient)
    breathing = Breathing(course, arm)
    estimates = Estimates(course, arm, breathing.read_n, freed=True)
    error_figures = errors(course, estimates, options.loads)
    joints_deg = np.degrees(max(circle.largest_rad for circle in breathing.circles))
    return error_figures | {
        "took_s": round(breathing.took_s, 3),
        "joints_deg": round(float(joints_deg), 3),
        "tip_commanded_mm": round(1e3 * max(c.tip_m for c in breathing.circles), 3),
        "tip_mm": harness.percentiles(breathing.tip_mm, ["median", "95 %", "worst"]),
    }


def passive(name: str, coefficient: float, options: Any) -> dict[str, Any]:
    """Figures of the same course without breaths."""
    course = Course(name, coefficient, options.arms)
    arm = with_friction(course.arm, coefficient)
    estimates = Estimates(course, arm, course.read_n, freed=False)
    return errors(course, estimates, options.loads)


def compared(name: str, coefficient: float, options: Any) -> dict[str, Any]:
    """Figures of one arm and friction, with breaths and without."""
    return {
        "arm": name,
        "friction": coefficient,
        "breath": breathed(name, coefficient, options),
        "passive": passive(name, coefficient, options),
    }


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/breathing.json")
    parser.add_argument("--arms", type=int, default=32, help="side by side")
    parser.add_argument("--loads", type=int, default=2, help="of each arm")
    parser.add_argument("--folder", type=Path, help="of cases; goes on there")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="breathing_"))
    folder.mkdir(parents=True, exist_ok=True)
    cases = []
    for name, coefficient in product(ARMS, FRICTIONS):
        path = folder / f"{name}_{coefficient:.2f}.json"
        cases.append(harness.kept(path, partial(compared, name, coefficient, options)))
    result = {"seed": SEED, "arms": options.arms, "cases": cases}
    harness.publish("breathing.json", result, options, "numpy")


if __name__ == "__main__":
    main()
