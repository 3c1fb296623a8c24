"""Diagnoses against a healthy recording that lacks the motion, or that bore a load.

    python benchmarks/reference_coverage.py [--seed 9301] [--minutes 60] [--write]
    python benchmarks/reference_coverage.py --loads [--seed 9311] [--minutes 60] [--write]

The robots, their friction and what their models lack are those of `robot_blind.py --imperfect`.
Each of 20 cases hides a cause, or nothing, and moves where the healthy recording did not: at
other positions of one joint or of all, three times as fast, or in poses that load the first joints
otherwise. The verdict is to be `cannot_tell` or right, and never `none`. With `--loads` the
healthy recording bears a load, and the recording does not, or a lighter one. The verdict is to be
`payload` with a negative mass. Seeds 9300 and 9310 were used while that was made.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import numpy as np
from robot_sets import KINDS, with_what_models_lack

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_gap.verdict import CANNOT_TELL, NONE, Verdict, joined
from cablesense_plants.robot.cases import RobotAnswer, RobotCase, record, rms
from cablesense_plants.robot.causes import with_tolerances
from cablesense_plants.robot.motion import ReferenceMotion, prescribed_n_m, reference
from cablesense_plants.robot.robots import RealRobot, RobotKind

_FASTER = 3
"""Times as fast as the healthy recording that lacks speeds."""
_FRICTION_SHARE = 0.3
_OFFSET_SHARE = 0.3
"""Of the torque of a joint, RMS."""
_TOOL_SHARE = 0.5
"""Of the mass of the last link but one."""

Lack = Callable[[RobotKind, int], tuple[RobotKind, RobotKind]]
"""The robot's motion when healthy and later, by the joint that moves elsewhere."""


def _within(kind: RobotKind, joints: list[int], side: float) -> RobotKind:
    """The motion on one side of home, at some joints."""
    home_rad = kind.home_rad.copy()
    reach_rad = kind.reach_rad.copy()
    home_rad[joints] += side * 0.55 * reach_rad[joints]
    reach_rad[joints] *= 0.4
    return replace(kind, home_rad=home_rad, reach_rad=reach_rad)


def _elsewhere(kind: RobotKind, joint: int) -> tuple[RobotKind, RobotKind]:
    return _within(kind, [joint], -1.0), _within(kind, [joint], 1.0)


def _all_elsewhere(kind: RobotKind, _joint: int) -> tuple[RobotKind, RobotKind]:
    joints = list(range(len(kind.home_rad)))
    return _within(kind, joints, -1.0), _within(kind, joints, 1.0)


def _otherwise_loaded(kind: RobotKind, joint: int) -> tuple[RobotKind, RobotKind]:
    """The joints beyond are folded in one recording, and stretched in the other."""
    beyond = [k for k in range(len(kind.home_rad)) if k > joint] or [joint]
    return _within(kind, beyond, 1.0), _within(kind, beyond, -1.0)


def _faster(kind: RobotKind, _joint: int) -> tuple[RobotKind, RobotKind]:
    return kind, replace(kind, trial_s=_FASTER * kind.trial_s)


LACKS: dict[str, Lack] = {
    "positions of a joint": _elsewhere,
    "positions of all joints": _all_elsewhere,
    "loads": _otherwise_loaded,
    "speeds": _faster,
}
CAUSES = ("joint_friction", "payload", "torque_offset", "none", "tool")
"""A tool is a payload that is not at one point."""


@dataclass(frozen=True)
class _Planted:
    """A case with its truth.

    Attributes:
        lack: what the healthy recording lacks.
        cause: of the change.
        right: effects that are right.
        link: where a load went.
        mass_kg: of a load that came, negative of one that went; 0 of other changes.
    """

    case: RobotCase
    lack: str
    cause: str
    right: tuple[str, ...]
    link: str = ""
    mass_kg: float = 0.0


def lacking_cases(seed: int) -> list[_Planted]:
    """Each cause with each lack, on robots in turn."""
    names = ("two_links", "arm_6")
    pairs = [(lack, cause) for lack in LACKS for cause in CAUSES]
    return [
        _lacking(KINDS[names[index % 2]], *pair, seed, index) for index, pair in enumerate(pairs)
    ]


