"""The diagnosis beside `mujoco.sysid` on the same recordings: what each leaves, takes and says.

    python benchmarks/peer.py [--count 12] [--seed 5914] [--data DIR] [--write]

The robots are drawn as those of `robot_blind.py`: nothing hidden, a cause that no verdict can
name, one effect, or several. Both get one recording. Their models are judged on a second one,
which neither has seen: by the torques that its motion needs, and by the motion that its torques
make in short windows; both in floors. With `--data`, the folder of the double pendulums that
`real_robots.py` reads, every other run of these is fitted, and the runs between are judged.

`mujoco.sysid` fits all parameters at once (`peer_fit.py` has how it is set). What it can say of
causes are 95 % intervals of these, so those are counted that exclude the nominal value. Seeds 777
and 778 were used while it was set.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import blind_sets
import harness
import peer_fit
from real_robots import DESIGNS, pendulum_runs, torque_errors
from robot_sets import drawn

from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import Motion, rms
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_robot_recording
from cablesense_gap.robot.system import RobotDiagnosis, RobotSystem, diagnose
from cablesense_gap.simulator import Assignment
from cablesense_gap.verdict import NONE
from cablesense_plants.robot.cases import RobotCase, record

_BOTH = ("diagnosis", "sysid")
_JUDGED = ("torques", "motion")


@dataclass(frozen=True)
class _Model:
    """A robot, and effects that its file does not have."""

    robot: Robot
    effects: Assignment


@dataclass(frozen=True)
class _Compared:
    """What both made of one recording.

    Attributes:
        diagnosis: that of this project.
        models: the nominal one and both amended ones, by name.
        effort: processor time of both, and what the peer's numbers say.
    """

    diagnosis: RobotDiagnosis
    models: dict[str, _Model]
    effort: dict[str, Any]

    @property
    def named(self) -> dict[str, Any]:
        """The effects that the diagnosis names, and how sure it is."""
        verdict = self.diagnosis.verdict
        return {"named": "+".join(verdict.effects), "probability": round(verdict.probability, 3)}


def main() -> int:
    """Draws, records, fits with both, judges, prints; keeps the figures with `--write`."""
    parser = blind_sets.parser(__doc__, "results/peer.json", seed=5914)
    parser.set_defaults(count=12)
    parser.add_argument("--data", type=Path, help="of the double pendulums")
    options = parser.parse_args()
    folder = blind_sets.folder_of(options)
    folder.mkdir(parents=True, exist_ok=True)
    until_s = time.time() + 60.0 * options.minutes
    cases = drawn(options.count, options.seed)
    of_robots = {case.answer.recording: partial(_planted, case, folder) for case in cases}
    designs = DESIGNS if options.data else ()
    of_pendulums = {name: partial(_pendulum, name, options.data, folder) for name in designs}
    each_case = _each(of_robots, folder, until_s)
    each_pendulum = _each(of_pendulums, folder, until_s)
    figures = {
        "seed": options.seed,
        "drawn": options.count,
        **_summary(each_case),
        "each_case": each_case,
        "each_pendulum": each_pendulum,
    }
    return harness.publish("peer.json", figures, options, "mujoco", "scipy")


def _each(
    judged: Mapping[str, Callable[[], dict[str, Any]]], folder: Path, until_s: float
) -> list[dict[str, Any]]:
    """The outcomes by name, as far as there is time."""
    outcomes = []
    for name, judge in judged.items():
        outcome = harness.kept(folder / f"{name}.json", judge, until_s)
        if outcome is not None:
            print(outcome, flush=True)
            outcomes.append(outcome)
    return outcomes


def _planted(case: RobotCase, folder: Path) -> dict[str, Any]:
    """Both on one recording of a robot, judged on its second one."""
    record([case], folder)
    name = f"{case.answer.recording}.csv.gz"
    robot = load_robot(case.kind.path)
    seen = read_robot_recording(folder / name, robot)
    unseen = read_robot_recording(folder / "second" / name, robot)
    model_file = folder / f"{case.answer.recording}_sysid.xml"
    compared = _fitted_by_both(seen, robot, model_file)
    compared_hz = compared.diagnosis.system.motion.compared_hz
    motions = [prepared(unseen, robot, compared_hz, forward=forward) for forward in (False, True)]
    return {
        "case": f"{robot.name}, {case.answer.recording}",
        "hidden": case.answer.effects,
        **compared.named,
        "right": set(compared.diagnosis.verdict.effects) == set(case.answer.effects.split("+")),
        "floors_left": {
            judged: _floors_left(compared.models, motion)
            for judged, motion in zip(_JUDGED, motions, strict=True)
        },
        **compared.effort,
    }


def _pendulum(design: str, data: Path, folder: Path) -> dict[str, Any]:
    """Both on every other run of a design, judged on the runs between, in N·m."""
    runs = pendulum_runs(design, data)
    model_file = folder / f"pendulum_{design}_sysid.xml"
    compared = _fitted_by_both(runs.diagnosed, runs.robot, model_file, zeroed=True)
    compared_hz = compared.diagnosis.system.motion.compared_hz
    motion = prepared(runs.judged, runs.robot, compared_hz, zeroed=True)
    return {
        "case": f"double pendulum {design}",
        **compared.named,
        "torque_error_n_m": {
            name: torque_errors(model.robot, motion, model.effects)[-1]
            for name, model in compared.models.items()
        },
        **compared.effort,
    }


def _fitted_by_both(
    recording: RobotRecording, robot: Robot, model_file: Path, *, zeroed: bool = False
) -> _Compared:
    """The diagnosis of a recording, and the fit of the peer."""
    began_s = time.process_time()
    diagnosis = diagnose(recording, robot, zeroed=zeroed)
    cpu_s = time.process_time() - began_s
    fit = peer_fit.fitted(robot, diagnosis.system.motion, model_file)
    models = {
        "nominal": _Model(robot, {}),
        "diagnosis": _Model(robot, diagnosis.amended),
        "sysid": _Model(fit.robot, fit.offsets),
    }
    effort = {
        "cpu_s": {"diagnosis": round(cpu_s, 1), "sysid": round(fit.cpu_s, 1)},
        "sysid": {
            "parameters": fit.parameters,
            "differing": fit.differing,
            "at_bounds": fit.at_bounds,
            "evaluations": fit.evaluations,
        },
    }
    return _Compared(diagnosis, models, effort)


def _floors_left(models: Mapping[str, _Model], motion: Motion) -> dict[str, float]:
    """RMS of measured minus predicted over all channels, in floors of the nominal model."""
    floor = RobotSystem(models["nominal"].robot, motion, {}).scale
    floors = {}
    for name, model in models.items():
        system = RobotSystem(model.robot, motion, {})
        residual = (system.readings - system.predict([model.effects])[0]) * system.scale
        floors[name] = round(rms(residual / floor), 2)
    return floors


def _summary(each_case: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians and extremes over the planted robots; how many verdicts are exactly right."""

    def differing(hidden: bool) -> list[int]:
        return [
            case["sysid"]["differing"] for case in each_case if (case["hidden"] != NONE) == hidden
        ]

    spread = partial(harness.percentiles, names=("median", "worst"), digits=2)
    return {
        "cases": len(each_case),
        "floors_left": {
            judged: {
                name: spread([case["floors_left"][judged][name] for case in each_case])
                for name in ("nominal", *_BOTH)
            }
            for judged in _JUDGED
        },
        "cpu_s": {name: spread([case["cpu_s"][name] for case in each_case]) for name in _BOTH},
        "diagnosis_exactly_right": sum(case["right"] for case in each_case),
        "sysid_parameters": spread([case["sysid"]["parameters"] for case in each_case]),
        "sysid_differing": {
            "nothing hidden": spread(differing(hidden=False)),
            "something hidden": spread(differing(hidden=True)),
        },
    }


if __name__ == "__main__":
    raise SystemExit(main())
