"""Changes that can be hidden in a robot: effects that verdicts have names for, and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import UNKNOWN, HiddenChange
from cablesense_plants.robot.hidden import RealRobot, RobotKind

_TWO_PLACES = 0.25
_TIMING_S = 0.002
"""Tolerance of the time between torques and positions."""


RobotChange = HiddenChange[RealRobot]


@dataclass(frozen=True)
class RobotDraw:
    """The basis of drawn causes: a nominal robot, names of its joints and links."""

    rng: np.random.Generator
    kind: RobotKind
    robot: RealRobot
    joints: list[str]
    links: list[str]

    @property
    def planar(self) -> bool:
        """Whether all axes are parallel: a tilt is then the first joint's zero."""
        return bool((self.robot.chain.axis == self.robot.chain.axis[0]).all())

    def sign(self) -> float:
        """1 or -1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def weighted_joints(self, by: Array | None = None, *, one: bool = False) -> Array:
        """(N,) of one joint, sometimes two; `by` makes them alike in noise of torque."""
        count = len(self.joints)
        two = not one and self.rng.random() < _TWO_PLACES
        chosen = self.rng.permutation(count)[: 2 if two else 1]
        weight = np.zeros(count)
        size = np.ones(count) if by is None else self.kind.noise_n_m / by
        weight[chosen] = size[chosen] / size[chosen].max()
        return weight

    def named(self, weight: Array) -> tuple[str, ...]:
        """Joints with a weight; none where all have one."""
        return tuple(name for name, w in zip(self.joints, weight, strict=True) if w)

    def direction(self) -> Array:
        """(3,) of length 1; in the plane of motion where there is one."""
        way = self.rng.standard_normal(3)
        if self.planar:
            way -= (way @ self.robot.chain.axis[0]) * self.robot.chain.axis[0]
        return np.asarray(way / np.linalg.norm(way))

    def speed(self) -> Array:
        """(N,) what joints typically reach, rad/s."""
        return 2.0 * np.pi * self.kind.speed_hz * self.kind.reach_rad


def _change(
    effect: str,
    form: str,
    apply: Callable[[RealRobot, float], RealRobot],
    most: float,
    unit: str,
    places: tuple[str, ...] = (),
    details: Mapping[str, float] = MappingProxyType({}),
    least: float = 0.0,
) -> RobotChange:
    return RobotChange(apply, form, places, details, effect, unit, least, most)


def _added(name: str, weight: Array) -> Callable[[RealRobot, float], RealRobot]:
    return lambda robot, size: replace(robot, **{name: getattr(robot, name) + size * weight})


def _by_joint(
    draw: RobotDraw, effect: str, name: str, weight: Array, most: float, unit: str, form: str = ""
) -> RobotChange:
    places = draw.named(weight)
    return _change(effect, form or effect, _added(name, weight), most, unit, places)


def _joint_friction(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(np.ones(len(draw.joints)))
    stribeck = float(draw.rng.choice([0.0, 0.25]))
    soft = float(draw.rng.choice([5e-4, 3e-3]))

    def apply(robot: RealRobot, size: float) -> RealRobot:
        gives = np.full_like(weight, soft)
        sticks = np.array(stribeck)
        return replace(robot, dry=robot.dry + size * weight, stribeck=sticks, presliding_rad=gives)

    form = f"{'Stribeck' if stribeck else 'Coulomb'}, {'soft' if soft > 1e-3 else 'hard'} bristles"
    return _change("joint_friction", form, apply, 30.0, "N·m", draw.named(weight))


def _load_friction(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints()
    return _by_joint(draw, "load_friction", "proportional", weight, 0.3, "1")


def _capstan_friction(draw: RobotDraw) -> RobotChange:
    names, two = draw.kind.drives, draw.rng.random() < _TWO_PLACES
    chosen = draw.rng.permutation(len(names))[: 2 if two else 1]
    weight = np.zeros(len(names))
    weight[chosen] = 1.0
    places = tuple(names[k] for k in sorted(chosen))
    rubs = _added("capstan", weight)
    return _change("capstan_friction", "elastic tendons stick and slip", rubs, 1.0, "1", places)


def _viscous_friction(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(draw.speed())
    return _by_joint(draw, "viscous_friction", "damping", weight, 50.0, "N·m·s/rad")


def _rotor_inertia(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(draw.speed() ** 2 / draw.kind.reach_rad)
    return _by_joint(draw, "rotor_inertia", "armature", weight, 5.0, "kg·m²")


def _joint_spring(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(draw.kind.reach_rad)
    return _by_joint(draw, "joint_spring", "stiffness", weight, 60.0, "N·m/rad")


def _joint_zero(draw: RobotDraw) -> RobotChange:
    weight = draw.sign() * draw.weighted_joints()
    return _by_joint(draw, "joint_zero", "zero", weight, 0.35, "rad")


def _encoder_scale(draw: RobotDraw) -> RobotChange:
    weight = draw.sign() * draw.weighted_joints(one=True)
    return _by_joint(draw, "encoder_scale", "encoder_scale", weight, 0.3, "1")


def _torque_scale(draw: RobotDraw) -> RobotChange:
    everywhere = draw.rng.random() < 0.3
    one = len(draw.joints) == 2  # two of two are everywhere
    weight = np.ones(len(draw.joints)) if everywhere else draw.weighted_joints(one=one)
    cause = _by_joint(draw, "torque_scale", "scale", draw.sign() * weight, 0.4, "1")
    return replace(cause, where=()) if everywhere else cause


def _torque_offset(draw: RobotDraw) -> RobotChange:
    weight = draw.sign() * draw.weighted_joints(np.ones(len(draw.joints)))
    return _by_joint(draw, "torque_offset", "offset", weight, 30.0, "N·m")


def _torque_delay(draw: RobotDraw) -> RobotChange:
    late = _added("delay_s", np.array(1.0))
    return _change("torque_delay", "torques late", late, 0.04, "s", least=3.0 * _TIMING_S)


def _base_tilt(draw: RobotDraw) -> RobotChange:
    from scipy.spatial.transform import Rotation

    angle = draw.rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])

    def apply(robot: RealRobot, size: float) -> RealRobot:
        turned = Rotation.from_rotvec(-size * axis).apply(robot.chain.gravity_m_s2)
        return replace(robot, chain=replace(robot.chain, gravity_m_s2=turned))

    about = {"about_x": float(axis[0]), "about_y": float(axis[1])}
    return _change("base_tilt", "base tilt", apply, 0.4, "rad", details=about)


def _joint_coupling(draw: RobotDraw) -> RobotChange:
    first = int(draw.rng.integers(len(draw.joints) - 1))
    drive, joint = (first, first + 1) if draw.rng.random() < 0.5 else (first + 1, first)
    sign = draw.sign()

    def apply(robot: RealRobot, size: float) -> RealRobot:
        moved = robot.moved.copy()
        moved[joint, drive] += sign * size
        return replace(robot, moved=moved)

    place = f"{draw.joints[drive]}_into_{draw.joints[joint]}"
    return _change("joint_coupling", "a drive moves two joints", apply, 0.3, "1", (place,))


def _with_link(robot: RealRobot, link: int, **values: Any) -> RealRobot:
    """Arrays of the chain, with one link's part set."""
    parts = {name: getattr(robot.chain, name).copy() for name in values}
    for name, value in values.items():
        parts[name][link] = value
    return replace(robot, chain=replace(robot.chain, **parts))


