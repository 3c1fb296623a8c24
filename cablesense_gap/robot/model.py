"""A robot as its MJCF or URDF describes it, and what a variant of it has otherwise."""

from __future__ import annotations

import copy
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import chain, count
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError, some_of
from cablesense_sim.mujoco_file import compiled, joint_ties, read_spec

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_GUIDES = {
    int(getattr(mujoco.mjtWrap, f"mjWRAP_{kind}")) for kind in ("SITE", "CYLINDER", "SPHERE")
}
_LEAST_KG = 1e-9
_LEAST_LINK_M = 0.05
_UPPER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
_FOR_PLACES = re.compile(r"[^A-Za-z0-9_\-/]")


class RobotError(CableSenseError):
    """A model that cannot be used: names the file, the fault and the remedy."""


@dataclass(frozen=True)
class Robot:
    """A robot on a fixed base whose joints are hinges and slides.

    Attributes:
        name: of the model.
        path: of its file.
        model: compiled; nobody changes it.
        joints: names of its J joints, in the model's order, which is that of its coordinates, as
            they may stand in a parameter's name.
        joint_names: (J,) the same as the model's file spells them.
        torque_units: of the drive's generalised force at each joint, N·m or N.
        bodies: names of the B bodies that move and have mass.
        body_ids: (B,) their numbers in the model.
        actuators: names of its A actuators.
        controls: names of their U inputs, which commands give: that of the actuator, and of one
            with several `actuator.pos`, `actuator.vel` and so on.
        tendons: names of its K tendons that actuators pull over guides, without pulleys.
        tendon_ids: (K,) their numbers in the model.
        geared: (J, J) by how much joint i moves with joint d, where an equality of the model ties
            it to that: a transmission, or a finger that mimics another.
        left_out: parts of the model that every comparison ignores, as sentences.
    """

    name: str
    path: Path
    model: mujoco.MjModel = field(compare=False)
    joints: tuple[str, ...]
    joint_names: tuple[str, ...]
    torque_units: tuple[str, ...]
    bodies: tuple[str, ...]
    body_ids: NDArray[np.int64] = field(compare=False)
    actuators: tuple[str, ...]
    controls: tuple[str, ...]
    tendons: tuple[str, ...]
    tendon_ids: NDArray[np.int64] = field(compare=False)
    geared: Array = field(compare=False)
    left_out: tuple[str, ...] = ()

    @property
    def position_units(self) -> tuple[str, ...]:
        """Unit of each joint's position, rad or m."""
        return tuple("rad" if unit == "N·m" else "m" for unit in self.torque_units)

    @property
    def servos(self) -> NDArray[np.int64]:
        """(J,) number of the actuator that is a joint's position servo, -1 where none is."""
        model = self.model
        servo_of_joint = np.full(len(self.joints), -1)
        for a in range(model.nactuator):
            at_joint = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
            by_position = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            by_position &= model.actuator_ctrlnum[a] == 1
            if at_joint and by_position and model.actuator_biasprm[a, 1] < 0.0:
                servo_of_joint[model.actuator_trnid[a, 0]] = a
        return servo_of_joint

    @property
    def servo_controls(self) -> NDArray[np.int64]:
        """(J,) number of the input that commands a joint's position servo, -1 where none is."""
        servos = self.servos
        control = np.full(len(servos), -1)
        control[servos >= 0] = self.model.actuator_ctrladr[servos[servos >= 0]]
        return control

    @property
    def longest_link_m(self) -> float:
        """Rough length of its longest link: no body's mass lies farther from its frame."""
        longest = np.abs(self.model.body_pos[1:]).max(initial=0.0)
        return max(float(longest), float(np.abs(self.model.body_ipos).max()), _LEAST_LINK_M)

    def nominal(self) -> Change:
        """The robot as the model has it, for effects to change."""
        model = self.model
        ids = self.body_ids
        axes = np.array([_rotation(model.body_iquat[b]) for b in ids])
        counts = {"joints": len(self.joints), "tendons": len(self.tendons)}
        zeros: dict[str, Any] = {
            each.name: np.zeros([counts[axis] for axis in each.metadata["axes"]])
            for each in fields(Change)
            if each.metadata
        }
        return Change(
            mass_kg=model.body_mass[ids].copy(),
            centre_m=model.body_ipos[ids].copy(),
            inertia_kg_m2=np.einsum("bij,bj,bkj->bik", axes, model.body_inertia[ids], axes),
            gravity_m_s2=model.opt.gravity.copy(),
            armature=model.dof_armature.copy(),
            damping=model.dof_damping.copy(),
            stiffness=model.jnt_stiffness.copy(),
            friction=model.dof_frictionloss.copy(),
            farthest_mass_m=2.0 * self.longest_link_m,
            **zeros,
        )

    def varied(self, change: Change) -> mujoco.MjModel:
        """A copy of the model with what MuJoCo can hold of a change.

        Raises:
            RobotError: a link would have no mass or an impossible inertia.
        """
        model = copy.copy(self.model)
        principal, axes = np.linalg.eigh(change.inertia_kg_m2)
        if (change.mass_kg <= 0.0).any() or (principal <= 0.0).any():
            raise RobotError(f"{self.path}: a link would have no mass; its mass must be positive")
        axes[:, :, 0] *= np.linalg.det(axes)[:, None]
        for b, rotation in zip(self.body_ids, axes, strict=True):
            mujoco.mju_mat2Quat(model.body_iquat[b], rotation.ravel())
        model.body_mass[self.body_ids] = change.mass_kg
        model.body_ipos[self.body_ids] = change.centre_m
        model.body_inertia[self.body_ids] = principal
        model.opt.gravity[:] = change.gravity_m_s2
        model.dof_armature[:] = change.armature
        model.dof_damping[:] = change.damping
        model.jnt_stiffness[:] = change.stiffness
        model.dof_frictionloss[:] = change.friction
        for joint in np.flatnonzero(change.servo_gain):
            servo = self.servos[joint]
            times = 1.0 + change.servo_gain[joint]
            model.actuator_gainprm[servo, 0] *= times
            model.actuator_biasprm[servo, :2] *= times
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


