"""Arms as a workshop builds them: which readings are answered, and whether intervals hold.

    python benchmarks/built_arms.py [--arms 40] [--poses 20] [--case NAME …] [--seed 9501] [--write]

The truth is the independent plant (`cablesense_plants.arm.built`): each arm has errors of its own,
drawn by a workshop's tolerances. It is tared straight, or commissioned in 25 unloaded poses; then
it is touched in other poses within 10 degrees, by contacts of 5 to 40 N anywhere on the segments,
with an axial part of up to 0.3 of the lateral force. A statement is vouched for if the state is
`contact` or `moment`; it is wrong if the lateral force is off by more than 5 N and a fifth, or the
segment is another one (next to a joint the neighbour's end is the same place).
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import harness
import numpy as np
from rich.progress import track

from cablesense_base import Array
from cablesense_contact.calibration import Calibration, CalibrationError, Calibrator, Unloaded
from cablesense_contact.judgement import ContactState, Judge, Judgement
from cablesense_contact.law import LawOutput
from cablesense_plants.arm.body import Nominal, read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_plants.cases import PlantError
from cablesense_sim.arm import Arm, open_arm, parse_arm
from cablesense_training.law.build import TorchLaw

TARE_SAMPLES = 50
COMMISSIONED_POSES = 25
BEND_RAD = float(np.deg2rad(10.0))
FORCES_N = (5.0, 40.0)
AXIAL_SHARE = 0.3
WRONG_N, WRONG_SHARE = 5.0, 0.2
SAME_PLACE_M = 0.02
"""Next to a joint the neighbour's end is the same place."""
CONTACTS_AT_A_POSE = 4
UNTOUCHED_AT_A_POSE = 2


@dataclass(frozen=True)
class Case:
    """One row of the table.

    Attributes:
        errors: of the built arms, as multiples of the stated tolerances.
        poses: unloaded poses that it is calibrated by; 1 is a tare straight.
        friction: whether the file leaves friction to be expected, as it does by default.
        fault: changes readings (…, M) of the calibrated arm, with a random generator.
        broken: makes an arm differ from its file in another way than by tolerances.
    """

    errors: float = 1.0
    poses: int = 1
    friction: bool = False
    fault: Callable[[Array, np.random.Generator], Array] | None = None
    broken: Callable[[BuiltArm, np.random.Generator], BuiltArm] | None = None


CASES = {
    "well, tare": Case(),
    "well, 25 poses": Case(poses=COMMISSIONED_POSES),
    "three times, 25 poses": Case(errors=3.0, poses=COMMISSIONED_POSES),
}


def five_by_four() -> tuple[Arm, Path]:
    """The arm of five segments and four cables each, and its file."""
    path = Path(__file__).parent / "arms" / "five_by_four.yaml"
    return parse_arm(path.read_text(), str(path)), path


def on_axis(arm: Arm) -> Arm:
    """The arm that is touched on its axis, with any axial force."""
    touch = arm.touch.model_copy(update={"radius_m": 0.0, "friction": 0.0})
    return arm.model_copy(update={"touch": touch})


@dataclass(frozen=True)
class Touched:
    """One sample: what acts on the arm, and what is stated."""

    push: Push | None
    force_n: Array  # (3,) along the axes of the touched segment at the command
    output: LawOutput
    judgement: Judgement


