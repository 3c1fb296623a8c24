"""A machine file to start from: what a model leads one to expect, for its user to correct."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from cablesense_base import Array, some_of
from cablesense_sim.machine.description import USUAL_FRICTION, MachineError
from cablesense_sim.mujoco_file import compiled, joint_ties, read_spec

_NOISE_SHARE = 1e-3
"""Noise of a sensor, as a share of the largest force that its actuator gives."""
_LEAST_NOISE = 1e-3
"""Noise of a sensor, N or N·m, at least."""
_USUAL_NOISE = 0.05
"""Noise of a sensor whose actuator states no largest force."""
_PRETENSION_N = 20.0
"""Of tendons whose model does not say what draws them at rest."""
_LONG_SHAPES = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_BOXES = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


def guessed_machine_file(path: Path) -> str:
    """The text of a machine file for an MJCF or a URDF.

    Raises:
        MachineError: the model cannot be read, or has neither tendons nor driven joints to
            read, or two equalities tie one joint.
    """
    model = compiled(read_spec(path, MachineError), path, MachineError)
    drawn = _driven(model, mujoco.mjtTrn.mjTRN_TENDON)
    elastic = np.flatnonzero(model.tendon_stiffness > 0.0).tolist()
    tendons = sorted({*drawn, *elastic})
    motors = _driven(model, mujoco.mjtTrn.mjTRN_JOINT)
    if not tendons and not motors:
        raise MachineError(
            f"{path}: no actuator draws a tendon or drives a joint, so there is no force to read; "
            "add the actuators to the model, or state the sensors by hand"
        )
    name = path.stem.replace(" ", "_").replace(".", "_")
    lines = [
        f"# {name}: what is read of {path.name}, and where it is touched. Guessed from the model:",
        "# correct what is not so. docs/machines.md explains every key.",
        f"name: {name}",
        f"model: {path.name}",
    ]
    if tendons:
        are_held = all(_is_held(model, drawn.get(t)) for t in tendons)
        coordinate_count = model.njnt - len(joint_ties(model, path, MachineError))
        by_servos = len(drawn) == len(tendons) < coordinate_count
        lines += _joints_line(are_held, by_servos=by_servos)
        lines += ["sensors:", "  tension:"]
        lines += _channel_lines(model, {t: drawn.get(t, -1) for t in tendons}, of_tendons=True)
        cables = []
        if drawn:
            whose = "" if are_held else ", of simulated ones"
            pose = f"in the model's first pose{whose}"
            cables.append(f"  pretension_n: {_PRETENSION_N:g}  # {pose}")
        if are_held:
            where = "over pulleys and through eyelets; 0 where tendons run freely"
            cables.append(f"  friction_coefficient: {USUAL_FRICTION:g}  # at most, {where}")
        if cables:
            lines += ["cables:", *cables]
    else:
        lines += _joints_line(False, by_servos=False)
        lines += ["sensors:", "  torque:"]
        lines += _channel_lines(model, motors, of_tendons=False)
    links = _touched_lines(model)
    if not links:
        raise MachineError(
            f"{path}: no moving body has a shape with an axis (capsule, cylinder, box or mesh); "
            "state touch.links by hand"
        )
    lines += ["touch:", "  friction: 0.3", "  largest_n: 50", "  links:", *links]
    return "\n".join(lines) + "\n"


def _driven(model: mujoco.MjModel, transmission: int) -> dict[int, int]:
    """Numbers of what actuators of a transmission drive, each with its actuator."""
    return {
        int(model.actuator_trnid[a, 0]): a
        for a in range(model.nactuator)
        if int(model.actuator_trntype[a]) == int(transmission)
    }


def _is_held(model: mujoco.MjModel, actuator: int | None) -> bool:
    """Whether a tendon has a spring, or an actuator that holds its length."""
    return actuator is None or float(model.actuator_biasprm[actuator, 1]) < 0.0


def _joints_line(held: bool, *, by_servos: bool) -> list[str]:
    """What says where the machine is.

    Tendons that are fewer than the joints hold no pose that was commanded: what their servos are
    commanded are lengths.
    """
    if not held:
        return ["# joint positions are read (joint_states)", "joints: measured"]
    return [
        "# commanded: tendons hold the lengths of commanded joint positions; actuators: the",
        "# actuators' lengths are commanded; measured: joint positions are read.",
        f"joints: {'actuators' if by_servos else 'commanded'}",
    ]


def _channel_lines(
    model: mujoco.MjModel, actuators: dict[int, int], *, of_tendons: bool
) -> list[str]:
    names = [
        (model.tendon(number) if of_tendons else model.joint(number)).name for number in actuators
    ]
    nameless = [str(n) for n, name in zip(actuators, names, strict=True) if not name]
    if nameless:
        what = "tendon" if of_tendons else "joint"
        raise MachineError(f"{what} number {some_of(nameless)} has no name; give each one")
    largest = [
        float(np.abs(model.actuator_forcerange[a]).max())
        for a in actuators.values()
        if a >= 0 and model.actuator_forcelimited[a]
    ]
    plausible = [force for force in largest if force < 1e4]
    noise = _USUAL_NOISE
    if plausible:
        noise = max(_NOISE_SHARE * max(plausible), _LEAST_NOISE)
    return [
        f"    of: [{', '.join(names)}]",
        f"    noise_std: {noise:.3g}  # {'N' if of_tendons else 'N·m'}, of one reading",
    ]


def _touched_lines(model: mujoco.MjModel) -> list[str]:
    lines = []
    for b in range(1, model.nbody):
        name = model.body(b).name
        if not model.body_weldid[b] or not name:
            continue
        axis = _longest_axis(model, b)
        if axis is None:
            continue
        start, end, radius_m = axis
        ends = ", ".join(
            f"{key}: [{', '.join(f'{round(x, 5) + 0.0:g}' for x in place.tolist())}]"
            for key, place in (("start_m", start), ("end_m", end))
        )
        lines.append(f"    - {{link: {name}, {ends}, radius_m: {radius_m:.3g}}}")
    return lines


def _longest_axis(model: mujoco.MjModel, body: int) -> tuple[Array, Array, float] | None:
    """Start (3,), end (3,) and radius of the longest shape of a body, in the body's frame."""
    best: tuple[float, Array, Array, float] | None = None
    first = int(model.body_geomadr[body])
    for g in range(first, first + int(model.body_geomnum[body])):
        shape = _axis_of(model, g)
        if shape is None:
            continue
        half_m, direction, radius_m, centre = shape
        if best is None or half_m > best[0]:
            best = half_m, centre - half_m * direction, centre + half_m * direction, radius_m
    if best is None:
        return None
    _, start, end, radius_m = best
    if np.linalg.norm(end) < np.linalg.norm(start):
        # an axis leads away from the joint
        start, end = end, start
    return start, end, radius_m


def _axis_of(model: mujoco.MjModel, geom: int) -> tuple[float, Array, float, Array] | None:
    """Half length, direction (3,), radius and centre (3,) of a shape, in its body's frame."""
    kind = int(model.geom_type[geom])
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    axes = turn.reshape(3, 3)
    centre = np.array(model.geom_pos[geom])
    size = model.geom_size[geom]
    if kind in _LONG_SHAPES:
        return float(size[1]), axes[:, 2], float(size[0]), centre
    half = np.array(size)
    if kind == _MESH:
        bounds = model.geom_aabb[geom]
        centre = centre + axes @ bounds[:3]
        half = np.array(bounds[3:])
    elif kind not in _BOXES:
        return None
    longest = int(half.argmax())
    others = np.delete(half, longest)
    return float(half[longest]), axes[:, longest], float(others.mean()), centre
