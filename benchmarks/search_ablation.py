"""What each constant of the search does: diagnoses as they are, and with one constant off.

    python benchmarks/search_ablation.py [--arms 6] [--history 1] [--robots 2] [--write]

Recordings come from the independent plant, with none to three effects that are known, thinned to
one row a second. Each is diagnosed with all constants as they are, then with one of them at a
neutral value: a limit without an end, a margin of zero, a step that is so small that it no longer
matters. A constant that changes neither a verdict, nor a probability by 0.01, nor the number of
simulated variants, did nothing here. Constants of history-dependent effects are tried on arms with
friction and creep, which take minutes, and those of the residual that a healthy machine leaves on
arms with a reference.

Predictions of one recording are remembered over its diagnoses. The seconds are those of one
diagnosis on its own: the time of each remembered prediction counts where it is asked for. With
`--folder` a run continues where it was stopped.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import blind_sets
import harness
import numpy as np
from numpy.typing import NDArray
from robot_sets import KINDS

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis import (
    discrepancy,
    fitting,
    linear_fit,
    nuisance,
    probability,
    problem,
    search,
    selection,
)
from cablesense_gap.pipeline import diagnose_system
from cablesense_gap.reference import Reference
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem
from cablesense_gap.scoring import Truth, read_answers
from cablesense_gap.simulator import Assignment, Simulator
from cablesense_gap.system import System, Unlisted
from cablesense_gap.verdict import NONE, UNKNOWN
from cablesense_plants.arm.blind_cases import record_cases
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.listed import LISTED
from cablesense_plants.cases import in_turn, write_answers
from cablesense_plants.robot.cases import draw_case, record
from cablesense_plants.robot.causes import LISTED as ROBOT_LISTED
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import rows_to_use
from cablesense_sim.arm import find_arm

ARM = Path(__file__).with_name("arms") / "two_segments.yaml"
"""A small arm: a diagnosis repeats in a second or two."""
RATE_HZ = 1.0
"""Of the arm's recordings: a fifth of the rows of other benchmarks."""
HISTORY = ("cable_creep", "capstan_friction", "joint_friction")
"""Effects of the plant's list that make readings depend on the past."""
MEMORYLESS = tuple(name for name in LISTED if name not in HISTORY)
COUNTS = (1, 2, 3, 0)
"""Hidden effects of the cases in turn."""
ROBOTS = ("finger", "two_links")
"""Kinds of robots in turn: those with few joints, whose diagnoses take seconds."""
NO_END = 10**6
"""A limit that no search meets."""
ALIKE = 0.01
"""Difference of the probability of a verdict that is none."""
AS_IS = "as is"

_MODULES = (discrepancy, fitting, linear_fit, probability, problem, search, selection, nuisance)


@dataclass(frozen=True)
class Constant:
    """A constant of the diagnosis, by the module that defines it, and its neutral value."""

    module: Any
    name: str
    neutral: Any

    @property
    def label(self) -> str:
        """As in `search._RIVAL_COST_RATIO`."""
        return f"{self.module.__name__.rpartition('.')[2]}.{self.name}"

    @property
    def value(self) -> Any:
        """As it is."""
        return getattr(self.module, self.name)

    @contextmanager
    def off(self) -> Iterator[None]:
        """The constant has its neutral value in the block, also where it is imported."""
        usual = self.value
        holders = [self.module]
        if not self.name.startswith("_"):
            holders = [module for module in _MODULES if hasattr(module, self.name)]
        for module in holders:
            setattr(module, self.name, self.neutral)
        try:
            yield
        finally:
            for module in holders:
                setattr(module, self.name, usual)