class Bench:
    """One file, its law, and arms built by it."""

    def __init__(self, arm: Arm, nominal: Nominal) -> None:
        self.arm = arm
        self.nominal = nominal
        self.law = TorchLaw(arm)
        self.calibrator = Calibrator(arm, self.law)
        self.judge = Judge(arm)
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))
        self.length_m = nominal.length_m

    def calibrated(
        self, built: BuiltArm, poses: int, rng: np.random.Generator
    ) -> Calibration:
        """By unloaded readings: straight, then in random poses."""
        commands = np.zeros((poses, self.arm.joint_count))
        commands[1:] = rng.uniform(-BEND_RAD, BEND_RAD, commands[1:].shape)
        tensions = built.rests(commands, [()] * poses).tensions_n
        unloaded = [
            Unloaded(mean_reading(built, tension_n, rng), command, TARE_SAMPLES)
            for tension_n, command in zip(tensions, commands, strict=True)
        ]
        return self.calibrator.from_poses(unloaded)

    def samples(
        self,
        built: BuiltArm,
        calibration: Calibration,
        poses: int,
        rng: np.random.Generator,
        fault: Callable[[Array, np.random.Generator], Array] | None = None,
    ) -> list[Touched]:
        """Contacts and untouched readings in random poses."""
        commands, pushes, forces = [], [], []
        for _ in range(poses):
            command = rng.uniform(-BEND_RAD, BEND_RAD, self.arm.joint_count)
            for k in range(CONTACTS_AT_A_POSE + UNTOUCHED_AT_A_POSE):
                push, force_n = None, np.zeros(3)
                if k < CONTACTS_AT_A_POSE:
                    push, force_n = self.drawn_push(built, command, rng)
                commands.append(command)
                pushes.append(() if push is None else (push,))
                forces.append(force_n)
        rests, kept = borne(built, np.array(commands), pushes)
        readings = built.read(rests, rng)
        if fault is not None:
            readings = np.array([fault(reading, rng) for reading in readings])
        commands = np.array(commands)[kept]
        moved = self.calibrator.moved(calibration)
        output = self.law(readings, commands, moved.mean, moved.covariance, self._unrest)
        return [
            Touched(
                push=(pushes[k] or (None,))[0],
                force_n=forces[k],
                output=(row := output.row(i)),
                judgement=self.judge(row, readings[i]),
            )
            for i, k in enumerate(kept)
        ]

    def drawn_push(
        self, built: BuiltArm, command_rad: Array, rng: np.random.Generator
    ) -> tuple[Push, Array]:
        """One contact on the axis, anywhere, and its force along the segment's axes."""
        n = int(rng.integers(self.arm.segment_count))
        size_n = rng.uniform(*FORCES_N)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        axial_n = size_n * rng.uniform(-AXIAL_SHARE, AXIAL_SHARE)
        force_n = np.array([axial_n, size_n * np.sin(angle), size_n * np.cos(angle)])
        place_m = rng.uniform(0.0, self.length_m[n])
        return Push(n + 1, place_m, built.axes(command_rad)[n] @ force_n), force_n


def borne(
    built: BuiltArm, commands: Array, pushes: Sequence[Sequence[Push]]
) -> tuple[Array, list[int]]:
    """Tensions (K, M) of the rows that the arm bears, and their positions."""
    try:
        return built.rests(commands, pushes).tensions_n, list(range(len(commands)))
    except PlantError:
        tensions, kept = [], []
        for k, (command, pushed) in enumerate(zip(commands, pushes, strict=True)):
            try:
                tensions.append(built.tensions_n(command, pushed))
            except PlantError:
                continue
            kept.append(k)
        return np.array(tensions), kept


def mean_reading(built: BuiltArm, tension_n: Array, rng: np.random.Generator) -> Array:
    """(M,) mean of the readings of a tare."""
    return built.read(np.tile(tension_n, (TARE_SAMPLES, 1)), rng).mean(axis=0)


def figures(samples: Sequence[Touched], length_m: Array) -> dict[str, Any]:
    """What the samples of a case come to."""
    joint_m = np.concatenate([[0.0], np.cumsum(length_m)[:-1]])
    untouched = [s for s in samples if s.push is None]
    touched = [s for s in samples if s.push is not None]
    states = {s: 0 for s in ContactState}
    for s in touched:
        states[s.judgement.state] += 1
    free = np.array([s.judgement.state is ContactState.FREE for s in untouched])
    stated = [s for s in touched if s.judgement.state in (ContactState.CONTACT, ContactState.MOMENT)]
    rows = [errors_of(s, joint_m) for s in stated]
    outer = [r for r in rows if r["segment"] > 1]
    share: Callable[[str, list[dict[str, Any]]], float] = lambda key, among: (
        round(float(np.mean([r[key] for r in among])), 4) if among else float("nan")
    )
    median: Callable[[str, list[dict[str, Any]]], float] = lambda key, among: (
        round(float(np.median([r[key] for r in among])), 4) if among else float("nan")
    )
    doubts = Counter(re.sub(r"\d+(\.\d+)?", "#", s.judgement.doubt) for s in touched)
    print(doubts.most_common(12))
    return {
        "touched": len(touched),
        "states": {state.value: count for state, count in states.items() if count},
        "answered": round(len(stated) / max(len(touched), 1), 4),
        "untouched free": round(float(free.mean()), 4) if len(free) else None,
        "untouched states": dict(Counter(s.judgement.state.value for s in untouched)),
        "place mm": median("place_mm", outer),
        "force n": median("force_n", outer),
        "half-width force n": median("half_n", outer),
        "place holds": share("place_holds", rows),
        "force holds": share("force_holds", rows),
        "wrong": int(sum(r["wrong"] for r in rows)),
    }


