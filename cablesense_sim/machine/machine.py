"""A machine as arrays: its coordinates, tendons, sensors and links, by its file and its model."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_sim.machine.coordinates import Coordinates, coordinates_of
from cablesense_sim.machine.description import (
    MachineError,
    OpenedMachine,
    SensorGroup,
    TouchedLink,
    read_machine_file,
)
from cablesense_sim.mujoco_file import compiled, read_spec

Indices = NDArray[np.int64]

_ONE_COORDINATE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
"""Kinds of joints with one coordinate."""
_STIFFEST_N_M = 1e8
"""Of a tendon whose model has no compliance: it is not to be told from one that is rigid."""


@dataclass(frozen=True)
class Tendons:
    """The K tendons that pull: those that are read, and springs that nothing reads.

    Attributes:
        names: in the model.
        ids: (K,) numbers in the model.
        stiffness_n_m: (K,) of each with what draws it.
        pretension_n: (K,) at the reference pose.
        drawn_by: (K,) number of the actuator on the tendon, -1 where there is none.
        gear: (K,) by which a length makes the control of these that just leaves it slack.
    """

    names: tuple[str, ...]
    ids: Indices
    stiffness_n_m: Array
    pretension_n: Array
    drawn_by: Indices
    gear: Array


@dataclass(frozen=True)
class SensorChannels:
    """The M channels: tensions first, then torques.

    Attributes:
        names: of the tendons and joints that they read.
        units: `N`, or `N·m` of hinges.
        tendon: (M,) number among the tendons, -1 of a torque.
        coordinate: (M,) number of the coordinate whose torque is read, -1 of a tension.
        noise_std, step: (M,) of one reading.
        lowest, highest: (M,) limits, infinite where there are none.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    tendon: Indices
    coordinate: Indices
    noise_std: Array
    step: Array
    lowest: Array
    highest: Array

    @property
    def variance(self) -> Array:
        """(M,) of one reading: noise, and rounding uniform over one step (step² / 12)."""
        return self.noise_std**2 + self.step**2 / 12.0

    def read(self, values: Array, rng: np.random.Generator | None) -> Array:
        """Readings of values (..., M): noise, rounding to the step, held to the range."""
        reading = np.asarray(values, dtype=float)
        if rng is not None:
            reading = reading + rng.normal(0.0, 1.0, reading.shape) * self.noise_std
            steps = np.where(self.step > 0.0, self.step, 1.0)
            rounded = np.round(reading / steps) * steps
            reading = np.where(self.step > 0.0, rounded, reading)
        return np.clip(reading, self.lowest, self.highest)


@dataclass(frozen=True)
class Links:
    """The N links that can be touched.

    A link's frame lies on its axis, nearest to the origin of its body, and has x along the axis.

    Attributes:
        names: of the bodies.
        bodies: (N,) numbers of the bodies.
        origin_m: (N, 3) of the frames, in the bodies' frames.
        axes: (N, 3, 3) of the frames, in columns.
        touched_m: (N, 2) range along x.
        radius_m: (N,).
    """

    names: tuple[str, ...]
    bodies: Indices
    origin_m: Array
    axes: Array
    touched_m: Array
    radius_m: Array


