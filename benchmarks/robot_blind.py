"""Diagnoses of robots whose hidden effects an independent simulator made.

    python benchmarks/robot_blind.py [--count 60] [--seed 8105] [--commands] [--write]
    python benchmarks/robot_blind.py --imperfect [--reference] [--count 60] [--seed 9162] [--write]
    python benchmarks/robot_blind.py --servos [--count 30] [--seed 9154] [--write]
    python benchmarks/robot_blind.py --payloads --count 30 --seed 9165 [--write]
    python benchmarks/robot_blind.py --exchanged --count 20 --seed 9705 [--write]

Three nominal models of `config/robots` (an arm of six joints, a double pendulum, a finger with
tendons). The hidden side is the rigid-body code, friction, drives and sensors of
`cablesense_plants`, which shares nothing with the diagnosis. Seeds up to 8104, 8310 and 8311 were
used while the diagnosis was made, and 5001 and 5002 while it learnt of imperfect models. With
`--commands` no torque is recorded, and no cause shows in torques alone; with `--play` all that is
hidden is backlash, which few joints of the other two show; with `--tendons` a finger has tendons
over guides, which rub in half of the cases, while of the others half have other friction. With
`--imperfect` the models lack friction by position, springs and ripples, which make 5 to 15 % of
the torque; with `--reference` another recording, without the hidden effects, is the reference
(seeds 9001, 9131, 9137, 9138 and 9161 were used while that was made). With `--servos` robots are
under position servos, and a camera reads their joints; a zero, play, a coupling, a payload, a
servo's gain or nothing is hidden in turn (seeds 5101, 9151 and 9153 were used while it was made).
With `--payloads` loads of 0.02 to 10 times the mass of a link are hidden, in turn on a hinge by
the plant and on a slide by Newton's law. With `--exchanged` two torque columns are exchanged, or a
torque or a position is reversed, in turn. It counts how often the diagnosis stops and names that,
after how long, and how often it suspects the recordings as they were. Seeds 9702 to 9704 were used
while that was made.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import blind_sets
import harness
import numpy as np
import pandas as pd
from robot_sets import (
    drawn,
    lifted,
    servo_file,
    with_payload,
    with_play,
    with_servos,
    with_tendons,
)

from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import rms
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose, wrong_columns
from cablesense_gap.scoring import read_answers, score
from cablesense_gap.verdict import Verdict, removed_fraction
from cablesense_plants.cases import PlantError, write_answers
from cablesense_plants.robot.cases import RobotCase, record
from cablesense_recording.recording import RecordingError

_LONG_ROWS = 20_000
_TOGETHER = 10
"""Cases of one model that are simulated at once."""


def main() -> None:
    """Draws, records, diagnoses, scores and prints; keeps the scores with `--write`."""
    parser = blind_sets.parser(__doc__, "robot_blind.json, or …_forward and so on", seed=8105)
    parser.add_argument("--commands", action="store_true", help="record them, and no torques")
    parser.add_argument("--play", action="store_true", help="hide backlash alone, in two links")
    parser.add_argument("--tendons", action="store_true", help="hide friction over guides")
    parser.add_argument("--servos", action="store_true", help="hide what a camera sees")
    parser.add_argument("--imperfect", action="store_true", help="models that lack something")
    parser.add_argument("--reference", action="store_true", help="diagnose what changed")
    parser.add_argument("--payloads", action="store_true", help="hide payloads of all sizes")
    parser.add_argument("--exchanged", action="store_true", help="columns that are wrong")
    options = parser.parse_args()
    folder = blind_sets.folder_of(options)
    if options.exchanged:
        figures = _exchanged(options.count, options.seed, folder)
        harness.publish("robot_exchanged.json", figures, options, "mujoco")
        return
    if options.payloads:
        figures = _payloads(options.count, options.seed, folder)
        harness.publish("robot_payloads.json", figures, options, "mujoco")
        return
    usual = partial(drawn, commands=options.commands, imperfect=options.imperfect)
    ways = {"play": with_play, "tendons": with_tendons, "servos": with_servos}
    drawing = next((way for name, way in ways.items() if getattr(options, name)), usual)
    cases = drawing(options.count, options.seed)
    answers_file = folder / "answers" / "answers.csv"
    write_answers(answers_file, [case.answer for case in cases])
    answers = read_answers(answers_file)
    until_s = time.time() + 60.0 * options.minutes
    _record(cases, folder, until_s)
    since = "since." if options.reference else ""
    done = {}
    for case, answer in zip(cases, answers, strict=True):
        diagnosed = partial(_diagnosed, case, folder, since, torques=not options.commands)
        if _second(folder, case).exists() and (
            outcome := blind_sets.finished(_place(folder, case, since), until_s, diagnosed)
        ):
            done[answer.recording] = outcome
            print(blind_sets.case(answer, *outcome), flush=True)
    result = {"seed": options.seed, **blind_sets.scored(answers, done)}
    verdicts = {name: outcome.verdict for name, outcome in done.items()}
    several = [a for a in answers if a.recording in done and len(a.effects) > 1]
    result["budgets"] = asdict(score(verdicts, several).budgets) if several else {}
    result["budgets"].pop("shares", None)  # of the verdict's floors; answers count samples' noise
    arms = [c for c in cases if c.kind.name == "arm_6" and "+" in c.answer.effects]
    if arms and not options.commands and time.time() < until_s:
        long_s = _long_s(arms[0], folder)
        result[f"seconds of {_LONG_ROWS:,} rows of a 6-joint arm"] = long_s
    names = {"_forward": "commands", "_play": "play", "_tendons": "tendons"}
    names |= {"_servos": "servos", "_imperfect": "imperfect", "_reference": "reference"}
    kind = "".join(part for part, option in names.items() if getattr(options, option))
    harness.publish(f"robot_blind{kind}.json", result, options, "mujoco")


def _exchanged(count: int, seed: int, folder: Path) -> dict[str, Any]:
    """How often a wrong column stops a diagnosis and is named, and false alarms."""
    rng = np.random.default_rng(seed)
    named = 0
    false = 0
    seconds = []
    each_case = []
    cases = drawn(count, seed)
    _record(cases, folder, np.inf)
    for k, case in enumerate(cases):
        robot = load_robot(case.kind.path)
        recording = read_robot_recording(_place(folder, case, "csv.gz"), robot)
        wrong, text = _wrong_column(recording, robot, k, rng)
        began = time.monotonic()
        said = ""
        try:
            diagnose(wrong, robot)
        except RecordingError as error:
            said = str(error)
        seconds.append(time.monotonic() - began)
        named += text in said
        each_case.append({"wrong": text, "said": said.partition(": ")[2].partition(": ")[0]})
        false += bool(wrong_columns(recording, robot))
    return {
        "seed": seed,
        "recordings": count,
        "named": named,
        "false_alarms": false,
        "seconds_until_named": harness.percentiles(seconds, ("median", "worst"), 1),
        "each_case": each_case,
    }


def _payloads(count: int, seed: int, folder: Path) -> dict[str, Any]:
    """How many payloads of 0.02 to 10 times a body's mass are found, on hinges and on slides.

    Those that do not stand out of a robot's tolerances are not hidden.
    """
    rng = np.random.default_rng([seed])
    each_case = []
    for k, size in enumerate(np.geomspace(0.02, 10.0, count).tolist()):
        if k % 2:
            path, recording = lifted(size, rng, folder)
            robot = load_robot(path)
            body = "carriage"
            mass_kg = 0.5 * size
        else:
            try:
                case = with_payload(size, seed, k // 2)
            except PlantError:
                continue
            record([case], folder)
            robot = load_robot(case.kind.path)
            body = case.answer.where
            recording = read_robot_recording(_place(folder, case, "csv.gz"), robot)
            mass_kg = json.loads(case.answer.sizes)[0]["size"]
        verdict = diagnose(recording, robot).verdict
        effect = "+".join(verdict.effects)
        named = effect == "payload" or "payload" in (verdict.ambiguity_group or ())
        number = "payload.mass_kg"
        truth = mass_kg
        if effect == "link_mass":  # of its group
            number = "link_mass.share"
            truth = size
        estimate = verdict.parameters.get(number)
        near = estimate is not None and (
            abs(estimate.value - truth) <= 0.1 * truth
            or estimate.ci95[0] <= truth <= estimate.ci95[1]
        )
        each_case.append(
            {
                "case": f"{robot.path.stem}, {body}",
                "times_its_mass": round(size, 4),
                "named": effect,
                "probability": round(verdict.probability, 3),
                "truth": round(truth, 4),
                "found": None if estimate is None else round(estimate.value, 4),
                "right": named and verdict.where.bodies == (body,) and near,
            }
        )
        print(each_case[-1], flush=True)
    right = sum(bool(each["right"]) for each in each_case)
    return {"seed": seed, "payloads": len(each_case), "right": right, "each_case": each_case}


def _wrong_column(
    recording: RobotRecording, robot: Robot, k: int, rng: np.random.Generator
) -> tuple[RobotRecording, str]:
    """A recording with two torques exchanged, or a torque or a position reversed; what it is."""
    joints = len(robot.joints)
    a, b = sorted(rng.choice(joints, 2, replace=False).tolist())
    if k % 3 == 0:
        order = np.arange(joints)
        order[[a, b]] = b, a
        text = f"torque.{robot.joints[a]} and torque.{robot.joints[b]} look exchanged"
        return replace(recording, torque=recording.torque[:, order]), text
    sign = np.where(np.arange(joints) == a, -1.0, 1.0)
    kind = "torque" if k % 3 == 1 else "position"
    columns: dict[str, Any] = {kind: getattr(recording, kind) * sign}
    text = f"{kind}.{robot.joints[a]} looks as if it had the other sign"
    return replace(recording, **columns), text


def _record(cases: Sequence[RobotCase], folder: Path, until_s: float) -> None:
    for kind in dict.fromkeys(case.kind.name for case in cases):
        unrecorded = [c for c in cases if c.kind.name == kind and not _second(folder, c).exists()]
        for begin in range(0, len(unrecorded), _TOGETHER):
            if time.time() > until_s:
                return
            record(unrecorded[begin : begin + _TOGETHER], folder)


def _diagnosed(
    case: RobotCase, folder: Path, since: str, *, torques: bool
) -> tuple[Verdict, float]:
    """The verdict, and the share of the gap removed on the second recording."""
    external = case.kind.servos
    robot = load_robot(servo_file(case.kind, folder) if external else case.kind.path)

    def read(path: Path) -> RobotRecording:
        recording = read_robot_recording(path, robot)
        unread = np.full_like(recording.torque, np.nan)
        return recording if torques else replace(recording, torque=unread)

    path = _place(folder, case, "csv.gz")
    healthy = read(path.parent / "reference" / path.name) if since else None
    diagnosis = diagnose(read(path), robot, reference=healthy, external=external)
    motion = prepared(read(_second(folder, case)), robot, external=external)
    simulator = RobotSystem(robot, motion, {})
    variants = (simulator.predict([variant])[0] for variant in ({}, diagnosis.amended))
    before, after = (rms(simulator.readings - variant) for variant in variants)
    return diagnosis.verdict, removed_fraction(before, after, simulator.floor)


def _long_s(case: RobotCase, folder: Path) -> float:
    """Seconds from the file to the verdict, for its recording with `_LONG_ROWS` rows."""
    table = pd.read_csv(_place(folder, case, "csv.gz"))
    places = np.linspace(0.0, len(table) - 1.0, _LONG_ROWS)
    long = {name: np.interp(places, np.arange(len(table)), table[name]) for name in table}
    long["trial"] = np.floor(long["trial"])
    with tempfile.TemporaryDirectory() as beside:
        path = Path(beside) / "long.csv"
        pd.DataFrame(long).to_csv(path, index=False)
        began = time.monotonic()
        robot = load_robot(case.kind.path)
        diagnose(read_robot_recording(path, robot), robot)
    return round(time.monotonic() - began, 1)


def _place(folder: Path, case: RobotCase, ending: str) -> Path:
    return folder / f"{case.answer.recording}.{ending}"


def _second(folder: Path, case: RobotCase) -> Path:
    return folder / "second" / f"{case.answer.recording}.csv.gz"


if __name__ == "__main__":
    main()
