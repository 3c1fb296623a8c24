"""Two causes, of which one is in the list: whether it is named, and the rest stated.

    python benchmarks/partial_answers.py [--robots 8] [--arms 4] [--seed 590503] [--write]

The hidden side is the independent plant of robots (`cablesense_plants.robot`: an arm of six joints
and a double pendulum) and that of arms (`cdsm_lab`). Causes in the list and outside it come in
turn, each with its own place and size. The listed cause is named if the verdict has it, without a
name that is false; the rest is stated if the verdict says that something unlisted acts besides.
Every named effect must remove something: the gap after is less than 0.9 of the gap before, over
the readings in which nothing unlisted acts. Seeds 77001 to 77003 and 88001 were used while partial
answers were made, 590501 and 590502 while explanations were weighed in one sum. With `--folder` it
continues where it was stopped.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import blind_sets
import harness
import numpy as np
from robot_sets import KINDS

from cablesense_gap.arm_system import diagnose as diagnose_arm
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose as diagnose_robot
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, read_verdict, write_verdict
from cablesense_plants.arm.blind_cases import ArmAnswer, record_cases
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.listed import LISTED as LISTED_OF_ARMS
from cablesense_plants.arm.unlisted import UNLISTED as UNLISTED_OF_ARMS
from cablesense_plants.cases import in_turn
from cablesense_plants.robot.cases import RobotAnswer, draw_case, record
from cablesense_plants.robot.causes import LISTED, UNLISTED
from cablesense_recording.reading import read_recording as read_arm_recording
from cablesense_sim.arm import find_arm

_ARM = "cdsm_lab"
_ROBOTS = ("arm_6", "two_links")
_OF_HISTORY = ("capstan_friction", "cable_creep", "joint_friction", "actuator_backlash")
"""Causes of arms that take the diagnosis minutes each."""
_LEFT_AT_MOST = 0.9


def main() -> int:
    """Records, diagnoses and counts; keeps the cases with `--write`."""
    parser = harness.parser(__doc__, "results/partial_answers.json")
    parser.add_argument("--robots", type=int, default=8, help="cases of robots")
    parser.add_argument("--arms", type=int, default=4, help="cases of arms")
    parser.add_argument("--seed", type=int, default=590503, help="of the plants")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further case")
    parser.add_argument("--folder", type=Path, help="of recordings and verdicts, continued there")
    options = parser.parse_args()
    folder = blind_sets.folder_of(options)
    until_s = time.time() + 60.0 * options.minutes
    cases = []
    for case in _cases(options.robots, options.arms, options.seed, folder, until_s):
        cases.append(case)
        print(case, flush=True)
    result = {
        "seed": options.seed,
        "cases": len(cases),
        "listed_named": sum(case["listed_named"] for case in cases),
        "rest_stated": sum(case["rest_stated"] for case in cases),
        "both": sum(case["listed_named"] and case["rest_stated"] for case in cases),
        "false_names": sum(len(case["false_names"]) for case in cases),
        "false_names_at_0.8": sum(case["false_and_sure"] for case in cases),
        "each_case": cases,
        "bars": {"every named effect removes something": all(case["removes"] for case in cases)},
    }
    return harness.publish("partial_answers.json", result, options, "mujoco")


def _cases(
    robots: int, arms: int, seed: int, folder: Path, until_s: float
) -> Iterator[dict[str, Any]]:
    """The judgement of each case."""
    for index, names in enumerate(_pairs(LISTED, UNLISTED, seed, robots), start=1):
        if time.time() > until_s:
            return
        yield _robot_case(_ROBOTS[index % 2], names, seed, index, folder / "robots")
    listed = {name: cause for name, cause in LISTED_OF_ARMS.items() if name not in _OF_HISTORY}
    for index, names in enumerate(_pairs(listed, UNLISTED_OF_ARMS, seed, arms), start=1):
        if time.time() > until_s:
            return
        yield _arm_case(names, seed + index, folder / f"arm_{index:03d}")


def _pairs(listed: Any, unlisted: Any, seed: int, count: int) -> Iterator[list[str]]:
    """A name inside the list and one outside it, both in turn."""
    rng = np.random.default_rng([seed])
    inside = in_turn(rng, list(listed))
    outside = in_turn(rng, list(unlisted))
    for _ in range(count):
        yield [next(inside), next(outside)]


def _robot_case(
    kind: str, names: list[str], seed: int, index: int, folder: Path
) -> dict[str, Any]:
    case = draw_case(KINDS[kind], names, seed, index, [LISTED, UNLISTED])
    path = folder / f"{case.answer.recording}.csv.gz"
    if not path.exists():
        record([case], folder)

    def diagnosed() -> Verdict:
        robot = load_robot(case.kind.path)
        return diagnose_robot(read_robot_recording(path, robot), robot).verdict

    return _judged(case.answer, kind, _kept(path.with_suffix(".json"), diagnosed))


def _arm_case(names: list[str], seed: int, folder: Path) -> dict[str, Any]:
    nominal = read_nominal(find_arm(_ARM))
    answers = folder / "answers" / "answers.csv"
    (answer,) = record_cases(folder, answers, nominal, 1, seed, ["+".join(names)])
    path = folder / f"{answer.recording}.csv"
    arm = blind_sets.narrow_arm(_ARM)

    def diagnosed() -> Verdict:
        return diagnose_arm(read_arm_recording(path, arm), arm).verdict

    return _judged(answer, _ARM, _kept(path.with_suffix(".json"), diagnosed))


def _kept(path: Path, diagnosed: Any) -> Verdict:
    if not path.exists():
        write_verdict(path, diagnosed())
    return read_verdict(path)


def _judged(answer: RobotAnswer | ArmAnswer, machine: str, verdict: Verdict) -> dict[str, Any]:
    """Whether the listed cause is named and the rest stated; names that are false."""
    truth = {name for name in answer.effects.split("+") if name != UNKNOWN}
    names = () if verdict.effects[0] in (NONE, UNKNOWN) else verdict.effects
    false = [name for name in names if name not in truth]
    sure = max((verdict.shares[name].probability for name in false), default=0.0)
    gap = verdict.gap
    return {
        "case": f"{machine}, {answer.recording}",
        "hidden": f"{answer.effects}: {answer.form}",
        "each_gap": answer.each_gap_n,
        "verdict": "+".join(verdict.effects),
        "listed_named": bool(truth) and truth <= set(names),
        "probability": round(
            max((verdict.shares[n].probability for n in truth if n in names), default=0.0), 3
        ),
        "false_names": false,
        "false_and_sure": sure >= 0.8,
        "rest_stated": verdict.unlisted is not None or verdict.effects == (UNKNOWN,),
        "removes": not names or gap.after_n < _LEFT_AT_MOST * gap.before_n,
    }


if __name__ == "__main__":
    raise SystemExit(main())