CONSTANTS = (
    Constant(search, "_MOST_EXPANDED", NO_END),
    Constant(search, "_MOST_FRUITLESS", NO_END),
    Constant(search, "_FITTED_ADDITIONS", 1),
    Constant(search, "_ROUGH_STEPS", fitting.MOST_STEPS),
    Constant(search, "_RIVAL_COST_RATIO", np.inf),
    Constant(search, "_IMPROVED_COST_RATIO", 1.0),
    Constant(search, "_REDUNDANT_COST_RATIO", 1.0),
    Constant(search, "_RESOLVED_FLOOR_RATIO", 0.0),
    Constant(search, "_RESOLVED_GAP_SHARE", 0.0),
    Constant(selection, "_SHAPE_STEP", 0.03),
    Constant(selection, "_MOST_CHANGE", np.inf),
    Constant(selection, "MOST_EFFECTS", NO_END),
    Constant(selection, "_WIDTH", 1),
    Constant(selection, "_SCORED_EXACTLY", 1),
    Constant(selection, "_GROWTH_COST_RATIO", 1.0),
    Constant(selection, "_MOST_PAIRED", 0),
    Constant(selection, "_WEIGHTINGS", 1),
    Constant(problem, "EFFECT_WORTH", 1.0),
    Constant(problem, "PLACE_WORTH", 1.0),
    Constant(problem, "CHOICE_WORTH", 0.0),
    Constant(problem, "RESOLUTION", 0.01),
    Constant(problem, "_EXPLAINED_RATIO", 0.0),
    Constant(problem, "_SHOWN_FLOORS", 0.0),
    Constant(problem, "_CHANCE_QUANTILE", 0.0),
    Constant(problem, "_UNSEEN", 0.0),
    Constant(problem, "_WORTH_MIXING", 0.0),
    Constant(linear_fit, "CORRELATION", 1.0),
    Constant(fitting, "MOST_STEPS", NO_END),
    Constant(fitting, "_DERIVATIVE_STEP", 0.003),
    Constant(fitting, "_NEAR_DISTANCE", 0.0),
    Constant(fitting, "_CONVERGED_STEP", 1e-9),
    Constant(fitting, "_CONVERGED_GAIN", 0.0),
    Constant(fitting, "_FIRST_DAMPING", 1e-6),
    Constant(fitting, "_MOST_DAMPING", 0.0),
    Constant(fitting, "_BOUND_PASSES", 1),
    Constant(fitting, "_SCALES", (1.0,)),
    Constant(fitting, "_STEPS_OF_PART", fitting.MOST_STEPS),
    Constant(fitting, "_LEAST_DIVISOR", 1e-3),
    Constant(nuisance, "_STEP_OF_STD", 0.01),
    Constant(nuisance, "_STEP_OF_EFFECT", 0.003),
    Constant(nuisance, "_STEP_OF_FLOOR", np.inf),
    Constant(nuisance, "_MOST_REPEATED", 0),
    Constant(nuisance, "_SAME_OF_STD", 0.0),
    Constant(nuisance, "_MOST_OFF", np.inf),
    Constant(nuisance, "_STEPS_ANEW", fitting.MOST_STEPS),
    Constant(probability, "PARALLEL", 1.1),
    Constant(probability, "_SEVERAL_LEFT", 0.0),
    Constant(probability, "_NEEDED_COST_RATIO", 1.0),
)
"""Those that decide something. What only keeps a division from zero is left out, as are
`NEAR_BEST`, which is for the report, and the share of the progress."""

OF_HISTORY = (
    Constant(search, "_SUBSAMPLE_RIVAL_COST_RATIO", np.inf),
    Constant(fitting, "_CONVERGED_SHARE", 0.0),
    Constant(fitting, "_LEAST_START", 1e-3),
    Constant(probability, "_AGAINST_MOTION_LEFT", 1e-6),
    Constant(fitting, "_SCALES", (1.0,)),
    Constant(search, "_MOST_FRUITLESS", NO_END),
    Constant(search, "_RIVAL_COST_RATIO", np.inf),
)
"""Those of history-dependent effects, and limits of the time that their fits take."""

OF_A_REFERENCE = (
    Constant(discrepancy, "_WAVES", 1),
    Constant(discrepancy, "_SLIDING_WAVES", 0),
    Constant(discrepancy, "_SLOW", (1.0, 1.0)),
    Constant(discrepancy, "_MARGIN", NO_END),
    Constant(discrepancy, "_ITERATIONS", 1),
    Constant(discrepancy, "_FIRST_SCATTER", 1.0),
    Constant(discrepancy, "_LEAST_FREE", 0.0),
)
"""Those of the residual that a healthy machine leaves. Powers of a position are of robots whose
references move, and are left out."""


