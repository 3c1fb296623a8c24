"""Real robots: rigid bodies in a row, joined by hinges, with drives, joints and sensors.

Torques of a motion, and the motion of torques, are Newton's and Euler's equations from the base to
the tip and back, written in base axes, where both recursions are cumulative sums (Luh, Walker and
Paul, J. Dyn. Sys. 102, 1980). MuJoCo reads the files of the models and has no other part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import NO_FAULT, PlantError
from cablesense_plants.robot.bristles import NO_BRISTLES, Bristles

_T = TypeVar("_T")
_RIGID = 1e9
"""Stiffness of a base that does not give, N·m/rad."""
_BASE_INERTIA = 1e6
_FLANK_RAD_S = 1000.0
"""At which a rotor would swing on the flank of a tooth."""
_SETTLE_SHARE = 0.3
"""Of a base's critical damping."""
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
            values.copy() for values in (self.mass_kg, self.centre_m, self.inertia_kg_m2)
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
        frames = [turned[..., 0, :, :]]
        origins = [chain.origin_m[..., 0, :]]
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
        joint_spin_up = self.axis * acceleration[..., None] + _cross(before, joint)
        spin_up = np.cumsum(joint_spin_up, -2)
        carried = _cross(spin_up - joint_spin_up, self.offset_m)
        carried += _cross(before, _cross(before, self.offset_m))
        hinge = np.cumsum(carried, -2)
        centre = hinge + _cross(spin_up, self.arm_m)
        centre += _cross(turning, _cross(turning, self.arm_m))
        force = self.mass_kg[..., None] * (centre - gravity_m_s2[..., None, :])
        momentum = times(self.inertia, turning)
        moment = times(self.inertia, spin_up) + _cross(turning, momentum)
        moment += _cross(self.centre_m, force)
        forces = _from_tip(force)
        moments = _from_tip(moment)
        return np.asarray((self.axis * (moments - _cross(self.origin_m, forces))).sum(-1))

    def mass_matrix(self) -> Array:
        """By the inertia, about the base's origin, of all that each hinge carries."""
        mass = self.mass_kg[..., None]
        moment = self.mass_kg[..., None] * self.centre_m
        across = moment[..., :, None] * self.centre_m[..., None, :]
        about = self.inertia - across
        about += np.trace(across, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
        mass = _from_tip(mass)
        moment = _from_tip(moment)
        about = np.cumsum(about[..., ::-1, :, :], -3)[..., ::-1, :, :]
        drift = _cross(self.origin_m, self.axis)  # of the point at the base's origin
        force = mass * drift + _cross(self.axis, moment)
        spin = times(about, self.axis) + _cross(moment, drift)
        upper = np.triu(self.axis @ np.swapaxes(spin, -1, -2) + drift @ np.swapaxes(force, -1, -2))
        return np.asarray(upper + np.swapaxes(np.triu(upper, 1), -1, -2))


def read_chain(model: mujoco.MjModel) -> tuple[LinkChain, dict[str, Any], list[str], list[str]]:
    """The chain of a robot that MuJoCo has read; its links' axes are the base's at zero.

    Gives also `damping`, `armature`, `stiffness` and `dry` friction by joint (N,), and the joints'
    and the links' names. Bodies without a joint are parts of the link that carries them.

    Raises:
        PlantError: its joints are no hinges one after the other, or a spring rests elsewhere.
    """
    count = model.njnt
    data = mujoco.MjData(model)
    joints = [model.joint(n).name for n in range(count)]
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    link_of = {0: -1}
    bodies = model.jnt_bodyid.tolist()
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
    mass = np.zeros(count)
    centre = np.zeros((count, 3))
    inertia = np.zeros((count, 3, 3))
    for n in range(count):
        link_bodies = np.flatnonzero(owner == n)
        mass[n] = model.body_mass[link_bodies].sum()
        middle = model.body_mass[link_bodies] @ data.xipos[link_bodies] / max(mass[n], _LEAST_KG)
        centre[n] = middle - data.xanchor[n]
        for body in link_bodies.tolist():
            turned = data.ximat[body].reshape(3, 3)
            arm = data.xipos[body] - middle
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
    cos = np.cos(angle)[..., None, None]
    sin = np.sin(angle)[..., None, None]
    x, y, z = np.moveaxis(axis, -1, 0)
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    return cos * np.eye(3) + sin * skew + (1.0 - cos) * axis[..., :, None] * axis[..., None, :]


def times(matrix: Array, vector: Array) -> Array:
    """Products (..., k) of many small matrices (..., k, n) with vectors (..., n)."""
    return np.asarray((matrix * vector[..., None, :]).sum(-1))


def _cross(a: Array, b: Array) -> Array:
    """`numpy.cross` of many short arrays, several times as fast."""
    a0 = a[..., 0]
    a1 = a[..., 1]
    a2 = a[..., 2]
    b0 = b[..., 0]
    b1 = b[..., 1]
    b2 = b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], -1)


def _from_tip(values: Array) -> Array:
    return np.cumsum(values[..., ::-1, :], -2)[..., ::-1, :]


