"""`mujoco.sysid`, the system identification of MuJoCo, set as someone who knows it would.

It fits the parameters that its user names, by least squares of motion that is rolled out from
measured states with the measured torques. Here these are all that its model can have otherwise:
of each body mass, centre and inertia (its pseudo-inertia, ten numbers), of each joint damping, dry
friction, armature, stiffness and a constant torque. Those of joints are in units of what is
typical in the recording, so that one step suits all derivatives, and none begins at its bound.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid

from cablesense_base import Array
from cablesense_gap.robot.model import Robot, RobotError, load_robot
from cablesense_gap.robot.motion import Motion, Trial, derivatives, inner_rows, smoothed
from cablesense_gap.simulator import Assignment, Term
from cablesense_sim.mujoco_file import read_spec

_WINDOW_S = 0.5
"""Of motion that is rolled out from one measured state."""
_STEP_S = 0.0025
"""Of a rollout, at most."""
_DERIVATIVE_STEP = 1e-3
"""That of SciPy, 1.5e-8, is below what rollouts resolve, and the fit stalls."""
_MOST_ITERATIONS = 40
_SETTLED = 1e-5
"""Share of the squares by which the last step is to have lessened them."""
_ZERO_RAD = 0.3
"""Bound of the zero of an encoder that is set anew before each trial."""
_TIMES = np.array([0.1, 10.0])
"""Bounds of masses, and of how far bodies stretch, by the nominal ones."""
_FROM_BOUND = 1e-3
"""Share of a parameter's range within which it is at its bound."""


@dataclass(frozen=True)
class PeerFit:
    """A fitted model.

    Attributes:
        robot: with the fitted parameters.
        offsets: constant torques, which no joint of an MJCF has.
        parameters: how many numbers were fitted.
        differing: of how many the 95 % interval excludes the nominal value.
        at_bounds: how many ended at a bound.
        evaluations: of all residuals, beside those for derivatives.
        cpu_s: processor time of the fit.
    """

    robot: Robot
    offsets: Assignment
    parameters: int
    differing: int
    at_bounds: int
    evaluations: int
    cpu_s: float


def fitted(robot: Robot, motion: Motion, path: Path) -> PeerFit:
    """Fit all parameters to a recording's motion; the model is written to the file `path`."""
    began_s = time.process_time()
    spec = _driven_by_torques(robot, motion)
    parameters = _parameters(robot, motion, spec)
    residual = partial(
        sysid.residual,
        models_sequences=_windows(robot, motion),
        build_model=_compiled_once(),
        modify_residual=_scaled_residual(motion),
        n_threads=1,
    )
    with redirect_stdout(io.StringIO()):  # its optimizer prints each iteration
        best, result = sysid.optimize(
            parameters.copy().move_off_bounds(),
            residual,
            optimizer="scipy_parallel_fd",
            verbose=False,
            diff_step=_DERIVATIVE_STEP,
            x_scale="jac",
            max_iters=_MOST_ITERATIONS,
            ftol=_SETTLED,
        )
    covariance_and_half_width = sysid.calculate_intervals([result.fun], result.jac)
    half_width = covariance_and_half_width[1]
    value = best.as_vector()
    low, high = best.get_bounds()
    near = _FROM_BOUND * (high - low)
    fitted_spec = sysid.apply_param_modifiers_spec(best, _driven_by_torques(robot, motion))
    offsets = {
        Term("torque_offset", joint, "torque_n_m"): -float(motor.biasprm[0])
        for joint, motor in zip(robot.joints, fitted_spec.actuators, strict=True)
    }
    path.write_text(fitted_spec.to_xml(), encoding="utf-8")
    return PeerFit(
        robot=load_robot(path),
        offsets=offsets,
        parameters=len(value),
        differing=int((np.abs(value - best.as_nominal_vector()) > half_width).sum()),
        at_bounds=int(((value - low < near) | (high - value < near)).sum()),
        evaluations=int(result.nfev),
        cpu_s=time.process_time() - began_s,
    )


def _driven_by_torques(robot: Robot, motion: Motion) -> mujoco.MjSpec:
    """The robot's model with a motor and two sensors at each joint, without contacts."""
    spec = read_spec(robot.path, RobotError)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in robot.joint_names:
        motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0] = 1.0
    for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
        for joint in robot.joint_names:
            of_joint = {"objtype": mujoco.mjtObj.mjOBJ_JOINT, "objname": joint}
            spec.add_sensor(name=f"{kind.name}_{joint}", type=kind, **of_joint)
    interval_s = 1.0 / motion.rate_hz
    spec.option.timestep = interval_s / np.ceil(interval_s / _STEP_S - 1e-6)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return spec