def _link_mass(draw: RobotDraw) -> RobotChange:
    link = int(draw.rng.integers(len(draw.links)))
    lighter = draw.rng.random() < 0.3

    def apply(robot: RealRobot, size: float) -> RealRobot:
        share = 1.0 / (1.0 + size) if lighter else 1.0 + size
        mass, inertia = robot.chain.mass_kg[link], robot.chain.inertia_kg_m2[link]
        return _with_link(robot, link, mass_kg=mass * share, inertia_kg_m2=inertia * share)

    form = "lighter" if lighter else "heavier"
    return _change("link_mass", form, apply, 2.0, "1", (draw.links[link],))


def _link_centre(draw: RobotDraw) -> RobotChange:
    link = int(draw.rng.integers(len(draw.links)))
    way = draw.direction()

    def apply(robot: RealRobot, size: float) -> RealRobot:
        return _with_link(robot, link, centre_m=robot.chain.centre_m[link] + size * way)

    most = 0.6 * _reach_m(draw)
    return _change("link_centre", "shifted", apply, most, "m", (draw.links[link],))


def _payload(draw: RobotDraw) -> RobotChange:
    link = int(draw.rng.integers(len(draw.links)))
    place = draw.robot.chain.centre_m[link] + _reach_m(draw) * draw.rng.uniform(0.15, 0.5) * (
        draw.direction()
    )

    def apply(robot: RealRobot, size: float) -> RealRobot:
        return replace(robot, chain=robot.chain.with_mass(link, size, place))

    at = dict(zip(("x_m", "y_m", "z_m"), map(float, place), strict=True))
    most = 2.0 * float(draw.robot.chain.mass_kg.mean())
    return _change("payload", "point mass", apply, most, "kg", (draw.links[link],), at)


