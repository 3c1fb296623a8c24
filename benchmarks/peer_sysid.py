"""The diagnosis beside `mujoco.sysid`, on the same recordings of robots.

    python benchmarks/peer_sysid.py [--seed 9501] [--data DIR] [--write]

`mujoco.sysid` fits all numbers that a model has: masses and centres of all links, and each joint's
dry friction, damping and rotor, by least squares over short windows that begin at measured states.
The diagnosis names a cause. Both see the same recording of a double pendulum in which one cause is
hidden, and both models are judged by the torques that the motion of a second recording needs. With
`--data` also the real double pendulums of `real_robots.py`: every other run is fitted, the others
are judged, zeros as they are read.
"""

from __future__ import annotations

import importlib
import os
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import mujoco
import numpy as np
from real_robots import DESIGNS, pendulum_runs
from robot_sets import KINDS

from cablesense_gap.robot.model import Robot, RobotError, load_robot
from cablesense_gap.robot.motion import derivatives, rms, smoothed
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Assignment
from cablesense_plants.robot.cases import draw_case, record
from cablesense_plants.robot.causes import LISTED
from cablesense_plants.robot.friction import FRICTION
from cablesense_sim.mujoco_file import read_spec

sysid: Any = importlib.import_module("mujoco.sysid")
"""It has no types that a checker could read."""
_HIDDEN = (
    "joint_friction",
    "viscous_friction",
    "payload",
    "torque_scale",
    "lugre",
    "load_dependent",
)
_WINDOW_S = 0.25
_WINDOWS = 40
_SMOOTHED_HZ = 10.0
_DIFF_STEP = 1e-3
"""Relative step of derivatives: a roll-out is too rough for smaller ones."""
_MOST_EVALUATIONS = 25
_RELATIVE = ("mass", "centre")
"""Numbers that are 1 in the nominal model; the others are 0."""
_BEGIN = 0.1
"""Where numbers that are zero in the model begin, in their usual sizes."""


class Fit(NamedTuple):
    """What the peer fits: a model, how long it takes, and how many numbers differ from nominal."""

    robot: Robot
    seconds: float
    numbers: int
    different: int


def main() -> int:
    """Records, fits, diagnoses and compares."""
    parser = harness.parser(__doc__, "peer_sysid.json")
    parser.add_argument("--seed", type=int, default=9501)
    parser.add_argument("--data", type=Path, help="folder of the real double pendulums")
    options = parser.parse_args()
    found: dict[str, Any] = {"seed": options.seed, "planted": [], "real": []}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for index, name in enumerate(_HIDDEN, start=1):
            found["planted"].append(_planted(name, options.seed, index, folder))
            print(found["planted"][-1], flush=True)
        for design in DESIGNS if options.data else ():
            found["real"].append(_real(design, options.data, folder))
            print(found["real"][-1], flush=True)
    return harness.publish("peer_sysid.json", found, options, "mujoco")


def _planted(name: str, seed: int, index: int, folder: Path) -> dict[str, Any]:
    """One cause hidden in the double pendulum."""
    pool = FRICTION if name in FRICTION else LISTED
    case = draw_case(KINDS["two_links"], [name], seed, index, [{name: pool[name]}])
    record([case], folder)
    robot = load_robot(case.kind.path)
    path = folder / f"{case.answer.recording}.csv.gz"
    fitted = read_recording(path, robot)
    judged = read_recording(folder / "second" / path.name, robot)
    truth = {"hidden": f"{name} at {case.answer.where}"}
    return truth | _compared(robot, fitted, judged, folder, zeroed=False)


def _real(design: str, data: Path, folder: Path) -> dict[str, Any]:
    """Every other run of a real design."""
    robot, fitted, judged = pendulum_runs(design, data)
    return {"design": design} | _compared(robot, fitted, judged, folder, zeroed=True)


def _compared(
    robot: Robot, fitted: RobotRecording, judged: RobotRecording, folder: Path, *, zeroed: bool
) -> dict[str, Any]:
    began = time.monotonic()
    diagnosis = diagnose(fitted, robot, zeroed=zeroed)
    seconds = time.monotonic() - began
    peer = _fitted(robot, fitted, folder)
    error = partial(_held_out_floors, judged, diagnosis.system.motion.compared_hz)
    verdict = diagnosis.verdict
    return {
        "nominal, floors": error(robot, robot, {}),
        "diagnosis, floors": error(robot, robot, diagnosis.amended),
        "mujoco.sysid, floors": error(robot, peer.robot, {}),
        "diagnosis, s": round(seconds, 1),
        "mujoco.sysid, s": round(peer.seconds, 1),
        "diagnosis says": f"{'+'.join(verdict.effects)} at {', '.join(verdict.where.places)}",
        "probability": round(verdict.probability, 3),
        "mujoco.sysid says": f"{peer.different} of {peer.numbers} numbers differ (95 %)",
    }


def _held_out_floors(
    judged: RobotRecording, compared_hz: float, nominal: Robot, robot: Robot, effects: Assignment
) -> float:
    """RMS of the torque error on the other recording, in floors of the nominal robot."""
    motion = prepared(judged, nominal, compared_hz)
    system = RobotSystem(robot, motion, effects)
    return round(rms(system.readings - system.predict([{}])[0]), 2)


