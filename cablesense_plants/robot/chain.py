"""Rigid bodies in a row, joined by hinges: the torques of a motion, and the motion of torques.

Newton's and Euler's equations from the base to the tip and back, written in base axes, where both
recursions are cumulative sums (Luh, Walker and Paul, J. Dyn. Sys. 102, 1980). MuJoCo reads the
files of the models and has no other part in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import PlantError

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_LEAST_KG = 1e-9


@dataclass(frozen=True)
class LinkChain:
    """N links, each on the last; arrays may lead with axes for several robots, here B.

    At zero the axes of all links are parallel to those of the base.

    Attributes:
        axis: (B, N, 3) of each hinge, unit vectors in the link's axes.
        origin_m: (B, N, 3) of each hinge in the axes of the link before.
        mass_kg: (B, N).
        centre_m: (B, N, 3) of mass, in the link's axes from its hinge.
        inertia_kg_m2: (B, N, 3, 3) about that centre.
        gravity_m_s2: (B, 3) in base axes.
    """

    axis: Array
    origin_m: Array
    mass_kg: Array
    centre_m: Array
    inertia_kg_m2: Array
    gravity_m_s2: Array

    def torques_n_m(self, angle: Array, speed: Array, acceleration: Array) -> Array:
        """Torques (..., B, N) about the hinges that a motion takes; rad, rad/s, rad/s²."""
        return _ChainPose(self, angle).torques_n_m(speed, acceleration, self.gravity_m_s2)

    def mass_matrix(self, angle: Array) -> Array:
        """(B, N, N) at angles (B, N)."""
        return _ChainPose(self, angle).mass_matrix()

    def accelerations(
        self, angle: Array, speed: Array, torque_n_m: Array, extra_inertia: Array
    ) -> Array:
        """(B, N) under torques; `extra_inertia` (B, N, N) is that of rotors."""
        pose = _ChainPose(self, angle)
        bias = pose.torques_n_m(speed, np.zeros_like(speed), self.gravity_m_s2)
        inertia = pose.mass_matrix() + extra_inertia
        return np.asarray(np.linalg.solve(inertia, (torque_n_m - bias)[..., None])[..., 0])

    def with_mass(self, link: int, mass_kg: float, place_m: Array) -> LinkChain:
        """A point mass fixed to a link, at a place in its axes; of one robot."""
        mass, centre, inertia = (
            each.copy() for each in (self.mass_kg, self.centre_m, self.inertia_kg_m2)
        )
        mass[link] += mass_kg
        centre[link] += mass_kg / mass[link] * (place_m - self.centre_m[link])
        for part_kg, part_m in ((self.mass_kg[link], self.centre_m[link]), (mass_kg, place_m)):
            arm = part_m - centre[link]
            inertia[link] += part_kg * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return replace(self, mass_kg=mass, centre_m=centre, inertia_kg_m2=inertia)


class _ChainPose:
    """Chains at angles (..., N): all places and axes in the base's axes."""

    def __init__(self, chain: LinkChain, angle: Array) -> None:
        turned = _rotations(chain.axis, angle)
        frames, origins = [turned[..., 0, :, :]], [chain.origin_m[..., 0, :]]
        origins[0] = np.broadcast_to(origins[0], (*angle.shape[:-1], 3))
        for n in range(1, angle.shape[-1]):
            offset = times(frames[-1], chain.origin_m[..., n, :])
            origins.append(origins[-1] + offset)
            frames.append(frames[-1] @ turned[..., n, :, :])
        frame = np.stack(frames, -3)
        self.origin_m = np.stack(origins, -2)
        self.offset_m = np.diff(self.origin_m, axis=-2, prepend=self.origin_m[..., :1, :])
        self.axis = times(frame, chain.axis)
        self.arm_m = times(frame, chain.centre_m)
        self.centre_m = self.origin_m + self.arm_m
        self.inertia = frame @ chain.inertia_kg_m2 @ np.swapaxes(frame, -1, -2)
        self.mass_kg = chain.mass_kg

    def torques_n_m(self, speed: Array, acceleration: Array, gravity_m_s2: Array) -> Array:
        joint = self.axis * speed[..., None]
        turning = np.cumsum(joint, -2)
        before = turning - joint
        own = self.axis * acceleration[..., None] + _cross(before, joint)
        spin_up = np.cumsum(own, -2)
        carried = _cross(spin_up - own, self.offset_m)
        carried += _cross(before, _cross(before, self.offset_m))
        hinge = np.cumsum(carried, -2)
        centre = hinge + _cross(spin_up, self.arm_m)
        centre += _cross(turning, _cross(turning, self.arm_m))
        force = self.mass_kg[..., None] * (centre - gravity_m_s2[..., None, :])
        momentum = times(self.inertia, turning)
        moment = times(self.inertia, spin_up) + _cross(turning, momentum)
        moment += _cross(self.centre_m, force)
        forces, moments = _from_tip(force), _from_tip(moment)
        return np.asarray((self.axis * (moments - _cross(self.origin_m, forces))).sum(-1))

    def mass_matrix(self) -> Array:
        """By the inertia, about the base's origin, of all that each hinge carries."""
        mass, moment = self.mass_kg[..., None], self.mass_kg[..., None] * self.centre_m
        across = moment[..., :, None] * self.centre_m[..., None, :]
        about = self.inertia - across
        about += np.trace(across, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
        mass, moment = _from_tip(mass), _from_tip(moment)
        about = np.cumsum(about[..., ::-1, :, :], -3)[..., ::-1, :, :]
        drift = _cross(self.origin_m, self.axis)  # of the point at the base's origin
        force = mass * drift + _cross(self.axis, moment)
        spin = times(about, self.axis) + _cross(moment, drift)
        upper = np.triu(self.axis @ np.swapaxes(spin, -1, -2) + drift @ np.swapaxes(force, -1, -2))
        return np.asarray(upper + np.swapaxes(np.triu(upper, 1), -1, -2))


def read_chain(model: mujoco.MjModel) -> tuple[LinkChain, dict[str, Array], list[str], list[str]]:
    """The chain of a robot that MuJoCo has read; its links' axes are the base's at zero.

    Gives also `damping`, `armature`, `stiffness` and `dry` friction by joint (N,), and the joints'
    and the links' names. Bodies without a joint are parts of the link that carries them.

    Raises:
        PlantError: its joints are no hinges one after the other, or a spring rests elsewhere.
    """
    count, data = model.njnt, mujoco.MjData(model)
    joints = [model.joint(n).name for n in range(count)]
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    link_of, bodies = {0: -1}, model.jnt_bodyid.tolist()
    for body in range(1, model.nbody):
        link_of[body] = carrier = link_of[int(model.body_parentid[body])]
        if body in bodies:
            link_of[body] = n = bodies.index(body)
            if bodies.count(body) > 1 or n != carrier + 1 or model.jnt_type[n] != _HINGE:
                raise PlantError(
                    f"joint {joints[n]}: a plant's robot is a row of hinges, each on the link of "
                    "the one before; give a model without branches, slides and balls"
                )
    if (model.jnt_stiffness * model.qpos_spring).any():
        raise PlantError("springs of a plant's robot are at rest at zero; set springref to 0")
    owner = np.array([link_of[body] for body in range(model.nbody)])
    mass, centre, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for n in range(count):
        own = np.flatnonzero(owner == n)
        mass[n] = model.body_mass[own].sum()
        middle = model.body_mass[own] @ data.xipos[own] / max(mass[n], _LEAST_KG)
        centre[n] = middle - data.xanchor[n]
        for body in own.tolist():
            turned, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - middle
            inertia[n] += turned * model.body_inertia[body] @ turned.T
            inertia[n] += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    chain = LinkChain(
        axis=data.xaxis.copy(),
        origin_m=np.diff(data.xanchor, axis=0, prepend=np.zeros((1, 3))),
        mass_kg=mass,
        centre_m=centre,
        inertia_kg_m2=inertia,
        gravity_m_s2=model.opt.gravity.copy(),
    )
    sizes = {
        "damping": model.dof_damping,
        "armature": model.dof_armature,
        "stiffness": model.jnt_stiffness,
        "dry": model.dof_frictionloss,
    }
    return chain, sizes, joints, [model.body(body).name for body in bodies]


def _rotations(axis: Array, angle: Array) -> Array:
    """Rodrigues' formula: (..., N, 3, 3) of unit axes (..., N, 3) and angles (..., N)."""
    cos, sin = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    x, y, z = np.moveaxis(axis, -1, 0)
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    return cos * np.eye(3) + sin * skew + (1.0 - cos) * axis[..., :, None] * axis[..., None, :]


def times(matrix: Array, vector: Array) -> Array:
    """Products (..., k) of many small matrices (..., k, n) with vectors (..., n)."""
    return np.asarray((matrix * vector[..., None, :]).sum(-1))


def _cross(a: Array, b: Array) -> Array:
    """`numpy.cross` of many short arrays, several times as fast."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], -1)


def _from_tip(values: Array) -> Array:
    return np.cumsum(values[..., ::-1, :], -2)[..., ::-1, :]