_BY_JOINT = MappingProxyType({"axes": ("joints",), "moves": False})
_BY_TENDON = MappingProxyType({"axes": ("tendons",), "moves": False})
_WHERE_JOINTS_ARE = MappingProxyType({"axes": ("joints",), "moves": True})
_WHERE_JOINTS_ARE_BY_JOINT = MappingProxyType({"axes": ("joints", "joints"), "moves": True})
"""Of arrays of `Change` that are zero for the robot as the model has it: what their axes count,
and whether they say where joints are, of which positions are read."""


@dataclass
class Change:
    """What effects change: arrays by joint (J,) or by body (B,), in the robot's order.

    A new array is a field, with the metadata of those that are zero in the model, and stands in
    `Attributes`.

    Attributes:
        mass_kg, centre_m, inertia_kg_m2: (B,), (B, 3) in the body's frame, (B, 3, 3) about the
            centre in the body's axes.
        gravity_m_s2: (3,) in the model's base axes.
        armature, damping, stiffness, friction: (J,) as MuJoCo has them; friction is dry.
        play: (J,) between drive and joint, from one end of it to the other, rad or m.
        load_friction: (J,) dry friction by the torque that the joint transmits.
        presliding, load_presliding: (J,) how far joints give elastically before these slip.
        load_side: (J,) whether the latter counts by the drive's torque, 1, or by the joint's, -1.
        stribeck, stribeck_speed: (J,) by how much more dry friction is at rest, as a share, and
            the speed at which 1/e of that is left; `load_…` of that by the load.
        lopsided: (J,) by how much more damping is forwards than on average, as a share.
        capstan_friction, capstan_presliding: (K,) coefficient of friction of tendons over their
            guides, and how much cable gives before it slips, m.
        zero: (J,) what each encoder reads at the true zero.
        encoder_scale: (J,) by how much, as a share, an encoder reads too much.
        coupling: (J, J) by how much joint i moves with encoder j.
        torque_scale, torque_offset: (J,) what a torque reads too much, as a share and in all.
        servo_gain: (J,) by how much, as a share, a position servo is stiffer than modelled.
        farthest_mass_m: how far from a body's centre a mass may be added.
        delay_s: how much later than the motion torques are read.
    """

    mass_kg: Array
    centre_m: Array
    inertia_kg_m2: Array
    gravity_m_s2: Array
    armature: Array
    damping: Array
    stiffness: Array
    friction: Array
    farthest_mass_m: float
    play: Array = field(metadata=_WHERE_JOINTS_ARE)
    load_friction: Array = field(metadata=_BY_JOINT)
    presliding: Array = field(metadata=_BY_JOINT)
    load_presliding: Array = field(metadata=_BY_JOINT)
    load_side: Array = field(metadata=_BY_JOINT)
    stribeck: Array = field(metadata=_BY_JOINT)
    stribeck_speed: Array = field(metadata=_BY_JOINT)
    load_stribeck: Array = field(metadata=_BY_JOINT)
    load_stribeck_speed: Array = field(metadata=_BY_JOINT)
    lopsided: Array = field(metadata=_BY_JOINT)
    capstan_friction: Array = field(metadata=_BY_TENDON)
    capstan_presliding: Array = field(metadata=_BY_TENDON)
    zero: Array = field(metadata=_WHERE_JOINTS_ARE)
    encoder_scale: Array = field(metadata=_WHERE_JOINTS_ARE)
    coupling: Array = field(metadata=_WHERE_JOINTS_ARE_BY_JOINT)
    torque_scale: Array = field(metadata=_BY_JOINT)
    torque_offset: Array = field(metadata=_BY_JOINT)
    servo_gain: Array = field(metadata=_BY_JOINT)
    delay_s: float = 0.0

    def key(self, *names: str) -> tuple[bytes, ...]:
        """Equal for changes that have the same arrays of these names."""
        return tuple(np.asarray(getattr(self, name)).tobytes() for name in names)

    def copied(self) -> Change:
        """A change of its own."""
        return copy.deepcopy(self)

    def inertial_parameters(self) -> Array:
        """(B, 10) mass, first moments and inertia about the body's frame, xx yy zz xy xz yz."""
        moment = self.mass_kg[:, None] * self.centre_m
        about = self.inertia_kg_m2 + np.array(
            [m * _about(c) for m, c in zip(self.mass_kg, self.centre_m, strict=True)]
        )
        return np.column_stack([self.mass_kg, moment, about[:, *_UPPER]])

    def add_point_mass(self, body: int, mass_kg: float, place_m: Array) -> None:
        """Fix a point mass to a body, at a place in the body's frame."""
        whole = max(self.mass_kg[body] + mass_kg, _LEAST_KG)
        centre = (self.mass_kg[body] * self.centre_m[body] + mass_kg * place_m) / whole
        inertia = self.inertia_kg_m2[body] + self.mass_kg[body] * _about(
            self.centre_m[body] - centre
        )
        self.inertia_kg_m2[body] = inertia + mass_kg * _about(place_m - centre)
        self.mass_kg[body] = whole
        self.centre_m[body] = centre