@dataclass(frozen=True)
class Machine:
    """A machine that can be felt through its sensors.

    Attributes:
        source: its file and what that says.
        model: compiled, without contacts, limits and constraints, and without the tendons' springs
            and actuators, which `tendons` has. Nobody changes it.
        coordinates: its n independent joint positions.
        tendons, channels, links: its parts.
        reference: (n,) pose in which tendons are pretensioned.
    """

    source: OpenedMachine
    model: mujoco.MjModel
    coordinates: Coordinates
    tendons: Tendons
    channels: SensorChannels
    links: Links
    reference: Array

    @property
    def name(self) -> str:
        """Of the machine."""
        return self.source.file.name

    @property
    def identity(self) -> str:
        """Name and hash of file and model."""
        return self.source.identity

    @property
    def is_measured(self) -> bool:
        """Whether joint positions are read, and not commanded."""
        return self.source.file.joints == "measured"

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names in the messages of commands, or of measured positions."""
        if self.source.file.joints == "actuators":
            numbers = self.tendons.drawn_by.tolist()
            return tuple(self.model.actuator(number).name for number in numbers if number >= 0)
        return self.coordinates.names


def open_machine(path: str | Path) -> Machine:
    """Read a machine file and its model.

    Raises:
        MachineError: one of them cannot be read, or they do not fit.
    """
    source = read_machine_file(path)
    spec = read_spec(source.model_path, MachineError)
    model = compiled(spec, source.model_path, MachineError)
    file = source.file
    _require_supported(model, source)
    if file.tolerances.common_joint_stiffness_share and not (model.jnt_stiffness > 0.0).any():
        raise MachineError(
            f"{source.path}: tolerances.common_joint_stiffness_share is of joints with springs, "
            f"and {source.model_path.name} has none; leave it out"
        )
    pose = _reference(model, source)
    coordinates = coordinates_of(model, pose, file.locked, str(source.path))
    tendons = _tendons(model, source, pose)
    channels = _channels(model, source, tendons, coordinates)
    if file.joints == "actuators" and (tendons.drawn_by < 0).any():
        bare = [tendons.names[i] for i in np.flatnonzero(tendons.drawn_by < 0)]
        raise MachineError(
            f"{source.path}: joints: actuators, but no position servo draws tendon "
            f"{some_of(bare)}; state joints: commanded or measured, or put it under cables.unread"
        )
    return Machine(
        source=source,
        model=_without_what_tendons_do(model),
        coordinates=coordinates,
        tendons=tendons,
        channels=channels,
        links=_links(model, source),
        reference=coordinates.independent(pose),
    )


def _require_supported(model: mujoco.MjModel, source: OpenedMachine) -> None:
    path = source.model_path
    several = [
        model.joint(j).name or f"number {j}"
        for j in range(model.njnt)
        if int(model.jnt_type[j]) not in _ONE_COORDINATE
    ]
    if not model.njnt:
        raise MachineError(f"{path}: has no joints, so no force can be felt through it")
    if several:
        raise MachineError(
            f"{path}: joint {some_of(several)} is free or a ball; fix the base, write a ball as "
            "three hinges, and leave out loose objects"
        )
    nameless = [j for j in range(model.njnt) if not model.joint(j).name]
    if nameless:
        raise MachineError(f"{path}: joint number {nameless[0]} has no name; give each one")
    others = [
        e
        for e in range(model.neq)
        if model.eq_active0[e] and model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT
    ]
    if others:
        kind = mujoco.mjtEq(int(model.eq_type[others[0]])).name.removeprefix("mjEQ_").lower()
        raise MachineError(
            f"{path}: equality number {others[0]} ({kind}) closes a loop; statics here know trees "
            "whose joints follow each other (<equality><joint>): open the loop"
        )


def _reference(model: mujoco.MjModel, source: OpenedMachine) -> Array:
    """(nq,) the reference pose."""
    key = source.file.reference
    if key is None:
        return model.qpos0.copy()
    names = [model.key(k).name for k in range(model.nkey)]
    if key not in names:
        raise MachineError(
            f"{source.path}: reference: {key} is no keyframe of {source.model_path.name}; it has "
            f"{some_of(names) or 'none'}"
        )
    return np.array(model.key_qpos[names.index(key)])


def _tendons(model: mujoco.MjModel, source: OpenedMachine, pose: Array) -> Tendons:
    file = source.file
    read = file.sensors.tension.of if file.sensors.tension else []
    there = [model.tendon(t).name for t in range(model.ntendon)]
    wanted = [*read, *file.cables.unread]
    unknown = [name for name in wanted if name not in there]
    if unknown:
        raise MachineError(
            f"{source.path}: tendon {some_of(unknown)} is not in {source.model_path.name}; it has "
            f"{some_of(there) or 'no tendons'}"
        )
    drawn = _drawn_by(model)
    pulls = (model.tendon_stiffness > 0.0) | (drawn >= 0)
    forgotten = [
        there[t] or f"number {t}" for t in np.flatnonzero(pulls) if there[t] not in wanted
    ]
    if forgotten:
        raise MachineError(
            f"{source.path}: nothing reads tendon {some_of(forgotten)}, which pulls; give it a "
            "sensor under sensors.tension.of, or list it under cables.unread if it is a spring"
        )
    ids = np.array([there.index(name) for name in wanted], dtype=np.int64)
    is_held = file.joints != "measured" and (drawn[ids] >= 0).any()
    if is_held and file.reference is None and file.cables.pretension_n is None:
        raise MachineError(
            f"{source.path}: what actuators pull the tendons with at rest is not known; state "
            "cables.pretension_n, or name a keyframe with their controls as reference"
        )
    by_model, held_n = _as_modelled(model, ids, drawn[ids], pose, file.reference)
    stiffness = _stated(file.cables.stiffness_n_m, wanted, by_model, "stiffness_n_m", source)
    pretension = _stated(file.cables.pretension_n, wanted, held_n, "pretension_n", source)
    if file.joints != "measured" and (stiffness >= _STIFFEST_N_M).any():
        rigid = [wanted[i] for i in np.flatnonzero(stiffness >= _STIFFEST_N_M)]
        raise MachineError(
            f"{source.path}: tendon {some_of(rigid)} has no stiffness in the model, so its "
            "tension does not follow from commands; state cables.stiffness_n_m, or joints: "
            "measured"
        )
    gear = np.array([_control_per_length(model, int(a)) for a in drawn[ids]])
    return Tendons(tuple(wanted), ids, stiffness, pretension, drawn[ids], gear)


def _control_per_length(model: mujoco.MjModel, actuator: int) -> float:
    """Of a servo with the force gain u - kp g l, which is none at u = (kp / gain) g l."""
    if actuator < 0:
        return 1.0
    gain = float(model.actuator_gainprm[actuator, 0])
    servo = -float(model.actuator_biasprm[actuator, 1])
    gear = float(model.actuator_gear[actuator, 0])
    return gear * servo / gain if gain > 0.0 and servo > 0.0 else gear


def _drawn_by(model: mujoco.MjModel) -> Indices:
    """(ntendon,) number of the actuator that draws a tendon, -1 where none does."""
    drawn = np.full(model.ntendon, -1, dtype=np.int64)
    for a in range(model.nactuator):
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
            drawn[model.actuator_trnid[a, 0]] = a
    return drawn


def _as_modelled(
    model: mujoco.MjModel, ids: Indices, drawn: Indices, pose: Array, keyframe: str | None
) -> tuple[Array, Array]:
    """(K,) stiffness of tendons, N/m, and their tensions at a pose (nq,), by the model alone."""
    data = mujoco.MjData(model)
    if keyframe is not None:
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
    data.qpos[:] = pose
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    stiffness = np.zeros(len(ids))
    tension = np.zeros(len(ids))
    for row, (t, a) in enumerate(zip(ids, drawn, strict=True)):
        spring = float(model.tendon_stiffness[t])
        length = float(data.ten_length[t])
        if spring > 0.0:
            tension[row] = max(0.0, spring * (length - float(model.tendon_lengthspring[t, 1])))
        servo = -float(model.actuator_biasprm[a, 1]) if a >= 0 else 0.0
        servo *= float(model.actuator_gear[a, 0]) ** 2 if a >= 0 else 1.0
        if a >= 0:
            tension[row] -= float(data.actuator_force[a]) * float(model.actuator_gear[a, 0])
        stiffness[row] = spring + servo if spring + servo > 0.0 else _STIFFEST_N_M
    return stiffness, np.maximum(tension, 0.0)


def _stated(
    value: float | dict[str, float] | None,
    names: list[str],
    default: Array,
    key: str,
    source: OpenedMachine,
) -> Array:
    """(K,) numbers of tendons: of all, by name, or the model's own."""
    if value is None:
        return default
    if not isinstance(value, dict):
        return np.full(len(names), float(value))
    unknown = [name for name in value if name not in names]
    if unknown:
        raise MachineError(
            f"{source.path}: cables.{key} names {some_of(unknown)}, which is not among the "
            f"tendons {some_of(names)}"
        )
    return np.array([value.get(name, own) for name, own in zip(names, default, strict=True)])