def _reach_m(draw: RobotDraw) -> float:
    return float(np.abs(draw.robot.chain.origin_m).max())


def _backlash(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(one=True)
    return _by_joint(draw, "backlash", "play_rad", weight, 0.04, "rad", "teeth with play")


LISTED: dict[str, Callable[[RobotDraw], RobotChange]] = {
    "base_tilt": _base_tilt,
    "encoder_scale": _encoder_scale,
    "joint_coupling": _joint_coupling,
    "joint_friction": _joint_friction,
    "joint_spring": _joint_spring,
    "joint_zero": _joint_zero,
    "link_centre": _link_centre,
    "link_mass": _link_mass,
    "load_friction": _load_friction,
    "payload": _payload,
    "rotor_inertia": _rotor_inertia,
    "torque_delay": _torque_delay,
    "torque_offset": _torque_offset,
    "torque_scale": _torque_scale,
    "viscous_friction": _viscous_friction,
}


def _screw_error(draw: RobotDraw) -> RobotChange:
    weight = draw.weighted_joints(np.ones(len(draw.joints)))
    waves = np.full(len(weight), draw.rng.uniform(5.0, 12.0))
    phase = draw.rng.uniform(0.0, 2.0 * np.pi, len(weight))

    def apply(robot: RealRobot, size: float) -> RealRobot:
        amplitude = robot.cogging + size * weight
        return replace(robot, cogging=amplitude, cogging_waves=waves, cogging_phase=phase)

    return _change(UNKNOWN, "screw_error", apply, 30.0, "N·m", draw.named(weight))


def _cable_tie(draw: RobotDraw) -> RobotChange:
    weight = draw.sign() * draw.weighted_joints(draw.kind.reach_rad, one=True)
    side = np.sign(weight) * draw.rng.uniform(0.2, 0.6) * draw.kind.reach_rad
    beyond = draw.kind.home_rad + side

    def apply(robot: RealRobot, size: float) -> RealRobot:
        return replace(robot, tie=size * weight, tie_rad=beyond)

    return _change(UNKNOWN, "cable_tie", apply, 500.0, "N·m/rad", draw.named(weight))


def _warming(draw: RobotDraw) -> RobotChange:
    weight = draw.sign() * np.ones(len(draw.joints))
    return _by_joint(draw, UNKNOWN, "warming", weight, 0.8, "1", "warming")


def _ceiling(draw: RobotDraw) -> RobotChange:
    """Currents clipped at one joint, at what its weight and motion often need."""
    joint = int(draw.rng.integers(len(draw.joints)))
    robot, kind = draw.robot, draw.kind
    pose = np.stack(
        [kind.home_rad, kind.home_rad + kind.reach_rad, kind.home_rad - kind.reach_rad]
    )
    still = np.zeros_like(pose)
    most = np.abs(robot.chain.torques_n_m(pose, still, still))[:, joint].max()
    most = max(float(most), 10.0 * float(kind.noise_n_m[joint]))

    def apply(robot: RealRobot, size: float) -> RealRobot:
        ceiling = robot.ceiling.copy()
        ceiling[joint] = most * np.exp(1.0 - size)
        return replace(robot, ceiling=ceiling)

    return _change(UNKNOWN, "torque_ceiling", apply, 2.2, "1", (draw.joints[joint],))


def _flexible_base(draw: RobotDraw) -> RobotChange:
    angle = draw.rng.uniform(0.0, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    axis = draw.robot.chain.axis[0] if draw.planar else axis

    def apply(robot: RealRobot, size: float) -> RealRobot:
        return replace(robot, base_axis=axis, base_stiffness=np.array(1.0 / size))

    carried = float(draw.robot.chain.mass_kg.sum() * 9.81 * _reach_m(draw))
    return _change(UNKNOWN, "flexible_base", apply, 0.5 / carried, "rad/(N·m)")


def _push(draw: RobotDraw) -> RobotChange:
    """Someone leans on the robot in one trial."""
    weight = draw.sign() * draw.kind.noise_n_m / draw.kind.noise_n_m.max()
    trial = float(draw.rng.integers(6))

    def apply(robot: RealRobot, size: float) -> RealRobot:
        return replace(robot, push=size * weight, push_trial=np.array(trial))

    return _change(UNKNOWN, "push", apply, 60.0, "N·m", details={"trial": trial})


UNLISTED: dict[str, Callable[[RobotDraw], RobotChange]] = {
    "screw_error": _screw_error,
    "cable_tie": _cable_tie,
    "warming": _warming,
    "torque_ceiling": _ceiling,
    "flexible_base": _flexible_base,
    "push": _push,
}


_IN_TORQUES = ("torque_delay", "torque_offset", "torque_scale", "warming", "torque_ceiling")


def pools(*, commands: bool) -> tuple[dict[str, Callable[[RobotDraw], RobotChange]], ...]:
    """Listed and unlisted causes; without torques, by commands, those that show in motion.

    Play is among the latter alone, so that seeds of recordings with torques stay what they were.
    """
    if not commands:
        return LISTED, UNLISTED
    listed, unlisted = (
        {name: cause for name, cause in pool.items() if name not in _IN_TORQUES}
        for pool in ({**LISTED, "backlash": _backlash}, UNLISTED)
    )
    return listed, unlisted


def of_tendons() -> tuple[dict[str, Callable[[RobotDraw], RobotChange]], ...]:
    """Friction of tendons over guides, and the kinds of friction that it may be taken for."""
    alike = ("joint_friction", "load_friction", "viscous_friction")
    return {"capstan_friction": _capstan_friction}, {name: LISTED[name] for name in alike}


def with_tolerances(robot: RealRobot, kind: RobotKind, rng: np.random.Generator) -> RealRobot:
    """Manufacturing tolerances: masses and torques to 1 %, centres to 1 mm, zeros to 0.1°."""
    chain, count = robot.chain, len(robot.damping)
    mass = 1.0 + 0.01 * rng.standard_normal(count)
    small_m = min(1e-3, 0.01 * float(np.abs(chain.origin_m).max()))
    chain = replace(
        chain,
        mass_kg=chain.mass_kg * mass,
        centre_m=chain.centre_m + small_m * rng.standard_normal((count, 3)),
        inertia_kg_m2=chain.inertia_kg_m2 * mass[:, None, None],
    )
    return replace(
        robot,
        chain=chain,
        damping=robot.damping * (1.0 + 0.03 * rng.standard_normal(count)),
        armature=robot.armature * (1.0 + 0.02 * rng.standard_normal(count)),
        stiffness=robot.stiffness * (1.0 + 0.02 * rng.standard_normal(count)),
        zero=robot.zero + np.deg2rad(0.1) * rng.standard_normal(count),
        scale=robot.scale + 0.01 * rng.standard_normal(count),
        offset=robot.offset + 0.05 * kind.noise_n_m * rng.standard_normal(count),
    )