OF_POSITION = tuple(each.name for each in fields(Change) if each.metadata.get("moves"))
"""Arrays of a change that say where joints are, of which positions are read."""


def load_robot(path: str | Path) -> Robot:
    """Read an MJCF or a URDF.

    Raises:
        RobotError: no such file, not a model, or one without joints, with a free base, or with
            joints that have no name, more than one coordinate, or two equalities.
    """
    path = Path(path)
    spec = read_spec(path, RobotError)
    model = compiled(spec, path, RobotError)
    names = [model.joint(j).name for j in range(model.njnt)]
    if not names:
        raise RobotError(f"{path}: has no joints; the model of a robot has at least one")
    several = [
        names[j] or f"number {j}"
        for j in range(model.njnt)
        if model.jnt_type[j] not in (_HINGE, _SLIDE)
    ]
    if several:
        raise RobotError(
            f"{path}: joint {some_of(several)} is free or a ball; a robot on a fixed base with "
            "hinges and slides is right: fix the base, and leave out loose objects"
        )
    if not all(names):
        raise RobotError(f"{path}: joint number {names.index('')} has no name; give each one")
    joints = _as_places(names)
    gearing = _gearing(model, path)
    body_numbers = [
        b for b in range(1, model.nbody) if model.body_weldid[b] and model.body_mass[b] > 0.0
    ]
    bodies = _as_places([model.body(b).name for b in body_numbers])
    guided = _guided(model)
    actuators = [model.actuator(a).name or f"actuator_{a}" for a in range(model.nactuator)]
    tendons = [model.tendon(t).name or f"tendon_{t}" for t in guided]
    return Robot(
        name=spec.modelname or path.stem,
        path=path,
        model=model,
        joints=joints,
        joint_names=tuple(names),
        torque_units=tuple("N·m" if kind == _HINGE else "N" for kind in model.jnt_type),
        bodies=bodies,
        body_ids=np.array(body_numbers, dtype=np.int64),
        actuators=tuple(actuators),
        controls=_controls(model, actuators),
        tendons=_as_places(tendons),
        tendon_ids=np.array(guided, dtype=np.int64),
        geared=gearing.ratios,
        left_out=gearing.left_out,
    )


