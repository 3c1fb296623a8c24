"""Arms as a workshop builds them: which readings are answered, and whether intervals hold.

    python benchmarks/built_arms.py [--arms 40] [--poses 20] [--case NAME …] [--write]

The truth is the independent plant (`cablesense_plants.arm.built`): each arm has errors of its own,
drawn by a workshop's tolerances. It is tared straight, or commissioned in 25 unloaded poses; then
it is touched in other poses within 10 degrees, by contacts of 5 to 40 N anywhere on the segments,
with an axial part of up to 0.3 of the lateral force. `judging.py` says which statements are wrong.

Contacts act on the axis, and the arm file says so; with `surface` they act on a surface at a
radius of 30 to 60 mm with friction, and the file says nothing. With friction of the cables the arm
walks from rest to rest, and each contact is answered at rest, without a breath.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import harness
import numpy as np
from estimation_settings import estimation_settings
from judging import Acting, Stated, judged, misleads, share
from rich.progress import track

from cablesense_base import Array
from cablesense_contact.calibration import Calibration, CalibrationError, Calibrator, Unloaded
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState, Judge, Judgement
from cablesense_contact.law import Law, LawOutput
from cablesense_online.calibrated_arm import CalibratedArm, CalibratedState
from cablesense_plants.arm.body import Body, Nominal, read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_plants.cases import PlantError
from cablesense_sim.arm import Arm, ListedEffect, load_arm
from cablesense_sim.tolerances import Tolerances
from cablesense_training.law.build import TorchLaw

TARE_SAMPLES = 50
COMMISSIONED_POSES = 25
BEND_RAD = float(np.deg2rad(10.0))
LOW_N = 5.0
HIGH_N = 40.0
AXIAL_SHARE = 0.3
CONTACTS_AT_A_POSE = 4
UNTOUCHED_AT_A_POSE = 2
SURFACE_M = (0.03, 0.06)
SURFACE_FRICTION = 0.3
NEAR_JOINT_M = 0.015
VOUCHED = (ContactState.CONTACT, ContactState.MOMENT)

Fault = Callable[[Array, np.random.Generator], Array]
"""Changes a reading (M,)."""


@dataclass(frozen=True)
class Case:
    """One row of the table.

    Attributes:
        errors: of the built arms, as multiples of a workshop's.
        stated: by the arm file's tolerances, likewise.
        poses: unloaded poses that it is calibrated by; 1 is a tare straight.
        pushes: makes the contacts of one sample: an axis, a surface, several at once.
        friction: coefficient of the cables on their guides; the plant walks.
        listed: whether the file lists that friction; else it leaves some to be expected.
        frictionless: whether the file says that no cable rubs, as none does without `friction`.
        holes_m: deviation of the holes, built and stated, where it is not a workshop's.
        fault: changes readings of the calibrated arm, touched and untouched.
        broken: changes the body in another way than by tolerances.
    """

    errors: float = 1.0
    stated: float = 1.0
    poses: int = COMMISSIONED_POSES
    pushes: str = "axis"
    friction: float = 0.0
    listed: bool = False
    frictionless: bool = True
    holes_m: float | None = None
    fault: Fault | None = None
    broken: Callable[[Body, np.random.Generator], Body] | None = None


def one_channel(change: Callable[[float], float]) -> Fault:
    """A fault of one channel, any of them."""

    def changed(reading_n: Array, rng: np.random.Generator) -> Array:
        reading_n = reading_n.copy()
        channel = int(rng.integers(len(reading_n)))
        reading_n[channel] = change(float(reading_n[channel]))
        return reading_n

    return changed


def hole_off(body: Body, rng: np.random.Generator) -> Body:
    """One hole two millimetres off."""
    joint = int(rng.integers(body.joint_count))
    cable = int(rng.choice(np.flatnonzero(body.passes[joint])))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    after_m = body.after_m.copy()
    after_m[joint, cable, 1:] += 0.002 * np.array([np.sin(angle), np.cos(angle)])
    return replace(body, after_m=after_m)


def wrong_guide(body: Body, rng: np.random.Generator) -> Body:
    """A cable half-way to the hole of another one, at one joint.

    Through the other hole altogether, many arms find no rest.
    """
    joint = int(rng.integers(body.joint_count))
    passing = np.flatnonzero(body.passes[joint])
    chosen = rng.choice(passing, 2, replace=False)
    after_m = body.after_m.copy()
    after_m[joint, chosen[0]] = body.after_m[joint, chosen].mean(axis=0)
    return replace(body, after_m=after_m)


CASES = {
    "well, tare": Case(poses=1),
    "well, 25 poses": Case(),
    "well, 25 poses, friction expected": Case(frictionless=False),
    "three times, 25 poses": Case(errors=3.0, stated=3.0),
    "tolerances half of the errors": Case(errors=2.0, stated=1.0),
    "one hole 2 mm off": Case(broken=hole_off),
    "one cable half a hole off": Case(broken=wrong_guide),
    "near joints": Case(pushes="near joints"),
    "surfaces": Case(pushes="surface"),
    "segments 1 and 2": Case(pushes="segments 1 and 2"),
    "three contacts": Case(pushes="three"),
    "couples": Case(pushes="couple"),
    "channel scaled by 0.9": Case(fault=one_channel(lambda reading_n: 0.9 * reading_n)),
    "channel 5 N more": Case(fault=one_channel(lambda reading_n: reading_n + 5.0)),
    "channel 20 N more": Case(fault=one_channel(lambda reading_n: reading_n + 20.0)),
    "channel zero": Case(fault=one_channel(lambda _: 0.0)),
    "friction 0.02, not stated": Case(friction=0.02),
    "friction 0.05": Case(friction=0.05, listed=True),
    "friction 0.10": Case(friction=0.10, listed=True),
    "friction 0.15": Case(friction=0.15, listed=True),
    "friction 0.02, not stated, tare": Case(friction=0.02, poses=1),
}

STIFF_CASES = {
    f"holes {1e6 * holes_m:g} um, {'tare' if poses == 1 else '25 poses'}": Case(
        poses=poses, holes_m=holes_m
    )
    for holes_m in (1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
    for poses in (1, COMMISSIONED_POSES)
}
"""Of an arm whose cables are ninety times as stiff: a hole that is off by 0.1 mm is 1,000 N."""


@dataclass(frozen=True)
class Touched:
    """One sample: what acts on the arm, and what is stated.

    Attributes:
        acting: on the arm.
        output: of the law, a batch of one.
        judgement: what is stated.
    """

    acting: Acting
    output: LawOutput
    judgement: Judgement

    @property
    def is_vouched(self) -> bool:
        """Whether the statement is vouched for."""
        return self.judgement.state in VOUCHED

    @property
    def stated(self) -> Stated:
        """What is judged."""
        output = self.output
        return Stated(
            segment=self.judgement.segment,
            only_moment=self.judgement.state is ContactState.MOMENT,
            place_m=float(output.place_m[0]),
            lateral_n=output.force_n[0, 1:],
            moment_n_m=output.moment_n_m[0],
            region_m=output.region_m[0],
            interval_n=output.magnitude_ci95_n[0],
        )


def stated_file(arm: Arm, case: Case) -> Arm:
    """The arm file of a case: what it says of touch, tolerances and friction."""
    tolerances = Tolerances().scaled(case.stated)
    if case.holes_m is not None:
        holes = {"hole_radial_m": case.holes_m, "hole_around_m": case.holes_m}
        tolerances = tolerances.model_copy(update=holes)
    if case.frictionless and not case.friction:
        tolerances = tolerances.model_copy(update={"friction_coefficient": 0.0})
    update: dict[str, Any] = {"tolerances": tolerances}
    if case.pushes != "surface":
        update["touch"] = arm.touch.model_copy(update={"radius_m": 0.0, "friction": AXIAL_SHARE})
    if case.listed:
        parameters = {"coefficient": case.friction, "pulley_wrap_rad": 1.0, "run_compliance": 0.5}
        friction = ListedEffect(effect="capstan_friction", parameters=parameters)
        update["effects"] = [friction]
    return arm.model_copy(update=update)


class Bench:
    """One case: its arm file and law, and arms built by it."""

    def __init__(self, arm: Arm, law: Law, nominal: Nominal, case: Case) -> None:
        self.arm = arm
        self.nominal = nominal
        self.case = case
        self.law = law
        self.calibrator = Calibrator(FeltArm(arm), law)
        self.judge = Judge(FeltArm(arm))
        self.still = np.zeros((arm.joint_count, arm.joint_count))
        self.length_m = nominal.length_m
        no_pose = np.tile(np.eye(3), (arm.segment_count, 1, 1))
        self.nothing = Acting((), no_pose, nominal.length_m)

    def built(self, rng: np.random.Generator) -> BuiltArm:
        """An arm with errors of its own."""
        workmanship = Workmanship().scaled(self.case.errors)
        holes_m = self.case.holes_m
        if holes_m is not None:
            workmanship = replace(workmanship, hole_radial_m=holes_m, hole_around_m=holes_m)
        arm = BuiltArm(self.nominal, workmanship, rng, friction=self.case.friction)
        broken = self.case.broken
        return arm if broken is None else arm.altered(lambda body: broken(body, _fresh(rng)))

    def calibrated(self, built: BuiltArm, rng: np.random.Generator) -> Calibration:
        """By unloaded readings: straight, then in random poses, one after the other."""
        count = self.case.poses
        commands = np.zeros((count, self.arm.joint_count))
        commands[1:] = rng.uniform(-BEND_RAD, BEND_RAD, commands[1:].shape)
        if self.case.friction:
            walk = built.walk(commands[0])
            tensions = np.array([walk.go(command) for command in commands])
        else:
            tensions = built.rests(commands, [()] * count).tensions_n
        came_from = [None, *commands[:-1]]
        unloaded = [
            Unloaded(mean_reading(built, tension_n, rng), command, TARE_SAMPLES, 0, before)
            for tension_n, command, before in zip(tensions, commands, came_from, strict=True)
        ]
        return self.calibrator.from_poses(unloaded)

    def samples(
        self, built: BuiltArm, calibration: Calibration, poses: int, rng: np.random.Generator
    ) -> list[Touched]:
        """Contacts and untouched readings in random poses."""
        if self.case.friction:
            return self._walked(built, calibration, poses, rng)
        commands: list[Array] = []
        drawn: list[Acting] = []
        for _ in range(poses):
            command = rng.uniform(-BEND_RAD, BEND_RAD, self.arm.joint_count)
            for k in range(CONTACTS_AT_A_POSE + UNTOUCHED_AT_A_POSE):
                touched = k < CONTACTS_AT_A_POSE
                drawn.append(self.drawn(built, command, rng) if touched else self.nothing)
                commands.append(command)
        tensions, kept = borne(built, np.array(commands), [sample.pushes for sample in drawn])
        readings = built.read(tensions, rng)
        if self.case.fault is not None:
            readings = np.array([self.case.fault(reading, rng) for reading in readings])
        known = self.calibrator.moved(calibration)
        commands_rad = np.array(commands)[kept]
        seen = self.law(readings, commands_rad, known.mean, known.covariance, self.still)
        return [self._judged(drawn[k], seen.row(i), readings[i]) for i, k in enumerate(kept)]

    def _walked(
        self, built: BuiltArm, calibration: Calibration, poses: int, rng: np.random.Generator
    ) -> list[Touched]:
        """The same on an arm with friction: each contact comes to the untouched arm, and goes."""
        settings = estimation_settings()
        unloaded = CalibratedArm(FeltArm(self.arm), self.law, settings)
        state = unloaded.begin(calibration)
        command = np.zeros(self.arm.joint_count)
        walk = built.walk(command)
        samples = []
        for _ in range(poses):
            walk.go(command)
            command = rng.uniform(-BEND_RAD, BEND_RAD, self.arm.joint_count)
            for _ in range(CONTACTS_AT_A_POSE):
                try:
                    walk.go(command)
                except PlantError:
                    break
                state = unloaded.at(state, command)
                for _ in range(settings.tare_samples):
                    reading = built.read(walk.tensions_n, rng)
                    state, sample = self._of_state(unloaded, state, reading, self.nothing)
                    if sample.judgement.state is ContactState.FREE:
                        state = unloaded.with_untouched(state, reading)
                samples.append(sample)
                drawn = self.drawn(built, command, rng)
                try:
                    walk.go(command, drawn.pushes)
                except PlantError:
                    continue
                reading = built.read(walk.tensions_n, rng)
                state, sample = self._of_state(unloaded, state, reading, drawn)
                samples.append(sample)
        return samples

    def _of_state(
        self, unloaded: CalibratedArm, state: CalibratedState, reading_n: Array, drawn: Acting
    ) -> tuple[CalibratedState, Touched]:
        """What is stated of a reading (M,) by what is known of the arm, as an estimator does."""
        state, seen = self._seen(unloaded, state, reading_n)
        sample = self._judged(drawn, seen, reading_n)
        is_free = sample.judgement.state is ContactState.FREE
        if is_free or unloaded.seen_untouched(state):
            return state, sample
        state, seen = self._seen(unloaded, state, reading_n, touched=True)
        return state, self._judged(drawn, seen, reading_n)

    def _seen(
        self,
        unloaded: CalibratedArm,
        state: CalibratedState,
        reading_n: Array,
        *,
        touched: bool = False,
    ) -> tuple[CalibratedState, LawOutput]:
        pose_rad = state.pose_rad
        assert pose_rad is not None
        state, belief = unloaded.belief(state, reading_n, 0, touched=touched)
        seen = self.law(
            reading_n[None], pose_rad[None], belief.mean, belief.covariance, self.still
        )
        return state, seen

    def _judged(self, drawn: Acting, seen: LawOutput, reading_n: Array) -> Touched:
        return Touched(drawn, seen, self.judge(seen, reading_n))

    def drawn(self, built: BuiltArm, command_rad: Array, rng: np.random.Generator) -> Acting:
        """The pushes of one sample."""
        axes = built.axes(command_rad)
        return Acting(self._pushes(axes, rng), axes, self.length_m)

    def _pushes(self, axes: Array, rng: np.random.Generator) -> tuple[Push, ...]:
        """The pushes on an arm whose segments have these axes (N, 3, 3)."""
        count = self.arm.segment_count
        kind = self.case.pushes
        if kind == "segments 1 and 2":
            return tuple(self._push(n, axes, rng) for n in (0, 1))
        if kind == "three":
            chosen = sorted(rng.permutation(count)[:3].tolist())
            return tuple(self._push(n, axes, rng) for n in chosen)
        n = int(rng.integers(count))
        push = self._push(n, axes, rng)
        if kind == "couple":
            other = replace(push, place_m=self.length_m[n] - push.place_m, force_n=-push.force_n)
            return push, other
        if kind == "near joints":
            push = replace(push, place_m=rng.uniform(0.0, NEAR_JOINT_M))
        return (push,)

    def _push(self, n: int, axes: Array, rng: np.random.Generator) -> Push:
        """A contact on segment n, from 0 on."""
        size_n = rng.uniform(LOW_N, HIGH_N)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        lateral = np.array([0.0, np.sin(angle), np.cos(angle)])
        axial_n = size_n * rng.uniform(-AXIAL_SHARE, AXIAL_SHARE)
        force_n = size_n * lateral + np.array([axial_n, 0.0, 0.0])
        place_m = rng.uniform(0.0, self.length_m[n])
        side_m = None
        if self.case.pushes == "surface":
            # pressed from outside, with friction along the arm and around it
            radius_m = rng.uniform(*SURFACE_M)
            side_m = -radius_m * lateral
            around_n = size_n * rng.uniform(-SURFACE_FRICTION, SURFACE_FRICTION)
            across = np.array([0.0, lateral[2], -lateral[1]])
            force_n = force_n + around_n * across
        return Push(n + 1, place_m, axes[n] @ force_n, side_m)


def _fresh(rng: np.random.Generator) -> np.random.Generator:
    """A generator of the same state, so that both bodies of an arm are broken alike."""
    copy = np.random.default_rng()
    copy.bit_generator.state = rng.bit_generator.state
    return copy


def borne(
    built: BuiltArm, commands: Array, pushes: Sequence[Sequence[Push]]
) -> tuple[Array, list[int]]:
    """Tensions (K, M) of the rows that the arm bears, and their positions."""
    try:
        return built.rests(commands, pushes).tensions_n, list(range(len(commands)))
    except PlantError:
        tensions = []
        kept = []
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


def figures(samples: Sequence[Touched]) -> dict[str, Any]:
    """What the samples of a case come to."""
    untouched = [sample for sample in samples if not sample.acting.pushes]
    touched = [sample for sample in samples if sample.acting.pushes]
    vouched = [sample for sample in touched if sample.is_vouched]
    single = [sample for sample in vouched if len(sample.acting.pushes) == 1]
    several = [sample for sample in vouched if len(sample.acting.pushes) > 1]
    rows = [judged(sample.acting, sample.stated) for sample in single]
    outer = [row for row in rows if row.segment > 1]

    def vouches_wrongly(some: Sequence[Touched]) -> list[bool]:
        vouched_for = [sample for sample in some if sample.is_vouched]
        return [misleads(sample.acting, sample.stated) for sample in vouched_for]

    free = [sample.judgement.state is ContactState.FREE for sample in untouched]
    return {
        "touched": len(touched),
        "states": dict(Counter(sample.judgement.state.value for sample in touched)),
        "answered": share([sample.is_vouched for sample in touched]),
        "untouched free": share(free),
        "untouched vouched for": sum(vouches_wrongly(untouched)),
        "place, median (mm)": median([row.place_mm for row in outer]),
        "force, median (N)": median([row.force_n for row in outer]),
        "half-width of force, median (N)": median([row.half_n for row in outer]),
        "place holds": share([row.place_holds for row in rows]),
        "force holds": share([row.force_holds for row in rows]),
        "wrong and vouched for": sum(row.wrong for row in rows),
        "several, vouched for": len(several),
        "several, wrong and vouched for": sum(vouches_wrongly(several)),
    }


def median(values: Sequence[float]) -> float | None:
    """The median; None of no values."""
    return round(float(np.median(values)), 4) if len(values) else None


def run_case(bench: Bench, title: str, given: argparse.Namespace, row: int) -> dict[str, Any]:
    """The figures of one case on some arms."""
    samples: list[Touched] = []
    refused = 0
    doubted = 0
    for k in track(range(given.arms), f"{bench.arm.name}, {title}"):
        rng = np.random.default_rng([given.seed, row, k])
        try:
            built = bench.built(rng)
            calibration = bench.calibrated(built, rng)
        except (CalibrationError, PlantError):
            refused += 1
            continue
        doubted += not calibration.as_described
        samples += bench.samples(built, calibration, given.poses, rng)
    return {
        **figures(samples),
        "arms without calibration": refused,
        "calibrations that doubt the file": doubted,
    }


FILES = {
    "cdsm_lab": Path("config/arms/cdsm_lab.yaml"),
    "five_by_four": Path(__file__).parent / "arms" / "five_by_four.yaml",
    "cdsm": Path("config/arms/cdsm.yaml"),
}


def main() -> int:
    """Draws arms, calibrates and touches them, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "built_arms.json")
    options.add_argument("--arms", type=int, default=40, help="of each case and file")
    options.add_argument("--poses", type=int, default=20, help="of each arm")
    options.add_argument("--case", nargs="*", default=[], help="names of cases; all")
    options.add_argument("--file", nargs="*", default=list(FILES), help="names of arm files")
    options.add_argument("--seed", type=int, default=9501, help="of errors, contacts and noise")
    options.add_argument("--out", default="built_arms.json", help="name of the result")
    given = options.parse_args()
    result: dict[str, Any] = {}
    for name in given.file:
        arm = load_arm(FILES[name])
        nominal = read_nominal(FILES[name])
        cases = STIFF_CASES if name == "cdsm" else CASES
        for row, (title, case) in enumerate(cases.items()):
            if given.case and title not in given.case:
                continue
            stated = stated_file(arm, case)
            bench = Bench(stated, TorchLaw(stated), nominal, case)
            figures = run_case(bench, title, given, row)
            result.setdefault(name, {})[title] = figures
            print(name, title, figures, file=sys.stderr, flush=True)
            if given.write:
                # a run that is stopped keeps the cases that it has
                harness.write_result(given.out, harness.origin("numpy", "torch") | result)
    return harness.publish(given.out, result, given, "numpy", "torch")


if __name__ == "__main__":
    sys.exit(main())