def _channels(
    model: mujoco.MjModel, source: OpenedMachine, tendons: Tendons, coordinates: Coordinates
) -> SensorChannels:
    sensors = source.file.sensors
    tension = sensors.tension
    torque = sensors.torque
    if torque is not None and source.file.joints != "measured":
        raise MachineError(
            f"{source.path}: sensors.torque reads joints whose positions are not read; state "
            "joints: measured"
        )
    names: list[str] = []
    units: list[str] = []
    tendon_numbers: list[int] = []
    coordinate_numbers: list[int] = []
    groups: list[tuple[SensorGroup, int]] = []
    if tension is not None:
        names += tension.of
        units += ["N"] * len(tension.of)
        tendon_numbers += [tendons.names.index(name) for name in tension.of]
        coordinate_numbers += [-1] * len(tension.of)
        groups.append((tension, len(tension.of)))
    if torque is not None:
        for name in torque.of:
            if name not in coordinates.names:
                raise MachineError(
                    f"{source.path}: sensors.torque: {name} is no joint that moves by itself; "
                    f"those are {some_of(coordinates.names)}"
                )
            number = coordinates.names.index(name)
            coordinate_numbers.append(number)
            units.append("N·m" if coordinates.is_hinge[number] else "N")
        names += torque.of
        tendon_numbers += [-1] * len(torque.of)
        groups.append((torque, len(torque.of)))
    limits = [
        [(-np.inf, np.inf) if group.range is None else group.range] * count
        for group, count in groups
    ]
    lowest, highest = np.array([limit for group in limits for limit in group]).T
    return SensorChannels(
        names=tuple(names),
        units=tuple(units),
        tendon=np.array(tendon_numbers, dtype=np.int64),
        coordinate=np.array(coordinate_numbers, dtype=np.int64),
        noise_std=np.concatenate([np.full(count, group.noise_std) for group, count in groups]),
        step=np.concatenate([np.full(count, group.step) for group, count in groups]),
        lowest=lowest,
        highest=highest,
    )


