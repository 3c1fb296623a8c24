"""Real double pendulums of three designs: which effects separate them from their published models.

    python benchmarks/real_double_pendulum.py --data DIR [--write]

`DIR` holds `index.csv` (recording, design) and the runs as gzipped CSV, from the repository
dfki-ric-underactuated-lab/double_pendulum (BSD 3-Clause, Copyright (c) 2022, DFKI RIC
Underactuated Robotics Lab), resampled at 200 Hz. The nominal models are the
`config/robots/double_pendulum_….xml`: published masses, lengths and inertias, no friction. Every
other run of a design is diagnosed; the amended model is judged on the runs between, by the
torques that their motion needs. The makers' software sets both encoders to zero before each run,
wherever friction lets the pendulum hang, so every run has zeros of its own, with every model.
`mujoco.sysid` fits all parameters to the same runs, over short windows from measured states, and
is judged alike; without its libraries (`pip install mujoco[sysid]`) it is left out.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import mujoco
import numpy as np
import pandas as pd

from cablesense_base import Array
from cablesense_gap.diagnosis.gauss_newton import refit
from cablesense_gap.pipeline import problem_of
from cablesense_gap.robot import smoothing
from cablesense_gap.robot.catalogue import changed
from cablesense_gap.robot.inverse import InverseDynamics
from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.report import write_robot_diagnosis
from cablesense_gap.robot.simulator import RobotSimulator
from cablesense_gap.robot.system import RobotDiagnosis, RobotSystem, diagnose
from cablesense_gap.simulator import Assignment, Term

MODELS = Path(__file__).parents[1] / "config" / "robots"
DESIGNS = {"A.0": "a0", "C.0": "c0", "C.1": "c1"}
_WINDOW_S, _STEP_S, _STATES_HZ = 0.5, 0.005, 10.0
_FITTING_STEPS = 12
_SPEEDS = (0.05, 0.2, 0.5, 1.0, 3.0, 10.0)
_FRICTION = "joint_friction.joint_{}.torque_n_m"


def main() -> None:
    """Diagnoses one half of each design's runs and judges on the other."""
    parser = harness.parser(__doc__, "real_double_pendulum.json")
    parser.add_argument("--data", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--design", choices=DESIGNS, action="append", help="only this one")
    parser.add_argument("--report", type=Path, help="folder for the report of each design")
    options = parser.parse_args()
    found = {
        design: _of_design(design, options)
        for design in DESIGNS
        if not options.design or design in options.design
    }
    result = {**harness.origin("mujoco"), "designs": found}
    harness.publish("real_double_pendulum.json", result, options)


def _of_design(design: str, options: argparse.Namespace) -> dict[str, Any]:
    index = pd.read_csv(options.data / "index.csv")
    runs = index[index.design == design].recording.tolist()
    robot = load_robot(MODELS / f"double_pendulum_{DESIGNS[design]}.xml")
    with tempfile.TemporaryDirectory() as folder:
        halves = []
        for name, own in (("fitted", runs[::2]), ("judged", runs[1::2])):
            converted(options.data, own, Path(folder) / name)
            halves.append(read_recording(Path(folder) / name, robot))
        fitted, judged = halves
    diagnosis = diagnose(fitted, robot, zeroed=True)
    if options.report is not None:
        write_robot_diagnosis(options.report / DESIGNS[design], diagnosis, {})
    verdict = diagnosis.verdict
    motion = prepared(judged, robot, diagnosis.motion.compared_hz, zeroed=True)
    as_read = replace(motion, zeroed=False)
    return {
        "diagnosed": runs[::2],
        "judged": runs[1::2],
        "effects": verdict.effects,
        "probability": round(verdict.probability, 2),
        "friction_n_m": _friction(diagnosis),
        "held-out error in floors, dry and viscous friction, N·m and N·m·s": _both_frictions(
            robot, diagnosis.motion
        ),
        "lost along the motion, N·m, by speed": _lost(robot, diagnosis),
        "parameters": {
            name: [round(estimate.value, 4), *(round(end, 4) for end in estimate.ci95)]
            for name, estimate in verdict.parameters.items()
        },
        "seconds": round(verdict.seconds or 0.0, 1),
        "compared up to, Hz": round(motion.compared_hz, 2),
        "torque error on judged runs, N·m": {
            "torque itself": _sizes(motion, motion.compared(motion.torque)),
            "published model, zeros as they are read": _errors(robot, as_read),
            "amended model, zeros as they are read": _errors(robot, as_read, diagnosis.amended),
            "published model": _errors(robot, motion),
            "amended model": _errors(robot, motion, diagnosis.amended),
            **_of_sysid(robot, fitted, motion),
        },
    }


def converted(data: Path, runs: Sequence[str], folder: Path) -> None:
    """Runs in the columns that recordings of robots have, a file each."""
    units = {"position": "rad", "torque": "nm"}
    names = {
        f"{what}_{joint}_{unit}": f"{what}.joint_{joint}"
        for what, unit in units.items()
        for joint in (1, 2)
    }
    folder.mkdir()
    for run in runs:
        table = pd.read_csv(data / f"{run}.csv.gz", usecols=["time_s", *names])
        table.rename(columns=names).to_csv(folder / f"{run}.csv.gz", index=False)


def _friction(diagnosis: RobotDiagnosis) -> list[float | None]:
    """Dry friction of both joints, where it is named."""
    found = [diagnosis.verdict.parameters.get(_FRICTION.format(joint)) for joint in (1, 2)]
    return [None if each is None else round(each.value, 3) for each in found]


def _both_frictions(robot: Robot, motion: Motion) -> dict[str, list[float]]:
    """Dry friction at both joints alone, and beside viscous: do the runs tell them apart?"""
    problem = problem_of(RobotSystem(robot, motion, {}))
    joints = ("joint_1", "joint_2")
    dry, gives, drag = (
        [Term(effect, joint, number) for joint in joints]
        for effect, number in (
            ("joint_friction", "torque_n_m"),
            ("joint_friction", "presliding_rad"),
            ("viscous_friction", "torque_s_n_m"),
        )
    )
    alone = dict.fromkeys(dry, 0.1) | dict.fromkeys(gives, 2e-3)
    found = {}
    for name, values in (("dry", alone), ("both", alone | dict.fromkeys(drag, 5e-3))):
        fitted = refit(problem, values, _FITTING_STEPS)
        if fitted is not None:
            sizes = [fitted.values[term] for term in (*dry, *drag) if term in values]
            found[name] = [round(fitted.held_out_rmse, 2), *(round(size, 4) for size in sizes)]
    return found


def _lost(robot: Robot, diagnosis: RobotDiagnosis) -> dict[str, list[float]]:
    """Median of what torques have along the motion beyond the amended model without friction."""
    motion = diagnosis.motion
    rest = {t: v for t, v in diagnosis.amended.items() if t.effect != "joint_friction"}
    without = InverseDynamics(robot, motion).torques(changed(robot, [rest]))
    lost, speed = (motion.torque - without) * np.sign(motion.speed), np.abs(motion.speed)
    return {
        f"{low} to {high} rad/s": [
            round(float(np.median(own[(least >= low) & (least < high)])), 3)
            for own, least in zip(lost.T, speed.T, strict=True)
        ]
        for low, high in pairwise(_SPEEDS)
    }


def _errors(robot: Robot, motion: Motion, effects: Assignment | None = None) -> list[float]:
    """Of a model and effects."""
    simulator = RobotSimulator(robot, motion, effects or {})
    left = simulator.readings - simulator.predict([{}])[0]
    return _sizes(motion, left * simulator.comparison.noise)


def _sizes(motion: Motion, compared: Array) -> list[float]:
    """Root mean square of what is compared, joint by joint, and of both together."""
    square = (compared**2).mean(0) / motion.counts.mean(0)
    return [round(float(np.sqrt(each)), 4) for each in (*square, square.mean())]


def _of_sysid(robot: Robot, fitted: RobotRecording, motion: Motion) -> dict[str, Any]:
    """All parameters free, by `mujoco.sysid` from the runs that were diagnosed."""
    if find_spec("absl") is None:  # mujoco.sysid then has nothing in it
        return {}
    spec = mujoco.MjSpec.from_file(str(robot.path))
    values = _identified(spec, fitted)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "identified.xml"
        spec.compile()
        path.write_text(spec.to_xml(), encoding="utf-8")
        return {
            "mujoco.sysid": _errors(load_robot(path), motion),
            "mujoco.sysid found": values,
        }


def _identified(spec: mujoco.MjSpec, fitted: RobotRecording) -> Mapping[str, float]:
    """Masses, centres, inertias, rotors, dampers and friction; leaves them in the spec."""
    sysid: Any = import_module("mujoco.sysid")  # its types would hide those of mujoco
    spec.option.timestep = _STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in ("joint_1", "joint_2"):
        for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
            sensor = {"type": kind, "objtype": mujoco.mjtObj.mjOBJ_JOINT, "objname": joint}
            spec.add_sensor(name=f"{joint}_{kind}", **sensor)
    model = spec.compile()
    states, controls, sensors = [], [], []
    for trial in np.unique(fitted.trial):
        rows = fitted.trial == trial
        time_s, torque = fitted.time_s[rows], fitted.torque[rows]
        rate_hz = 1.0 / float(np.median(np.diff(time_s)))
        position = smoothing.smoothed(fitted.position[rows], rate_hz, _STATES_HZ)
        speed, _ = smoothing.derivatives(position, rate_hz)
        count = round(_WINDOW_S * rate_hz)
        for begin in range(0, len(time_s) - count, count):
            own = slice(begin, begin + count + 1)
            since_s = time_s[own] - time_s[begin]
            states.append(sysid.create_initial_state(model, position[begin], speed[begin]))
            controls.append(sysid.TimeSeries.from_control_names(since_s, torque[own], model))
            both = np.empty((len(since_s), 4))
            both[:, ::2], both[:, 1::2] = position[own], speed[own]
            sensors.append(sysid.TimeSeries.from_names(since_s, both, model))
    names = [f"window_{w}" for w in range(len(states))]
    windows = sysid.ModelSequences("double_pendulum", spec, names, states, controls, sensors)
    parameters = sysid.ParameterDict()
    for name, value, least, most, change in _free(spec):
        parameters.add(sysid.Parameter(name, value, least, most, modifier=change))
    residual = sysid.build_residual_fn(models_sequences=[windows], n_threads=1)
    best, _ = sysid.optimize(
        parameters,
        residual,
        optimizer="scipy",
        verbose=False,
        diff_step=1e-3,
        max_iters=20,
        ftol=1e-5,
    )
    for parameter in best.parameters.values():
        parameter.apply_modifier(spec)
    return {name: round(float(p.value[0]), 4) for name, p in best.parameters.items()}


def _free(spec: mujoco.MjSpec) -> list[tuple[str, float, float, float, Any]]:
    """Name, first value, bounds and what sets it, of each parameter."""

    def of_joint(joint: str, attribute: str) -> Any:
        return lambda s, p: setattr(s.joint(joint), attribute, _as(s.joint(joint), attribute, p))

    def of_link(link: str, attribute: str, at: slice) -> Any:
        def change(s: mujoco.MjSpec, p: Any) -> None:
            getattr(s.body(link), attribute)[at] = p.value[0]

        return change

    found = []
    for n in (1, 2):
        link, joint = spec.body(f"link_{n}"), f"joint_{n}"
        mass, centre, inertia = link.mass, link.ipos[2], link.inertia[0]
        found += [
            (f"mass_{n}", mass, 0.1 * mass, 4.0 * mass, _set_mass(link.name)),
            (f"centre_{n}", centre, -0.6, -0.02, of_link(link.name, "ipos", slice(2, 3))),
            (f"inertia_{n}", inertia, 1e-4, 0.1, of_link(link.name, "inertia", slice(0, 2))),
            (f"rotor_{n}", 0.0022, 1e-5, 0.03, of_joint(joint, "armature")),
            (f"damping_{n}", 0.005, 0.0, 0.3, of_joint(joint, "damping")),
            (f"friction_{n}", 0.02, 0.0, 0.6, of_joint(joint, "frictionloss")),
        ]
    return found


def _set_mass(link: str) -> Any:
    return lambda s, p: setattr(s.body(link), "mass", float(p.value[0]))


def _as(joint: Any, attribute: str, parameter: Any) -> Any:
    """A number, or an array of one where the joint has one."""
    old, value = getattr(joint, attribute), float(parameter.value[0])
    if np.ndim(old):
        return np.array([value, *np.asarray(old)[1:]])
    return value


if __name__ == "__main__":
    main()
