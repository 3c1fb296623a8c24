"""Diagnoses of robots whose hidden effects an independent simulator made.

    python benchmarks/robot_blind.py [--count 60] [--seed 8105] [--commands] [--write]
    python benchmarks/robot_blind.py --imperfect [--reference] [--count 60] [--seed 9127] [--write]

Three nominal models of `config/robots` (an arm of six joints, a double pendulum, a finger with
tendons). The hidden side is the rigid-body code, friction, drives and sensors of
`cablesense_plants`, which shares nothing with the diagnosis. Every robot is recorded twice: the
amended model of the first recording predicts the second. Seeds up to 8104, 8310 and 8311 were used
while the diagnosis was made. With `--commands` no torque is recorded, and no cause shows in
torques alone; with `--play` all that is hidden is backlash, which few joints of the other two
show; with `--tendons` a finger has tendons over guides, which rub in half of the cases, while of
the others half have other friction. With `--imperfect` the models lack friction by position,
springs and ripples, which make 5 to 15 % of the torque; with `--reference` another recording,
without the hidden effects, is the reference (seed 9001 was used while that was made). With
`--folder` it continues where it was stopped; after `--minutes` it begins no further case, and
scores those that are done.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import numpy as np
import pandas as pd

from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.scoring import Truth, places_right, proportion, score
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, read_verdict, removed_fraction
from cablesense_gap.verdict import write_verdict as write
from cablesense_plants.cases import write_answers
from cablesense_plants.robot.cases import RobotAnswer as Hidden
from cablesense_plants.robot.cases import (
    RobotCase,
    drawn,
    record,
    with_play,
    with_tendons,
)

_LONG_ROWS = 20_000
_TOGETHER = 10
"""Cases of one model that are simulated at once."""


def main() -> None:
    """Draws, records, diagnoses, scores and prints; keeps all of it with `--write`."""
    parser = harness.parser(__doc__, "robot_blind.json, or …_forward and so on")
    parser.add_argument("--count", type=int, default=60, help="cases")
    parser.add_argument("--seed", type=int, default=8105, help="of the plant")
    parser.add_argument("--first", type=int, help="run only the first cases of the set")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further case")
    parser.add_argument("--folder", type=Path, help="of recordings and verdicts, continued there")
    parser.add_argument("--commands", action="store_true", help="record them, and no torques")
    parser.add_argument("--play", action="store_true", help="hide backlash alone, in two links")
    parser.add_argument("--tendons", action="store_true", help="hide friction over guides")
    parser.add_argument("--imperfect", action="store_true", help="models that lack something")
    parser.add_argument("--reference", action="store_true", help="diagnose what changed")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="robot_blind_"))
    usual = partial(drawn, commands=options.commands, imperfect=options.imperfect)
    drawing = with_play if options.play else with_tendons if options.tendons else usual
    cases = drawing(options.count, options.seed)[: options.first]
    write_answers(folder / "answers" / "answers.csv", [case.answer for case in cases])
    until, done = time.monotonic() + 60.0 * options.minutes, {}
    since = "since." if options.reference else ""
    _record(cases, folder, until)
    for case in cases:
        if not _place(folder, case, f"{since}second.json").exists():
            if time.monotonic() > until or not _second(folder, case).exists():
                continue
            _diagnose(case, folder, since, torques=not options.commands)
        verdict = read_verdict(_place(folder, case, f"{since}verdict.json"))
        removed = json.loads(_place(folder, case, f"{since}second.json").read_text())
        done[case.answer.recording] = verdict, removed
        print(_line(case.answer, verdict, removed), flush=True)
    hidden = [case.answer for case in cases if case.answer.recording in done]
    if not hidden:
        print(f"no case was done in time; go on with --folder {folder}")
        return
    verdicts = {name: verdict for name, (verdict, _) in done.items()}
    result = {
        **harness.origin("mujoco"),
        "seed": options.seed,
        "minutes_of_diagnosing": round(sum(v.seconds or 0.0 for v in verdicts.values()) / 60.0, 1),
        f"seconds of {_LONG_ROWS:,} rows of a 6-joint arm": _long_s(
            cases, folder, until, torques=not options.commands
        ),
        **scored(hidden, verdicts, {name: removed for name, (_, removed) in done.items()}),
    }
    result["each_case"] = [
        harness.case(h.recording, h.effects, *done[h.recording]) for h in hidden
    ]
    names = {"_forward": "commands", "_play": "play", "_tendons": "tendons"}
    names |= {"_imperfect": "imperfect", "_reference": "reference"}
    kind = "".join(part for part, option in names.items() if getattr(options, option))
    harness.publish(f"robot_blind{kind}.json", result, options)


def scored(
    hidden: Sequence[Hidden], verdicts: Mapping[str, Verdict], second: Mapping[str, float]
) -> dict[str, Any]:
    """Shares of verdicts that are right: in all, by model, and as the bars have them."""
    truth = {h.recording: _answer(h) for h in hidden}
    kinds = {h.recording: _kind(h) for h in hidden}

    def of(*wanted: str) -> list[Hidden]:
        return [h for h in hidden if kinds[h.recording] in wanted]

    def removed(chosen: Sequence[Hidden], by: Mapping[str, float]) -> float | None:
        found = [by[h.recording] for h in chosen]
        return round(float(np.median(found)), 3) if found else None

    def exact(chosen: Sequence[Hidden]) -> dict[str, Any]:
        right = [verdicts[h.recording].effects == truth[h.recording].effects for h in chosen]
        found = proportion(right)
        return {"right": found.hits, "of": found.count, "ci95": found.ci95}

    single, several = of("one"), of("several")
    right = [h for h in single if verdicts[h.recording].effects == truth[h.recording].effects]
    placed = [
        places_right(verdicts[h.recording], truth[h.recording].where) is True
        for h in right
        if h.where
    ]
    budgets = score(verdicts, [truth[h.recording] for h in several]).budgets if several else None
    whole = asdict(score(verdicts, list(truth.values())))
    del whole["budgets"]["shares"]  # of the verdict's floors, while answers count samples' noise
    models = dict.fromkeys(h.robot for h in hidden)
    held_out = {name: verdict.gap.removed_fraction for name, verdict in verdicts.items()}
    return {
        "none": exact(of(NONE)),
        "unknown": exact(of(UNKNOWN)),
        "one effect": exact(single),
        "several effects, all named": exact(several),
        "several effects, named": [budgets.named.hits, budgets.named.count] if budgets else None,
        "several effects, false names": (
            [budgets.false_names.hits, budgets.false_names.count] if budgets else None
        ),
        "places of those right": [sum(placed), len(placed)],
        "median gap removed, one effect, held-out trials": removed(single, held_out),
        "median gap removed, one effect, second recording": removed(single, second),
        "by model": {name: exact([h for h in hidden if h.robot == name]) for name in models},
        "score": whole,
    }


def _answer(hidden: Hidden) -> Truth:
    return Truth(
        recording=hidden.recording,
        effects=tuple(hidden.effects.split("+")),
        where=hidden.where,
        gap_over_floor=hidden.gap_over_floor,
        each_gap_n=tuple(float(gap) for gap in hidden.each_gap_n.split()),
    )


def _kind(hidden: Hidden) -> str:
    if hidden.effects in (NONE, UNKNOWN):
        return hidden.effects
    return "several" if "+" in hidden.effects else "one"


def _record(cases: Sequence[RobotCase], folder: Path, until: float) -> None:
    for kind in dict.fromkeys(case.kind.name for case in cases):
        own = [c for c in cases if c.kind.name == kind and not _second(folder, c).exists()]
        for begin in range(0, len(own), _TOGETHER):
            if time.monotonic() > until:
                return
            record(own[begin : begin + _TOGETHER], folder)


def _read(path: Path, robot: Robot, *, torques: bool) -> RobotRecording:
    recording = read_recording(path, robot)
    unread = np.full_like(recording.torque, np.nan)
    return recording if torques else replace(recording, torque=unread)


def _diagnose(case: RobotCase, folder: Path, since: str, *, torques: bool) -> None:
    """Leaves the verdict, and the share of the gap removed on the second recording."""
    robot = load_robot(case.kind.path)
    path = _place(folder, case, "csv.gz")
    read = partial(_read, robot=robot, torques=torques)
    healthy = read(path.parent / "reference" / path.name) if since else None
    found = diagnose(read(path), robot, reference=healthy)
    motion = prepared(read(_second(folder, case)), robot)
    simulator = RobotSystem(robot, motion, {})
    variants = (simulator.predict([each])[0] for each in ({}, found.amended))
    before, after = (
        float(np.sqrt(((simulator.readings - each) ** 2).mean())) for each in variants
    )
    write(_place(folder, case, f"{since}verdict.json"), found.verdict)
    share = removed_fraction(before, after, simulator.floor)
    _place(folder, case, f"{since}second.json").write_text(json.dumps(share))


def _long_s(
    cases: Sequence[RobotCase], folder: Path, until: float, *, torques: bool
) -> float | None:
    """Seconds from the file to the verdict, for a recording of an arm with `_LONG_ROWS` rows."""
    case = next((c for c in cases if c.kind.name == "arm_6" and "+" in c.answer.effects), None)
    if case is None or time.monotonic() > until:
        return None
    table = pd.read_csv(_place(folder, case, "csv.gz"))
    at = np.linspace(0.0, len(table) - 1.0, _LONG_ROWS)
    long = {name: np.interp(at, np.arange(len(table)), table[name]) for name in table}
    long["trial"] = np.floor(long["trial"])
    with tempfile.TemporaryDirectory() as beside:
        path = Path(beside) / "long.csv"
        pd.DataFrame(long).to_csv(path, index=False)
        began, robot = time.monotonic(), load_robot(case.kind.path)
        diagnose(_read(path, robot, torques=torques), robot)
    return round(time.monotonic() - began, 1)


def _place(folder: Path, case: RobotCase, ending: str) -> Path:
    return folder / f"{case.answer.recording}.{ending}"


def _second(folder: Path, case: RobotCase) -> Path:
    return folder / "second" / f"{case.answer.recording}.csv.gz"


def _line(hidden: Hidden, verdict: Verdict, removed: float) -> str:
    named = "+".join(verdict.effects)
    mark = " " if named == hidden.effects else "X"
    places = " ".join(verdict.where.places)
    return (
        f"{mark} {hidden.recording} {hidden.robot:9} {hidden.effects} [{hidden.where}] "
        f"({hidden.form}, {hidden.gap_over_floor:.1f}) -> {named} [{places}] "
        f"{verdict.probability:.2f}, {verdict.gap.before_n:.1f} to {verdict.gap.after_n:.2f}, "
        f"second {removed:.2f}, {verdict.seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