@dataclass(frozen=True)
class RobotKind:
    """A nominal robot, how it is run, and how well it is measured.

    Attributes:
        model: as MuJoCo read it, if not from the file.
        home_rad, reach_rad: (N,) where trials begin and end, and how far they go from there.
        speed_hz: the fastest of the sines, by joint (N,).
        encoder_rad: an encoder's step.
        noise_n_m: (N,) standard deviation of one sample of a torque.
        rate_hz: of the recording.
        trial_s: of each trial.
        gain_1_s2: of the controller's position error, by each joint's own inertia.
        drives: names of its actuators.
        pulls_n: (T, K) tensions of tendons, where it has them, of motors' angles, their torques
            and those that are commanded, (T, N).
        rubbing: of tendons' friction (B, K) and the joints' first angles (B, N) how much, on the
            way to angles, motors' torques lose, (B, N).
        servos: whether its drives hold positions, while a camera reads those of the joints.
    """

    path: Path
    home_rad: Array
    reach_rad: Array
    speed_hz: Array
    encoder_rad: float
    noise_n_m: Array
    rate_hz: int
    trial_s: float
    gain_1_s2: float
    drives: tuple[str, ...]
    pulls_n: Callable[[Array, Array, Array], Array] | None = None
    rubbing: Callable[[Array, Array], Callable[[Array, Array], Array]] | None = None
    servos: bool = False
    model: mujoco.MjModel | None = field(default=None, compare=False)

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.stem

    def nominal(self) -> tuple[RealRobot, list[str], list[str]]:
        """The robot without anything hidden; names of its joints and links."""
        model = self.model or mujoco.MjModel.from_xml_path(str(self.path))
        chain, sizes, joints, links = read_chain(model)
        moved = np.eye(len(joints))
        capstan = np.zeros(len(self.drives))
        return RealRobot(chain, moved=moved, capstan=capstan, **sizes), joints, links

    def gains(self) -> tuple[Array, Array]:
        """Stiffness and damping (N,) of the controller, by each joint's own inertia at home."""
        robot = self.nominal()[0]
        inertia = robot.chain.mass_matrix(self.home_rad[None])[0].diagonal() + robot.armature
        return inertia * self.gain_1_s2, inertia * 1.4 * np.sqrt(self.gain_1_s2)