def errors_of(sample: Touched, joint_m: Array) -> dict[str, Any]:
    """Errors of one statement."""
    push, output = sample.push, sample.output
    assert push is not None
    segment = sample.judgement.segment
    lateral_n = float(np.hypot(*sample.force_n[1:]))
    along_m = joint_m[push.segment - 1] + push.place_m
    stated_m = joint_m[segment - 1] + output.place_m[0]
    low_m, high_m = output.region_m[0]
    low_n, high_n = output.magnitude_ci95_n[0]
    same = segment == push.segment
    near = same or abs(stated_m - along_m) < SAME_PLACE_M or low_m <= along_m <= high_m
    off_n = float(np.hypot(*(output.force_n[0, 1:] - sample.force_n[1:])))
    if sample.judgement.state is ContactState.MOMENT:
        wrong = not near
    else:
        wrong = not near or off_n > max(WRONG_N, WRONG_SHARE * lateral_n)
    return {
        "segment": push.segment,
        "place_mm": 1e3 * abs(stated_m - along_m),
        "force_n": off_n if same else abs(float(np.hypot(*output.force_n[0, 1:])) - lateral_n),
        "half_n": 0.5 * (high_n - low_n),
        "place_holds": low_m - 1e-4 <= along_m <= high_m + 1e-4,
        "force_holds": low_n <= lateral_n <= high_n,
        "wrong": wrong,
    }


def run_case(bench: Bench, case: Case, given: argparse.Namespace, row: int) -> dict[str, Any]:
    """The figures of one case on some arms."""
    samples: list[Touched] = []
    refused = misfits = 0
    for k in track(range(given.arms), f"{bench.arm.name}, {given.title}"):
        rng = np.random.default_rng([given.seed, row, k])
        built = BuiltArm(bench.nominal, Workmanship().scaled(case.errors), rng)
        if case.broken is not None:
            built = case.broken(built, rng)
        try:
            calibration = bench.calibrated(built, case.poses, rng)
        except CalibrationError:
            refused += 1
            continue
        misfits += not calibration.as_described
        samples += bench.samples(built, calibration, given.poses, rng, case.fault)
    found = figures(samples, bench.length_m)
    return {**found, "refused calibrations": refused, "doubted calibrations": misfits}


def main() -> None:
    """Draws arms, calibrates and touches them, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "built_arms.json")
    options.add_argument("--arms", type=int, default=40, help="of each case and file")
    options.add_argument("--poses", type=int, default=20, help="of each arm")
    options.add_argument("--case", nargs="*", default=list(CASES), help="names of cases")
    options.add_argument("--only", default="", help="one of the arm files")
    options.add_argument("--seed", type=int, default=9501, help="of errors, contacts and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    files = {"cdsm_lab": Path("config/arms/cdsm_lab.yaml")}
    files["five_by_four"] = Path(__file__).parent / "arms" / "five_by_four.yaml"
    for name, path in files.items():
        if given.only and name != given.only:
            continue
        arm = on_axis(open_arm(path))
        for row, title in enumerate(CASES):
            if title not in given.case:
                continue
            case = CASES[title]
            given.title = title
            tolerances = arm.tolerances.scaled(case.errors)
            if not case.friction:
                tolerances = tolerances.model_copy(update={"friction_coefficient": 0.0})
            stated = arm.model_copy(update={"tolerances": tolerances})
            bench = Bench(stated, read_nominal(path))
            found = run_case(bench, case, given, row)
            result.setdefault(name, {})[title] = found
            print(name, title, found, flush=True)
    harness.publish("built_arms.json", result, given, "numpy", "torch")


if __name__ == "__main__":
    main()