def _lacking(kind: RobotKind, lack: str, cause: str, seed: int, index: int) -> _Planted:
    rng = np.random.default_rng([seed, index])
    nominal, _joints, links = kind.nominal()
    joint = int(rng.integers(min(3, len(links))))
    when_healthy, later = LACKS[lack](kind, joint)
    everywhere = reference(kind, rng)
    healthy = with_what_models_lack(with_tolerances(nominal, kind, rng), kind, rng, everywhere)
    torque = rms(prescribed_n_m(kind, healthy, everywhere))
    last = len(links) - 1
    at_joint = np.arange(len(links)) == joint
    offset = _OFFSET_SHARE * torque * at_joint
    tool_kg = _TOOL_SHARE * float(nominal.chain.mass_kg[max(last - 1, 0)])
    far_m = nominal.chain.centre_m[last] + 0.05
    changes: dict[str, RealRobot] = {
        "none": healthy,
        "joint_friction": replace(healthy, dry=_FRICTION_SHARE * torque * at_joint),
        "torque_offset": replace(healthy, offset=healthy.offset + offset),
        "payload": replace(healthy, chain=healthy.chain.with_mass(last, tool_kg, far_m)),
        "tool": _with_tool(healthy, last, tool_kg),
    }
    asked = _asked(kind, later, rng), reference(when_healthy, rng)
    case = _case(kind, index, (changes[cause], healthy), asked, rng)
    right = ("payload",) if cause == "tool" else (cause,)
    return _Planted(case, lack, cause, right)


def _with_tool(robot: RealRobot, link: int, tool_kg: float) -> RealRobot:
    """Four masses far from each other on a link."""
    chain = robot.chain
    for away in ((0.08, 0.0, 0.03), (0.02, 0.0, -0.05), (0.1, 0.04, 0.0), (0.1, -0.04, 0.0)):
        chain = chain.with_mass(link, 0.25 * tool_kg, robot.chain.centre_m[link] + away)
    return replace(robot, chain=chain)


def _asked(kind: RobotKind, later: RobotKind, rng: np.random.Generator) -> ReferenceMotion:
    """The later motion, faster where its trials are longer than the robot's."""
    angle, speed, acceleration = reference(later, rng)
    faster = round(later.trial_s / kind.trial_s)
    rows = slice(None, None, faster)
    return ReferenceMotion(angle[rows], faster * speed[rows], faster**2 * acceleration[rows])


def _case(
    kind: RobotKind,
    index: int,
    robots: tuple[RealRobot, RealRobot],
    asked: tuple[ReferenceMotion, ReferenceMotion],
    rng: np.random.Generator,
) -> RobotCase:
    """The recordings of a robot later and when healthy, and in between one that is not read."""
    answer = RobotAnswer(f"case_{index:03d}", kind.name, "", "", "", "", 0.0, 0.0, "")
    seeds = rng.integers(2**31, size=3).tolist()
    later = robots[0], asked[0], seeds[0]
    return RobotCase(answer, kind, (later, later, (robots[1], asked[1], seeds[2])))


def taken_off_cases(seed: int) -> list[_Planted]:
    """Loads of half to four times a link's mass, on links in turn; a third is halved only."""
    sizes = np.geomspace(0.5, 4.0, 12)
    names = ("two_links", "arm_6")
    return [
        _taken_off(KINDS[names[index % 2]], float(size), seed, index)
        for index, size in enumerate(sizes)
    ]


def _taken_off(kind: RobotKind, size: float, seed: int, index: int) -> _Planted:
    rng = np.random.default_rng([seed, index])
    nominal, _joints, links = kind.nominal()
    everywhere = reference(kind, rng)
    plain = with_what_models_lack(with_tolerances(nominal, kind, rng), kind, rng, everywhere)
    link = len(links) - 1 - index // 2 % 2
    load_kg = size * float(nominal.chain.mass_kg[link])
    place_m = nominal.chain.centre_m[link] + 0.1 * rng.uniform(-1.0, 1.0, 3)
    left_kg = 0.5 * load_kg if index % 3 == 2 else 0.0

    def bearing(mass_kg: float) -> RealRobot:
        return replace(plain, chain=plain.chain.with_mass(link, mass_kg, place_m))

    asked = reference(kind, rng), reference(kind, rng)
    case = _case(kind, index, (bearing(left_kg), bearing(load_kg)), asked, rng)
    return _Planted(
        case,
        "halved" if left_kg else "taken off",
        "payload",
        ("payload",),
        links[link],
        left_kg - load_kg,
    )