def main() -> None:
    """Records, diagnoses, counts and prints; keeps the figures with `--write`."""
    parser = harness.parser(__doc__, "search_ablation.json")
    parser.add_argument("--arms", type=int, default=6, help="recordings of arms")
    parser.add_argument("--history", type=int, default=1, help="of arms with friction or creep")
    parser.add_argument("--robots", type=int, default=2, help="recordings of robots")
    parser.add_argument("--references", type=int, default=1, help="of arms with a reference")
    parser.add_argument("--seed", type=int, default=9811, help="of the plant")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further recording")
    parser.add_argument("--folder", type=Path, help="of recordings, continued there")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="search_ablation_"))
    until_s = time.time() + 60.0 * options.minutes
    seed = options.seed
    sets: dict[str, Callable[[Path], tuple[Truth, ...]]] = {
        "arms": lambda own: _drawn_arms(own, options.arms, seed, MEMORYLESS),
        "history": lambda own: _drawn_arms(own, options.history, seed + 1, HISTORY),
        "references": lambda own: _drawn_arms(own, options.references, seed + 2, MEMORYLESS),
        "robots": lambda own: _drawn_robots(own, options.robots, seed),
    }
    figures: dict[str, Any] = {"arm": ARM.stem, "robots": ROBOTS, "seed": options.seed}
    for name, drawn in sets.items():
        answers = drawn(folder / name) if time.time() < until_s else ()
        paths = [_path(folder / name, answer) for answer in answers]
        work = partial(_finished, name, until_s)
        outcomes = blind_sets.in_pool(work, paths, options.workers)
        done = [(a, each) for a, each in zip(answers, outcomes, strict=True) if each]
        figures[name] = _figures(done, _constants_of(name))
    _print(figures)
    harness.publish("search_ablation.json", figures, options)


def _constants_of(name: str) -> tuple[Constant, ...]:
    return {"references": OF_A_REFERENCE, "history": OF_HISTORY}.get(name, CONSTANTS)


def _path(folder: Path, answer: Truth) -> Path:
    suffix = "csv.gz" if folder.name == "robots" else "csv"
    return folder / f"{answer.recording}.{suffix}"


def _names(seed: int, listed: Sequence[str], count: int) -> list[list[str]]:
    """Names of the effects of each case; none comes twice before all have come once."""
    turn = in_turn(np.random.default_rng([seed]), list(listed))
    cases = []
    for k in range(count):
        chosen: list[str] = []
        while len(chosen) < COUNTS[k % len(COUNTS)]:
            name = next(turn)
            if name not in chosen:
                chosen.append(name)
        cases.append(sorted(chosen))
    return cases


def _drawn_arms(folder: Path, count: int, seed: int, effects: Sequence[str]) -> tuple[Truth, ...]:
    answers_file = folder / "answers" / "answers.csv"
    if not answers_file.exists() and count:
        nominal = replace(read_nominal(find_arm(str(ARM))), rate_hz=RATE_HZ)
        kinds = ["+".join(names) or NONE for names in _names(seed, effects, count)]
        imperfect = folder.name == "references"
        made = record_cases(folder, answers_file, nominal, count, seed, kinds, imperfect=imperfect)
        list(made)
    return read_answers(answers_file) if count else ()


def _drawn_robots(folder: Path, count: int, seed: int) -> tuple[Truth, ...]:
    answers_file = folder / "answers" / "answers.csv"
    if not answers_file.exists() and count:
        cases = [
            draw_case(KINDS[ROBOTS[k % len(ROBOTS)]], names, seed, k + 1, [ROBOT_LISTED])
            for k, names in enumerate(_names(seed, list(ROBOT_LISTED), count))
        ]
        for case in cases:
            record([case], folder)
        write_answers(answers_file, [case.answer for case in cases])
        for case in cases:
            kind_file = folder / f"{case.answer.recording}.kind"
            kind_file.write_text(case.kind.name, encoding="utf-8")
    return read_answers(answers_file) if count else ()