def inverse_dynamics(
    model: mujoco.MjModel, position: Array, speed: Array, acceleration: Array
) -> Array:
    """(R, J) generalised forces that a motion needs, without friction, contacts and limits."""
    free = copy.copy(model)
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    data = mujoco.MjData(free)
    joint_forces = np.empty_like(position)
    qpos = data.qpos
    qvel = data.qvel
    qacc = data.qacc
    forces = data.qfrc_inverse
    inverse = mujoco.mj_inverse
    for row in range(len(position)):
        qpos[:] = position[row]
        qvel[:] = speed[row]
        qacc[:] = acceleration[row]
        inverse(free, data)
        joint_forces[row] = forces
    return joint_forces


def gravity_torque(model: mujoco.MjModel, position: Array) -> Array:
    """(R, J) generalised forces that hold the bodies against gravity, without springs."""
    held = copy.copy(model)
    held.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING
    held.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_DAMPER
    still = np.zeros_like(position)
    return inverse_dynamics(held, position, still, still)


def actuated(robot: Robot, position: Array, speed: Array, command: Array) -> Array:
    """(T, J) what the model's actuators make of commands (T, U)."""
    model = robot.model
    data = mujoco.MjData(robot.model)
    joint_forces = np.empty_like(position)
    for row in range(len(position)):
        data.qpos[:] = position[row]
        data.qvel[:] = speed[row]
        data.ctrl[:] = command[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        joint_forces[row] = data.qfrc_actuator
    return joint_forces


class _Gearing(NamedTuple):
    """What the equalities of a model say of J joints.

    Attributes:
        ratios: (J, J) of joints, by rows, that are tied to others.
        left_out: what of the active equalities is left out, as sentences.
    """

    ratios: Array
    left_out: tuple[str, ...]


def _gearing(model: mujoco.MjModel, path: Path) -> _Gearing:
    """By the active equalities; a joint that two of them tie is refused."""
    geared = np.zeros((model.njnt, model.njnt))
    others = 0
    for tie in joint_ties(model, path, RobotError):
        if tie.leader is not None and not any(tie.curve[2:]):
            geared[tie.joint, tie.leader] = tie.curve[1]
        else:
            others += 1
    of_joints = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)
    others += int(model.eq_active0.sum()) - int(of_joints.sum())
    if not others:
        return _Gearing(geared, ())
    return _Gearing(geared, (f"{others} equality constraints of the model are left out.",))


def _controls(model: mujoco.MjModel, actuators: Sequence[str]) -> tuple[str, ...]:
    """Names of all inputs in their order; those of an actuator follow each other."""
    controls: list[str] = []
    for a, name in enumerate(actuators):
        inputs = range(model.actuator_ctrlnum[a])
        input_names = [f"{name}.{mujoco.mj_actuatorInputName(model, a, k) or k}" for k in inputs]
        controls += input_names if len(input_names) > 1 else [name] * len(input_names)
    return tuple(controls)


def _guided(model: mujoco.MjModel) -> list[int]:
    """Tendons that actuators pull, over sites and geoms between two ends."""
    of_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    pulled = np.unique(model.actuator_trnid[of_tendon, 0]).tolist()
    kinds = [model.wrap_type[model.tendon_adr[t] :][: model.tendon_num[t]] for t in pulled]
    return [
        t
        for t, wrap_kinds in zip(pulled, kinds, strict=True)
        if len(wrap_kinds) > 2 and set(wrap_kinds) <= _GUIDES
    ]


def _as_places(names: list[str]) -> tuple[str, ...]:
    """Names that may stand between the points of a parameter's name, each once.

    An umlaut loses its points, other signs become `_`, and a name that is then there already gets
    a number.
    """
    places: list[str] = []
    for name in names:
        letters = "".join(
            letter
            for letter in unicodedata.normalize("NFKD", name)
            if not unicodedata.combining(letter)
        )
        place = _FOR_PLACES.sub("_", letters)
        tried = chain([place], (f"{place}_{number}" for number in count(2)))
        places.append(next(each for each in tried if each not in places))
    return tuple(places)


def _rotation(quaternion: Array) -> Array:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _about(offset_m: Array) -> Array:
    """Inertia (3, 3) of a unit mass at a place."""
    return np.asarray(offset_m @ offset_m * np.eye(3) - np.outer(offset_m, offset_m))