def _fitted(robot: Robot, recording: RobotRecording, folder: Path) -> Fit:
    """The model with all its numbers fitted by `mujoco.sysid`."""
    spec = _driven_spec(robot)
    parameters = _parameters(robot, recording)
    sequences = _windows(spec, robot, recording)
    residual = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    began = time.monotonic()
    fitted, result = sysid.optimize(
        parameters,
        residual,
        optimizer="scipy",
        verbose=False,
        diff_step=_DIFF_STEP,
        x_scale="jac",
        max_iters=_MOST_EVALUATIONS,
    )
    seconds = time.monotonic() - began
    amended = read_spec(robot.path, RobotError)
    for parameter in fitted.values():
        parameter.apply_modifier(amended)
    path = folder / f"fitted_{robot.path.name}"
    path.write_text(amended.to_xml(), encoding="utf-8")
    return Fit(load_robot(path), seconds, len(result.x), _different(parameters, result))


def _different(parameters: Any, result: Any) -> int:
    """How many numbers differ from nominal by more than 1.96 standard deviations."""
    jacobian = np.asarray(result.jac)
    residual = np.asarray(result.fun)
    variance = float((residual**2).sum()) / max(len(residual) - jacobian.shape[1], 1)
    deviation = np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    relative = [
        np.full(each.size, each.name.startswith(_RELATIVE)) for each in parameters.values()
    ]
    nominal = np.concatenate(relative).astype(float)
    return int((np.abs(result.x - nominal) > 1.96 * deviation).sum())


def _driven_spec(robot: Robot) -> mujoco.MjSpec:
    """The model with a motor and a sensor of position at every joint, and no contacts."""
    spec = read_spec(robot.path, RobotError)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in robot.joint_names:
        joint_motor = spec.add_actuator(name=f"motor_{name}", target=name)
        joint_motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        spec.add_sensor(
            name=f"position_{name}",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return spec


def _parameters(robot: Robot, recording: RobotRecording) -> Any:
    """Masses and centres by link, friction, damping and rotor by joint, in usual sizes."""
    torque = np.sqrt(np.nanmean(recording.torque**2, axis=0))
    made = []
    for body in robot.bodies:
        heavier = partial(_set_mass, body)
        shifted = partial(_set_centre, body, robot.reach_m)
        ones = np.ones(3)
        made.append(sysid.Parameter(f"mass {body}", 1.0, 0.2, 5.0, modifier=heavier))
        made.append(
            sysid.Parameter(f"centre {body}", ones, 0.3 * ones, 1.7 * ones, modifier=shifted)
        )
    for joint, usual in zip(robot.joint_names, torque, strict=True):
        for what in ("frictionloss", "damping", "armature"):
            size = {"frictionloss": 0.1, "damping": 0.05, "armature": 0.01}[what] * float(usual)
            number = partial(_set_number, joint, what, size)
            made.append(sysid.Parameter(f"{what} {joint}", _BEGIN, 0.0, 100.0, modifier=number))
    return sysid.ParameterDict({parameter.name: parameter for parameter in made})


def _set_mass(body: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    share = float(parameter.value[0])
    changed = spec.body(body)
    changed.mass *= share
    changed.inertia = np.asarray(changed.inertia) * share
    changed.fullinertia = np.asarray(changed.fullinertia) * share


def _set_centre(body: str, reach_m: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    changed = spec.body(body)
    changed.ipos = np.asarray(changed.ipos) + reach_m * (parameter.value - 1.0)


def _set_number(joint: str, what: str, size: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    """What is added to a joint's number, in its usual size."""
    changed = spec.joint(joint)
    value = size * float(parameter.value[0])
    if what == "damping":
        coefficients = np.array(changed.damping, dtype=float)
        coefficients.flat[0] += value
        changed.damping = coefficients if coefficients.ndim else float(coefficients)
    else:
        setattr(changed, what, getattr(changed, what) + value)


def _windows(spec: mujoco.MjSpec, robot: Robot, recording: RobotRecording) -> Any:
    """Windows over all trials, each from a smoothed state, with the torques as controls."""
    model = spec.compile()
    rate_hz = 1.0 / float(np.median(np.diff(recording.time_s)))
    span = round(_WINDOW_S * rate_hz)
    names: list[str] = []
    states: list[Any] = []
    controls: list[Any] = []
    readings: list[Any] = []
    begins = _begins(recording, span)
    for begin in begins[:: max(1, len(begins) // _WINDOWS)]:
        trial = np.flatnonzero(recording.trial == recording.trial[begin])
        path = smoothed(recording.position[trial], rate_hz, _SMOOTHED_HZ)
        speed, _ = derivatives(path, rate_hz)
        rows = slice(begin - trial[0], begin - trial[0] + span)
        time_s = np.arange(span) / rate_hz
        torque = recording.torque[trial][rows]
        names.append(f"window_{begin}")
        states.append(sysid.create_initial_state(model, path[rows][0], speed[rows][0]))
        controls.append(sysid.TimeSeries.from_control_names(time_s, torque, model))
        readings.append(sysid.TimeSeries.from_names(time_s, path[rows], model))
    return sysid.ModelSequences(robot.name, spec, names, states, controls, readings)


def _begins(recording: RobotRecording, span: int) -> Sequence[int]:
    """Rows at which windows begin, apart from both ends of trials."""
    begins: list[int] = []
    for number in np.unique(recording.trial):
        rows = np.flatnonzero(recording.trial == number)
        begins += range(int(rows[0]) + span, int(rows[-1]) - 2 * span, span)
    return begins


if __name__ == "__main__":
    raise SystemExit(main())