def _parameters(robot: Robot, motion: Motion, spec: mujoco.MjSpec) -> Any:
    """All that are fitted, at their nominal values."""
    parameters = sysid.ParameterDict()
    farthest_m = 2.0 * robot.longest_link_m
    model = spec.compile()
    for body in robot.body_ids.tolist():
        inertia = sysid.body_inertia_param(
            spec,
            model,
            model.body(body).name,
            sysid.InertiaType.Pseudo,
            mass_bound_mult=_TIMES,
            ipos_bound_off=np.array([-farthest_m, farthest_m]),
            stretch_bound_mult=_TIMES,
            shear_bound_off=np.array([-farthest_m, farthest_m]),
            modifier=partial(_set_inertia, model.body(body).name),
        )
        parameters.add(inertia)
    scale = motion.scale
    nominal = robot.nominal()
    of_joints = {
        "damping": (nominal.damping, scale.torque / scale.speed, _set_damping, 0.0),
        "frictionloss": (nominal.friction, scale.torque, _set_friction, 0.0),
        "armature": (nominal.armature, scale.inertia, _set_armature, 0.0),
        "stiffness": (nominal.stiffness, scale.torque / scale.position, _set_stiffness, 0.0),
        "constant": (np.zeros_like(scale.torque), scale.torque, _set_constant, -1.0),
    }
    for name, (values, units, modifier, lowest) in of_joints.items():
        shares = values / units
        for joint, share, unit in zip(robot.joint_names, shares, units, strict=True):
            write = partial(modifier, joint, unit)
            most = share + 1.0
            parameters.add(sysid.Parameter(f"{joint}_{name}", share, lowest, most, modifier=write))
    for trial in motion.trials if motion.zeroed else ():
        for joint in robot.joint_names:
            write = partial(_set_zero, joint, _name(motion, trial))
            name = f"{joint}_zero_{trial.number}"
            parameters.add(sysid.Parameter(name, 0.0, -_ZERO_RAD, _ZERO_RAD, modifier=write))
    return parameters


def _set_inertia(body: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    sysid.apply_body_inertia(spec, body, parameter)
    spec.body(body).iquat[:] = (1.0, 0.0, 0.0, 0.0)  # it leaves NaN, which MuJoCo 4.0 refuses


def _set_damping(joint: str, unit: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    spec.joint(joint).damping[0] = unit * parameter.value[0]


def _set_friction(joint: str, unit: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    spec.joint(joint).frictionloss = unit * parameter.value[0]


def _set_armature(joint: str, unit: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    spec.joint(joint).armature = unit * parameter.value[0]


def _set_stiffness(joint: str, unit: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    spec.joint(joint).stiffness[0] = unit * parameter.value[0]


def _set_constant(joint: str, unit: float, spec: mujoco.MjSpec, parameter: Any) -> None:
    spec.actuator(joint).biasprm[0] = unit * parameter.value[0]


def _set_zero(joint: str, trial: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    if spec.modelname == trial:
        spec.joint(joint).ref = parameter.value[0]


def _name(motion: Motion, trial: Trial) -> str:
    """Of the model of a trial: its own, where encoders are set to zero before each."""
    return f"trial_{trial.number}" if motion.zeroed else "robot"


def _windows(robot: Robot, motion: Motion) -> list[Any]:
    """Each trial in windows of one length, which begin at measured states."""
    rate_hz = motion.rate_hz
    count = round(_WINDOW_S * rate_hz) + 1
    time_s = np.arange(count) / rate_hz
    sequences = []
    for trial in motion.trials:
        spec = _driven_by_torques(robot, motion)
        spec.modelname = _name(motion, trial)
        model = spec.compile()
        states = []
        controls = []
        readings = []
        speed, _acceleration = derivatives(trial.position, rate_hz)
        torque = smoothed(np.nan_to_num(trial.torque), rate_hz, motion.smoothed_hz)
        inner = inner_rows(len(trial.time_s), rate_hz, motion.smoothed_hz)
        for begin in range(inner.start, inner.stop - count + 1, count - 1):
            rows = slice(begin, begin + count)
            state = sysid.create_initial_state(model, trial.position[begin], speed[begin])
            states.append(state)
            controls.append(sysid.TimeSeries(time_s, torque[rows]))
            measured = np.hstack([trial.position[rows], speed[rows]])
            readings.append(sysid.TimeSeries.from_names(time_s, measured, model))
        names = [f"window_{number}" for number in range(len(states))]
        named = spec.modelname
        sequences.append(sysid.ModelSequences(named, spec, names, states, controls, readings))
    return sequences


def _scaled_residual(motion: Motion) -> Callable[..., Any]:
    """Its own is divided by the size of each window's readings, which at rest is none."""
    scale = np.concatenate([motion.scale.position, motion.scale.speed])

    def difference(
        _parameters: Any,
        predicted: Any,
        measured: Any,
        model: mujoco.MjModel,
        *_all: Any,
        **_state: Any,
    ) -> tuple[Array, Any, Any]:
        steps = round(1.0 / (motion.rate_hz * model.opt.timestep))
        names = measured.signal_mapping
        later = sysid.TimeSeries(measured.times[1:], measured.data[1:], names)
        sampled = predicted.data[steps - 1 :: steps]  # the first reading is where it begins
        at_samples = sysid.TimeSeries(later.times, sampled, names)
        return (sampled - later.data) / scale, at_samples, later

    return difference


def _compiled_once() -> Callable[[Any, mujoco.MjSpec], mujoco.MjModel]:
    """As it compiles models, but that of a trial with the same values once for all windows."""
    models: dict[tuple[str, bytes], mujoco.MjModel] = {}

    def build(parameters: Any, spec: mujoco.MjSpec) -> mujoco.MjModel:
        key = spec.modelname, parameters.as_vector().tobytes()
        if key not in models:
            if len(models) > 2 * parameters.size:
                models.clear()
            models[key] = sysid.apply_param_modifiers(parameters, spec)
        return models[key]

    return build