def main() -> int:
    """Draws, records, diagnoses, scores and prints; keeps the scores with `--write`."""
    parser = harness.parser(__doc__, "reference_coverage.json, or reference_loads.json")
    parser.add_argument("--loads", action="store_true", help="loads that are taken off")
    parser.add_argument("--seed", type=int, help="of the cases")
    parser.add_argument("--folder", type=Path, help="of the recordings; kept, and continued")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no case begins")
    options = parser.parse_args()
    seed = options.seed or (9311 if options.loads else 9301)
    planted = taken_off_cases(seed) if options.loads else lacking_cases(seed)
    folder = options.folder or Path(tempfile.mkdtemp(prefix="reference_"))
    folder.mkdir(parents=True, exist_ok=True)
    until_s = time.time() + 60.0 * options.minutes
    _record(planted, folder)
    each_case = []
    for each in planted:
        if time.time() > until_s:
            break
        outcome = harness.kept(_file(folder, each, "json"), partial(_scored, each, folder))
        each_case.append(outcome)
        print(outcome, flush=True)
    right = sum(outcome["right"] for outcome in each_case)
    none_named = sum(outcome["named"] == NONE for outcome in each_case)
    bar = "named with its sign" if options.loads else "cannot_tell or right"
    figures = {
        "seed": seed,
        "cases": len(each_case),
        "right": right,
        "none": none_named,
        "named": dict(Counter(outcome["named"] for outcome in each_case)),
        "seconds_of_a_diagnosis": harness.percentiles(
            [outcome["seconds"] for outcome in each_case], ("median", "worst"), 1
        ),
        "bars": {bar: right == len(planted), "none 0": none_named == 0},
        "each_case": each_case,
    }
    if options.loads:
        figures["sizes"] = _sizes(each_case)
    name = "reference_loads.json" if options.loads else "reference_coverage.json"
    return harness.publish(name, figures, options, "mujoco")


def _file(folder: Path, planted: _Planted, ending: str) -> Path:
    return folder / f"{planted.case.answer.recording}.{ending}"


def _record(planted: list[_Planted], folder: Path) -> None:
    """The recordings of each robot at once, as far as there are none."""
    for name in dict.fromkeys(each.case.kind.name for each in planted):
        unrecorded = [
            each.case
            for each in planted
            if each.case.kind.name == name and not _file(folder, each, "csv.gz").exists()
        ]
        if unrecorded:
            record(unrecorded, folder)


def _scored(planted: _Planted, folder: Path) -> dict[str, Any]:
    """The verdict on a case, and whether it is right."""
    path = _file(folder, planted, "csv.gz")
    robot = load_robot(planted.case.kind.path)
    healthy = read_robot_recording(folder / "reference" / path.name, robot)
    verdict = diagnose(read_robot_recording(path, robot), robot, reference=healthy).verdict
    assert verdict.reference is not None
    shares = [channel.share for channel in verdict.reference.coverage.values()]
    named = joined(verdict.effects)
    scored = {
        "case": f"{planted.case.kind.name}, {planted.lack}, {planted.cause}",
        "named": named,
        "probability": round(verdict.probability, 3),
        "least_covered": round(min(shares), 3),
        "gap_floors": round(verdict.gap.before_n / verdict.gap.floor_n, 1),
        "seconds": round(verdict.seconds or 0.0, 1),
    }
    if planted.mass_kg:
        return scored | _load_scored(planted, verdict)
    right = verdict.effects in ((CANNOT_TELL,), planted.right) and named != NONE
    return scored | {"right": right}


def _sizes(each_case: list[dict[str, Any]]) -> dict[str, Any]:
    """Errors of the masses found, as shares of the truth, and how often intervals hold these."""
    with_mass = [each for each in each_case if each["found_kg"] is not None]
    off = [abs(each["found_kg"] / each["truth_kg"] - 1.0) for each in with_mass]
    held = [each["ci95_kg"][0] <= each["truth_kg"] <= each["ci95_kg"][1] for each in with_mass]
    return {
        "relative_error": harness.percentiles(off, ("median", "worst")),
        "interval_holds": sum(held),
    }


def _load_scored(planted: _Planted, verdict: Verdict) -> dict[str, Any]:
    mass = verdict.parameters.get("payload.mass_kg")
    named = verdict.effects == ("payload",) and verdict.where.bodies == (planted.link,)
    return {
        "link": planted.link,
        "truth_kg": round(planted.mass_kg, 3),
        "found_kg": mass and round(mass.value, 3),
        "ci95_kg": mass and [round(end, 3) for end in mass.ci95],
        "right": named and mass is not None and mass.value < 0.0,
    }


if __name__ == "__main__":
    raise SystemExit(main())