class _Remembered:
    """A simulator that keeps what it predicted, and counts what it was asked."""

    def __init__(self, *arguments: Any) -> None:
        self._known: dict[Hashable, tuple[Array, float]] = {}
        self.variants = 0
        self.saved_s = 0.0
        super().__init__(*arguments)

    def forget(self) -> None:
        """Predict anew from now on."""
        self._known.clear()

    def _once(self, key: Hashable, count: int, predicted: Callable[[], Array]) -> Array:
        self.variants += count
        if key in self._known:
            result, seconds = self._known[key]
            self.saved_s += seconds
        else:
            began_s = time.process_time()
            result = predicted()
            self._known[key] = result, time.process_time() - began_s
        return result.copy()

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """As of the simulator, (P, R, C)."""
        key = tuple(tuple(variant.items()) for variant in variants)
        above: Any = super()
        return self._once(key, len(variants), lambda: above.predict(variants))


class _RememberedArm(_Remembered):
    """The same of an arm, which knows its derivatives."""

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """As of the simulator, (P, R, C)."""
        key = ("small", tuple(base.items()), tuple(tuple(v.items()) for v in variants))
        above: Any = super()
        return self._once(key, len(variants), lambda: above.small_changes(base, variants))


class _Unreported(System):
    """A system whose report says nothing: experiments and patterns take time, and name nothing."""

    def next_experiment(self, rivals: Sequence[Assignment], question: str) -> str:
        """None."""
        return ""

    def repetition(self, residual: Array) -> str:
        """None."""
        return ""

    def unlisted(self, problem: problem.Problem, residual: Array) -> Unlisted:
        """No pattern."""
        return Unlisted((), "", 0.0)


class _Subsample(_RememberedArm, ArmSimulator):
    """An arm at some rows of its recording."""


class _Arm(_Unreported, _RememberedArm, ArmSystem):
    """An arm with its recording."""

    _subsample: tuple[_Subsample, NDArray[np.int64]] | None = None

    def subsample(self) -> tuple[Simulator, NDArray[np.int64]] | None:
        """As of the arm, remembered too."""
        if self._subsample is None and (part := super().subsample()) is not None:
            rows = part[1]
            self._subsample = _Subsample(self.arm, self.recording.rows(rows)), rows
        return self._subsample


class _Robot(_Unreported, _Remembered, RobotSystem):
    """A robot with its recording."""


def _arm_system(path: Path) -> _Arm:
    arm = blind_sets.narrow_arm(str(ARM))
    recording = read_recording(path, arm)
    return _Arm(arm, recording.rows(rows_to_use(recording)))


def _robot_system(path: Path) -> _Robot:
    name = path.with_name(f"{path.name.partition('.')[0]}.kind").read_text(encoding="utf-8")
    robot = load_robot(KINDS[name].path)
    return _Robot(robot, prepared(read_robot_recording(path, robot), robot), {})


def _finished(set_name: str, until_s: float, path: Path) -> Any:
    return harness.kept(
        path.with_name(f"{path.name}.json"), partial(_outcomes, set_name, path), until_s
    )


def _systems(set_name: str, path: Path) -> tuple[Any, Any]:
    """The machine with its recording, and with that of when it was healthy, if there is one."""
    if set_name == "robots":
        return _robot_system(path), None
    reference = path.parent / "reference" / path.name
    return _arm_system(path), _arm_system(reference) if set_name == "references" else None


def _outcomes(set_name: str, path: Path) -> dict[str, Any]:
    """The outcome of a recording by the constant that is off."""
    system, healthy = _systems(set_name, path)
    outcomes = {AS_IS: _as_is(system, healthy)}
    for constant in _constants_of(set_name):
        with constant.off():
            outcomes[constant.label] = _diagnosed(system, healthy)
    return outcomes


def _as_is(system: Any, healthy: Any) -> dict[str, Any]:
    """The usual outcome, after a first one that compiles and finds what a system keeps."""
    _diagnosed(system, healthy)
    for simulator in _simulators(system, healthy):
        simulator.forget()
    return _diagnosed(system, healthy)


def _simulators(system: Any, healthy: Any) -> list[Any]:
    part = system.subsample()
    return [each for each in (system, healthy, part and part[0]) if each]