def _links(model: mujoco.MjModel, source: OpenedMachine) -> Links:
    touched = source.file.touch.links
    bodies = {model.body(b).name: b for b in range(1, model.nbody)}
    unknown = [one.link for one in touched if one.link not in bodies]
    if unknown:
        raise MachineError(
            f"{source.path}: touch.links names {some_of(unknown)}, which is no body of "
            f"{source.model_path.name}; it has {some_of(list(bodies))}"
        )
    fixed = [one.link for one in touched if not model.body_weldid[bodies[one.link]]]
    if fixed:
        raise MachineError(
            f"{source.path}: link {some_of(fixed)} does not move, so no force on it is felt; "
            "leave it out of touch.links"
        )
    frames = [_frame(one) for one in touched]
    friction = source.file.touch.friction
    radius_m = np.array([one.radius_m for one in touched])
    return Links(
        names=tuple(one.link for one in touched),
        bodies=np.array([bodies[one.link] for one in touched], dtype=np.int64),
        origin_m=np.array([origin for origin, _, _ in frames]),
        axes=np.array([axes for _, axes, _ in frames]),
        touched_m=np.array([reach for _, _, reach in frames]),
        radius_m=radius_m if friction > 0.0 else np.zeros_like(radius_m),
    )


def _frame(touched: TouchedLink) -> tuple[Array, Array, tuple[float, float]]:
    """Origin (3,) and axes (3, 3) of a link's frame, and the touched range along its x axis."""
    start = np.array(touched.start_m)
    end = np.array(touched.end_m)
    along = (end - start) / np.linalg.norm(end - start)
    first = float(start @ along)
    origin = start - first * along
    return origin, _turned_to(along), (first, float(end @ along))


def _turned_to(along: Array) -> Array:
    """(3, 3) the least rotation that takes the x axis to a direction (3,)."""
    if along[0] < -1.0 + 1e-9:
        return np.diag([-1.0, 1.0, -1.0])
    # R = 1 + [v]x + [v]x² / (1 + c) with v = x cross along, c their cosine (Rodrigues)
    v = np.array([0.0, -along[2], along[1]])
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + along[0]))


def _without_what_tendons_do(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy for kinematics, weights and the springs of joints."""
    bare = copy.copy(model)
    bare.tendon_stiffness[:] = 0.0
    off = mujoco.mjtDisableBit
    for part in (off.mjDSBL_CONSTRAINT, off.mjDSBL_ACTUATION, off.mjDSBL_SENSOR):
        bare.opt.disableflags |= part
    return bare