@dataclass(frozen=True)
class RealRobot:
    """One robot, or several with a leading axis (B,) to every array; by joint (N,) unless stated.

    Attributes:
        damping, armature, stiffness: as of MuJoCo.
        moved: (N, N) joints' angles by motors' angles.
        capstan: (K,) friction of tendons with their guides.
        dry, proportional: kinetic friction, N·m, and its share of the drive's torque.
        stribeck, stribeck_speed: () by how much more it is at rest, as a share, and until when.
        presliding_rad: how far a stuck joint gives until it slips.
        bristles: LuGre's friction, in addition.
        play_rad: between a motor and its joint, from one flank of the teeth to the other.
        cogging, cogging_phase, cogging_waves: a ripple of torque over a turn.
        worn, worn_waves, worn_phase: friction, N·m at most, that comes and goes along the way.
        harness, harness_rad, harness_reach: torque of a bundle of cables that stiffens as it is
            bent, at a reach from where it lies straight.
        ripple, ripple_waves, ripple_phase: share of the drive's torque that gears take and give.
        tie, tie_rad: stiffness of what catches a joint beyond an angle; its sign has the side.
        push, push_trial: torque by someone in the second half of one trial; () its number.
        zero, encoder_scale: encoders read (1 + scale) times the motor's angle, and zero.
        scale, offset, warming, ceiling: torques read (1 + scale + warming over the recording)
            times the true torque, and offset, and at most a ceiling.
        delay_s: () by how much later than angles torques are read.
        servo_scale: stiffness of the controller is (1 + scale) times the nominal one.
        base_axis, base_stiffness: (3,) and () of what the robot stands on.
    """

    chain: LinkChain
    damping: Array
    armature: Array
    stiffness: Array
    moved: Array
    capstan: Array
    dry: Array = NO_FAULT
    proportional: Array = NO_FAULT
    stribeck: Array = NO_FAULT
    stribeck_speed: Array = NO_FAULT + 0.05
    presliding_rad: Array = NO_FAULT + 0.002
    bristles: Bristles = NO_BRISTLES
    play_rad: Array = NO_FAULT
    cogging: Array = NO_FAULT
    cogging_phase: Array = NO_FAULT
    cogging_waves: Array = NO_FAULT + 20.0
    worn: Array = NO_FAULT
    worn_waves: Array = NO_FAULT + 1.0
    worn_phase: Array = NO_FAULT
    harness: Array = NO_FAULT
    harness_rad: Array = NO_FAULT
    harness_reach: Array = NO_FAULT + 1.0
    ripple: Array = NO_FAULT
    ripple_waves: Array = NO_FAULT + 1.0
    ripple_phase: Array = NO_FAULT
    tie: Array = NO_FAULT
    tie_rad: Array = NO_FAULT
    push: Array = NO_FAULT
    push_trial: Array = NO_FAULT - 1.0
    zero: Array = NO_FAULT
    encoder_scale: Array = NO_FAULT
    scale: Array = NO_FAULT
    offset: Array = NO_FAULT
    warming: Array = NO_FAULT
    ceiling: Array = NO_FAULT + np.inf
    delay_s: Array = NO_FAULT
    servo_scale: Array = NO_FAULT
    base_axis: Any = (0.0, 1.0, 0.0)
    base_stiffness: Array = NO_FAULT + _RIGID

    def kinetic_n_m(self, angle: Array, speed: Array, drive_n_m: Array) -> Array:
        """Size of the friction that slipping meets."""
        more = self.stribeck * np.exp(-((speed / self.stribeck_speed) ** 2))
        worn = 0.5 * self.worn * (1.0 + np.sin(self.worn_waves * angle + self.worn_phase))
        return (self.dry + self.proportional * np.abs(drive_n_m)) * (1.0 + more) + worn

    def passed_share(self, angle: Array) -> Array:
        """The share of the drive's torque that gears with a ripple pass on."""
        return 1.0 - self.ripple * np.sin(self.ripple_waves * angle + self.ripple_phase)

    def motor_n_m(self, angle: Array, speed: Array) -> Array:
        """Damping and cogging at the motors, at their angles and speeds."""
        ripple = self.cogging * np.sin(self.cogging_waves * angle + self.cogging_phase)
        return self.damping * speed + ripple

    def spring_n_m(self, angle: Array) -> Array:
        """Torque of springs at the joints, at their angles."""
        beyond = np.maximum((angle - self.tie_rad) * np.sign(self.tie), 0.0)
        bent = (angle - self.harness_rad) / self.harness_reach
        held = 0.5 * self.harness * (bent + bent**3)
        return self.stiffness * angle + held + np.abs(self.tie) * beyond * np.sign(self.tie)

    def flank_n_m(self, ahead: Array, closing: Array) -> Array:
        """Torque through touching teeth, by the lead of motors over joints and its speed."""
        stiffness = self.armature * _FLANK_RAD_S**2
        pressed = ahead - np.clip(ahead, -0.5 * self.play_rad, 0.5 * self.play_rad)
        force = stiffness * pressed + 0.6 * self.armature * _FLANK_RAD_S * closing
        held = np.where(pressed > 0.0, np.maximum(force, 0.0), np.minimum(force, 0.0))
        return np.asarray(held * (pressed != 0.0))

    def on_base(self) -> LinkChain:
        """The chain with the base as a first link, which turns about `base_axis`."""
        chain = self.chain
        return LinkChain(
            axis=np.concatenate([self.base_axis[..., None, :], chain.axis], -2),
            origin_m=np.insert(chain.origin_m, 0, 0.0, axis=-2),
            mass_kg=np.insert(chain.mass_kg, 0, 0.0, axis=-1),
            centre_m=np.insert(chain.centre_m, 0, 0.0, axis=-2),
            inertia_kg_m2=np.insert(chain.inertia_kg_m2, 0, 0.0, axis=-3),
            gravity_m_s2=chain.gravity_m_s2,
        )

    def base(self, inertia: Array) -> tuple[Array, Array]:
        """Own inertia and damping (B,) of the base that carries `inertia`."""
        stiffness = self.base_stiffness[:, 0]
        base_inertia = np.where(stiffness >= _RIGID, _BASE_INERTIA, inertia)
        return base_inertia, 2.0 * _SETTLE_SHARE * np.sqrt(stiffness * (base_inertia + inertia))

    def read_n_m(self, torque_n_m: Array, time_s: Array) -> Array:
        """Torques (T, B, N) as sensors without noise give them, at times (T,) of the motion."""
        late = np.empty_like(torque_n_m)
        rows = np.arange(len(time_s))
        for b, steps in enumerate(self.delay_s[:, 0] / (time_s[1] - time_s[0])):
            source_row = np.clip(rows - steps, 0, len(rows) - 1)
            low = np.minimum(source_row.astype(int), len(rows) - 2)
            part = (source_row - low)[:, None]
            late[:, b] = (1.0 - part) * torque_n_m[low, b] + part * torque_n_m[low + 1, b]
        share = (time_s / time_s[-1])[:, None, None]
        read = (1.0 + self.scale + self.warming * share) * late + self.offset
        return np.clip(read, -self.ceiling, self.ceiling)


def stacked(robots: Sequence[_T]) -> _T:
    """Robots side by side, each array with a leading axis; one number a robot is (B, 1)."""
    first: Any = robots[0]
    if is_dataclass(first):
        parts = {f.name: stacked([getattr(r, f.name) for r in robots]) for f in fields(first)}
        return replace(first, **parts)  # type: ignore[return-value, type-var]
    untyped: Any = robots
    values: Any = np.stack(np.broadcast_arrays(*untyped))
    return values if values.ndim > 1 else values[:, None]
