"""How forces in a machine follow from its parameters, at a pose that is held fixed."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.built_machine import BuiltMachine
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import Balance

_MOVED_M = 1e-6
"""By which a site is moved to see what follows from it."""


class Sensitivity(NamedTuple):
    """Derivatives by the P parameters at a fixed pose.

    Attributes:
        of_tensions: (K, P) of tendons that are held at their actuators.
        of_forces: (n, P) of the generalised forces at tensions that stay as they are.
    """

    of_tensions: Array
    of_forces: Array


def sensitivity(
    machine: Machine,
    parameters: MachineParameters,
    built: BuiltMachine,
    command: Array,
    pose: Array,
    tensions_n: Array,
) -> Sensitivity:
    """The derivatives of a built machine at a command (C,), a pose (n,) and tensions (K,)."""
    slices = parameters.slices
    count = len(pose)
    taut = (tensions_n > 0.0).astype(float)
    stiffness = built.statics.stiffness_n_m * taut
    of_tensions = np.zeros((len(tensions_n), len(parameters)))
    of_forces = np.zeros((count, len(parameters)))
    balance = built.statics.at(pose)

    # T = k (l - held) + T0: the tension itself, but for what was set by hand
    of_tensions[:, slices["tendon_stiffness"]] = np.diag(tensions_n - built.pretension_n * taut)
    of_tensions[:, slices["pretension"]] = np.diag(taut)
    if machine.source.file.joints == "commanded":
        held = built.statics.at(command).moment
        zeros = np.concatenate(
            [np.arange(len(parameters))[slices[name]] for name in ("joint_zero", "slide_zero")]
        )
        is_hinge = machine.coordinates.is_hinge
        order = np.concatenate([np.flatnonzero(is_hinge), np.flatnonzero(~is_hinge)])
        of_tensions[:, zeros] = -(stiffness[:, None] * held)[:, order]

    built.statics.at(pose)
    by_mass, by_centre, by_gravity = built.statics.by_masses(parameters.bodies)
    masses_kg = machine.model.body_mass[parameters.bodies]
    of_forces[:, slices["mass"]] = (masses_kg[:, None] * by_mass).T
    of_forces[:, slices["centre_of_mass"]] = by_centre.transpose(1, 0, 2).reshape(-1, count).T
    gravity = machine.model.opt.gravity
    tilts = np.cross(np.eye(3)[:2], gravity)
    of_forces[:, slices["base_tilt"]] = (tilts @ by_gravity).T
    of_forces[:, slices["joint_stiffness"]] = _by_springs(machine, parameters, pose)
    if machine.source.file.cables.friction_coefficient > 0.0:
        carried = _by_friction(machine, built, pose)
        of_forces[:, slices["carried_friction"]] = -(tensions_n[:, None] * carried.moment).T
        of_tensions[:, slices["carried_friction"]] = -np.diag(tensions_n * carried.wrap_rad)

    routed = _by_routing(machine, parameters, built, pose, balance)
    routing = slices["routing"]
    of_tensions[:, routing] = stiffness[:, None] * routed.length
    of_forces[:, routing] = -np.einsum("k,kns->ns", tensions_n, routed.moment)
    return Sensitivity(of_tensions, of_forces)


class _ByRouting(NamedTuple):
    """Derivatives by the 2S displacements of sites.

    Attributes:
        length: (K, 2S) of lengths, beyond those in the reference pose.
        moment: (K, n, 2S) of the tendons' moments.
    """

    length: Array
    moment: Array


def _by_routing(
    machine: Machine,
    parameters: MachineParameters,
    built: BuiltMachine,
    pose: Array,
    balance: Balance,
) -> _ByRouting:
    """By moving sites, as many at once as there are on different tendons."""
    routing = parameters.routing
    tendons, count = balance.moment.shape
    site_count = len(routing.ids)
    length = np.zeros((tendons, 2, site_count))
    moment = np.zeros((tendons, count, 2, site_count))
    statics = built.statics
    site_pos = statics.model.site_pos
    at_reference_m = statics.at(machine.reference).length_m
    for members in routing.rounds:
        ids = routing.ids[members]
        nominal = site_pos[ids].copy()
        passes = routing.tendon_of[members]
        tendon, member = np.nonzero(passes.T)
        sites = members[member]
        for way in range(2):
            site_pos[ids] = nominal + _MOVED_M * routing.across[members, way]
            moved = statics.at(pose)
            moved_reference_m = statics.at(machine.reference).length_m
            longer = moved.length_m - balance.length_m - (moved_reference_m - at_reference_m)
            turned = moved.moment - balance.moment
            length[tendon, way, sites] = longer[tendon] / _MOVED_M
            moment[tendon, :, way, sites] = turned[tendon] / _MOVED_M
        site_pos[ids] = nominal
    return _ByRouting(length.reshape(tendons, -1), moment.reshape(tendons, count, -1))


def _by_springs(machine: Machine, parameters: MachineParameters, pose: Array) -> Array:
    """(n, J) forces of the springs in joints."""
    model = machine.model
    coordinates = machine.coordinates
    qpos = coordinates.positions(pose)
    slope = coordinates.slope(qpos)
    springs = parameters.springs
    force = -model.jnt_stiffness[springs] * (qpos[springs] - model.qpos_spring[springs])
    return np.asarray(force * slope[springs].T)


class _Carried(NamedTuple):
    """What friction at the bends of tendons carries, for a unit coefficient that slides fully.

    Attributes:
        moment: (K, n) moments of the tendons, each piece by the angle wrapped before it.
        wrap_rad: (K,) that angle, as a mean over the length.
    """

    moment: Array
    wrap_rad: Array


def _by_friction(machine: Machine, built: BuiltMachine, pose: Array) -> _Carried:
    """By the polygon of each tendon: straight pieces between sites and points of contact."""
    model = built.statics.model
    coordinates = machine.coordinates
    data = mujoco.MjData(model)
    qpos = coordinates.positions(pose)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    slope = coordinates.slope(qpos)
    moments = np.zeros((len(machine.tendons.ids), len(coordinates)))
    wraps = np.zeros(len(machine.tendons.ids))
    for row, t in enumerate(machine.tendons.ids.tolist()):
        first = int(data.ten_wrapadr[t])
        count = int(data.ten_wrapnum[t])
        points = data.wrap_xpos.reshape(-1, 3)[first : first + count]
        objects = data.wrap_obj.reshape(-1)[first : first + count]
        bodies = _bodies_of(model, t, objects)
        jacobians = [_point_slope(model, data, *pair) for pair in zip(points, bodies, strict=True)]
        along: Array | None = None
        wrapped = 0.0
        total_m = 0.0
        for start in range(count - 1):
            piece = points[start + 1] - points[start]
            length_m = float(np.linalg.norm(piece))
            if length_m < 1e-9 or objects[start] == -2 or objects[start + 1] == -2:
                continue
            direction = piece / length_m
            if along is not None:
                wrapped += float(np.arccos(np.clip(direction @ along, -1.0, 1.0)))
            along = direction
            lengthening = direction @ (jacobians[start + 1] - jacobians[start])
            moments[row] += wrapped * (lengthening @ slope)
            wraps[row] += wrapped * length_m
            total_m += length_m
        wraps[row] /= max(total_m, 1e-9)
    return _Carried(moments, wraps)


def _bodies_of(model: mujoco.MjModel, tendon: int, objects: Array) -> list[int]:
    """Bodies of the points of a tendon's polygon: of geoms by number, of sites in their order."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    site = mujoco.mjtWrap.mjWRAP_SITE
    sites = iter([int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == site])
    bodies = []
    for number in objects.tolist():
        if number >= 0:
            bodies.append(int(model.geom_bodyid[number]))
        elif number == -1:
            bodies.append(int(model.site_bodyid[next(sites)]))
        else:
            bodies.append(0)
    return bodies


def _point_slope(model: mujoco.MjModel, data: mujoco.MjData, point: Array, body: int) -> Array:
    """(3, nv) derivative of a point that is fixed to a body."""
    slope = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, slope, None, point, body)
    return slope