def _diagnosed(system: Any, healthy: Any) -> dict[str, Any]:
    simulators = _simulators(system, healthy)
    variants = sum(each.variants for each in simulators)
    saved_s = sum(each.saved_s for each in simulators)
    began_s = time.process_time()
    try:
        reference = None if healthy is None else Reference(healthy)
        verdict = diagnose_system(system, reference=reference).verdict
        named = "+".join(verdict.effects)
        sure = verdict.probability
    except (ArithmeticError, AssertionError, IndexError, ValueError) as error:
        named = f"failed: {type(error).__name__}"
        sure = 0.0
    seconds = time.process_time() - began_s
    return {
        "named": named,
        "probability": round(sure, 4),
        "variants": sum(each.variants for each in simulators) - variants,
        "seconds": round(seconds + sum(each.saved_s for each in simulators) - saved_s, 2),
    }


def _figures(
    done: Sequence[tuple[Truth, Mapping[str, Mapping[str, Any]]]], constants: Sequence[Constant]
) -> dict[str, Any]:
    """Sums over the cases, as they are and with each constant off; the verdicts as they are."""
    if not done:
        return {"cases": 0}
    by_constant = {}
    for label in (AS_IS, *(constant.label for constant in constants)):
        usual = [outcomes[AS_IS] for _, outcomes in done]
        tried = [outcomes[label] for _, outcomes in done]
        truths = [answer.effects for answer, _ in done]
        by_constant[label] = _sums(truths, usual, tried)
    for constant in constants:
        entry = by_constant[constant.label]
        entry["value"] = repr(constant.value)
        entry["off"] = repr(constant.neutral)
    unchanged = [
        label
        for label, entry in by_constant.items()
        if label != AS_IS and not (entry["moved"] or entry["other_simulations"])
    ]
    return {
        "cases": len(done),
        "hidden": sum(len(_listed(answer.effects)) for answer, _ in done),
        "did_nothing": unchanged,
        "by_constant": by_constant,
        "each_case": [
            {"case": answer.recording, "hidden": "+".join(answer.effects), **outcomes[AS_IS]}
            for answer, outcomes in done
        ],
    }


def _listed(effects: Sequence[str]) -> set[str]:
    return set(effects) - {NONE, UNKNOWN}


def _sums(
    truths: Sequence[Sequence[str]],
    usual: Sequence[Mapping[str, Any]],
    tried: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Names, changes against the usual outcomes, and the cost of one setting."""
    right_names = 0
    false_names = 0
    exact = 0
    failed = 0
    other_verdicts = 0
    moved = 0
    other_simulations = 0
    for truth, before, after in zip(truths, usual, tried, strict=True):
        fails = after["named"].startswith("failed")
        named = set() if fails else _listed(after["named"].split("+"))
        wanted = _listed(truth)
        right_names += len(named & wanted)
        false_names += len(named - wanted)
        exact += after["named"] == "+".join(truth)
        failed += fails
        other = after["named"] != before["named"]
        other_verdicts += other
        moved += other or abs(after["probability"] - before["probability"]) >= ALIKE
        other_simulations += after["variants"] != before["variants"]
    return {
        "right_names": right_names,
        "false_names": false_names,
        "exact": exact,
        "failed": failed,
        "other_verdicts": other_verdicts,
        "moved": moved,
        "other_simulations": other_simulations,
        "variants": sum(each["variants"] for each in tried),
        "seconds": round(sum(each["seconds"] for each in tried), 1),
    }


def _print(figures: Mapping[str, Any]) -> None:
    for name in ("arms", "history", "references", "robots"):
        group_figures = figures[name]
        if not group_figures["cases"]:
            continue
        print(f"{name}: {group_figures['cases']} cases, {group_figures['hidden']} hidden effects")
        print(f"{'constant off':42} right false exact other moved variants seconds")
        for label, entry in group_figures["by_constant"].items():
            print(
                f"{label:42} {entry['right_names']:5} {entry['false_names']:5} "
                f"{entry['exact']:5} {entry['other_verdicts']:5} {entry['moved']:5} "
                f"{entry['variants']:8} {entry['seconds']:7.1f}"
            )


if __name__ == "__main__":
    main()
