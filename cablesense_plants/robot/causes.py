"""Changes that can be hidden in a robot: effects that verdicts have names for, and others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import (
    UNKNOWN,
    Draw,
    Draws,
    HiddenChange,
    added,
    at_index,
    scaled,
    sets,
)
from cablesense_plants.robot.robots import RealRobot, RobotKind

_TWO_PLACES = 0.25
_TIMING_S = 0.002
"""Tolerance of the time between torques and positions."""

RobotChange = HiddenChange[RealRobot]


@dataclass(frozen=True)
class RobotDraw(Draw):
    """The basis of drawn causes: a nominal robot, names of its joints and links."""

    kind: RobotKind
    robot: RealRobot
    joints: list[str]
    links: list[str]

    @property
    def planar(self) -> bool:
        """Whether all axes are parallel: a tilt is then the first joint's zero."""
        return bool((self.robot.chain.axis == self.robot.chain.axis[0]).all())

    @property
    def longest_link_m(self) -> float:
        """The longest link, roughly."""
        return float(np.abs(self.robot.chain.origin_m).max())

    @property
    def alike(self) -> Array:
        """(N,) ones."""
        return np.ones(len(self.joints))

    @property
    def speed(self) -> Array:
        """(N,) what joints typically reach, rad/s."""
        return 2.0 * np.pi * self.kind.speed_hz * self.kind.reach_rad

    def some(self, count: int, *, one: bool = False) -> Any:
        """One position below a count, sometimes two."""
        two = not one and self.chance(_TWO_PLACES)
        return self.rng.permutation(count)[: 2 if two else 1]

    def weighted_joints(self, by: Array | None = None, *, one: bool = False) -> Array:
        """(N,) of one joint, sometimes two; `by` makes them alike in noise of torque."""
        count = len(self.joints)
        chosen = self.some(count, one=one)
        weight = np.zeros(count)
        size = np.ones(count) if by is None else self.kind.noise_n_m / by
        weight[chosen] = size[chosen] / size[chosen].max()
        return weight

    def named(self, weight: Array) -> tuple[str, ...]:
        """Joints with a weight."""
        return tuple(name for name, w in zip(self.joints, weight, strict=True) if w)

    def direction(self) -> Array:
        """(3,) of length 1; in the plane of motion where there is one."""
        way = self.rng.standard_normal(3)
        if self.planar:
            way -= (way @ self.robot.chain.axis[0]) * self.robot.chain.axis[0]
        return np.asarray(way / np.linalg.norm(way))


Drawing = Callable[[RobotDraw], RobotChange]
LISTED = Draws()
UNLISTED = Draws(UNKNOWN)


def at_joints(
    field: str,
    by: Callable[[RobotDraw], Array] | None = None,
    *,
    form: str = "",
    signed: bool = False,
    one: bool = False,
) -> Drawing:
    """Draws a cause that adds to a field of joints; see `RobotDraw.weighted_joints`."""

    def drawn(draw: RobotDraw) -> RobotChange:
        sign = draw.sign() if signed else 1.0
        weight = sign * draw.weighted_joints(by and by(draw), one=one)
        return RobotChange(sets(**{field: added(weight)}), form, draw.named(weight))

    return drawn


@LISTED.of_size("rad", most=0.4)
def base_tilt(draw: RobotDraw) -> RobotChange:
    """A base that is not level."""
    from scipy.spatial.transform import Rotation

    angle = draw.rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    tilted = sets(
        "chain", gravity_m_s2=lambda old, size: Rotation.from_rotvec(-size * axis).apply(old)
    )
    axis_numbers = {"about_x": float(axis[0]), "about_y": float(axis[1])}
    return RobotChange(tilted, "base tilt", (), axis_numbers)


LISTED.of_size("1", most=0.3)(at_joints("encoder_scale", signed=True, one=True), "encoder_scale")


@LISTED.of_size("1", most=0.3)
def joint_coupling(draw: RobotDraw) -> RobotChange:
    """A drive that moves the joint before or behind it too."""
    first = int(draw.rng.integers(len(draw.joints) - 1))
    drive, joint = (first, first + 1) if draw.chance(0.5) else (first + 1, first)
    unit = np.zeros_like(draw.robot.moved)
    unit[joint, drive] = draw.sign()
    place = f"{draw.joints[drive]}_into_{draw.joints[joint]}"
    return RobotChange(sets(moved=added(unit)), "a drive moves two joints", (place,))


@LISTED.of_size("N·m", most=30.0)
def joint_friction(draw: RobotDraw) -> RobotChange:
    """Dry friction, with or without Stribeck's, behind bristles."""
    weight = draw.weighted_joints(draw.alike)
    stribeck = float(draw.rng.choice([0.0, 0.25]))
    soft = float(draw.rng.choice([5e-4, 3e-3]))
    gives = np.full_like(weight, soft)
    rough = sets(dry=added(weight), stribeck=np.array(stribeck), presliding_rad=gives)
    form = f"{'Stribeck' if stribeck else 'Coulomb'}, {'soft' if soft > 1e-3 else 'hard'} bristles"
    return RobotChange(rough, form, draw.named(weight))


LISTED.of_size("N·m/rad", most=60.0)(
    at_joints("stiffness", lambda draw: draw.kind.reach_rad), "joint_spring"
)
LISTED.of_size("rad", most=0.35)(at_joints("zero", signed=True), "joint_zero")


@LISTED.of_size("m")
def link_centre(draw: RobotDraw) -> RobotChange:
    """A centre of mass elsewhere."""
    link = int(draw.rng.integers(len(draw.links)))
    way = draw.direction()
    shifted = sets("chain", centre_m=at_index(link, added(way)))
    return RobotChange(shifted, "shifted", (draw.links[link],), most=0.6 * draw.longest_link_m)


@LISTED.of_size("1", most=2.0)
def link_mass(draw: RobotDraw) -> RobotChange:
    """A link that is heavier or lighter, of the same shape."""
    link = int(draw.rng.integers(len(draw.links)))
    lighter = draw.chance(0.3)

    def law(old: Any, size: float) -> Any:
        return old * (1.0 / (1.0 + size) if lighter else 1.0 + size)

    changed = sets("chain", mass_kg=at_index(link, law), inertia_kg_m2=at_index(link, law))
    return RobotChange(changed, "lighter" if lighter else "heavier", (draw.links[link],))


LISTED.of_size("1", most=0.3)(at_joints("proportional"), "load_friction")


@LISTED.of_size("kg")
def payload(draw: RobotDraw) -> RobotChange:
    """A point mass on a link."""
    link = int(draw.rng.integers(len(draw.links)))
    away_m = draw.longest_link_m * draw.rng.uniform(0.15, 0.5) * draw.direction()
    place = draw.robot.chain.centre_m[link] + away_m
    loaded = sets(chain=lambda chain, size: chain.with_mass(link, size, place))
    details = dict(zip(("x_m", "y_m", "z_m"), map(float, place), strict=True))
    most = 2.0 * float(draw.robot.chain.mass_kg.mean())
    return RobotChange(loaded, "point mass", (draw.links[link],), details, most=most)


LISTED.of_size("kg·m²", most=5.0)(
    at_joints("armature", lambda draw: draw.speed**2 / draw.kind.reach_rad), "rotor_inertia"
)


@LISTED.of_size("s", least=3.0 * _TIMING_S, most=0.04)
def torque_delay(_draw: RobotDraw) -> RobotChange:
    """Torques that are read later than angles."""
    return RobotChange(sets(delay_s=added(1.0)), "torques late")


LISTED.of_size("N·m", most=30.0)(
    at_joints("offset", lambda draw: draw.alike, signed=True), "torque_offset"
)


@LISTED.of_size("1", most=0.4)
def torque_scale(draw: RobotDraw) -> RobotChange:
    """Torques of a wrong scale, of one joint, two or all."""
    everywhere = draw.chance(0.3)
    only_one = len(draw.joints) == 2  # two of two are everywhere
    weight = draw.alike if everywhere else draw.weighted_joints(one=only_one)
    wrong = sets(scale=added(draw.sign() * weight))
    return RobotChange(wrong, where=() if everywhere else draw.named(weight))


LISTED.of_size("N·m·s/rad", most=50.0)(
    at_joints("damping", lambda draw: draw.speed), "viscous_friction"
)


@UNLISTED.of_size("N·m", most=30.0)
def screw_error(draw: RobotDraw) -> RobotChange:
    """A ripple of torque over a turn."""
    weight = draw.weighted_joints(draw.alike)
    waves = np.full(len(weight), draw.rng.uniform(5.0, 12.0))
    phase = draw.rng.uniform(0.0, 2.0 * np.pi, len(weight))
    uneven = sets(cogging=added(weight), cogging_waves=waves, cogging_phase=phase)
    return RobotChange(uneven, where=draw.named(weight))


@UNLISTED.of_size("N·m/rad", most=500.0)
def cable_tie(draw: RobotDraw) -> RobotChange:
    """A hose that catches a joint beyond an angle."""
    weight = draw.sign() * draw.weighted_joints(draw.kind.reach_rad, one=True)
    side = np.sign(weight) * draw.rng.uniform(0.2, 0.6) * draw.kind.reach_rad
    tied = sets(tie=scaled(weight), tie_rad=draw.kind.home_rad + side)
    return RobotChange(tied, where=draw.named(weight))


@UNLISTED.of_size("1", most=0.8)
def warming(draw: RobotDraw) -> RobotChange:
    """Torques whose scale drifts over the recording."""
    return RobotChange(sets(warming=added(draw.sign() * draw.alike)), where=tuple(draw.joints))


@UNLISTED.of_size("1", most=2.2)
def torque_ceiling(draw: RobotDraw) -> RobotChange:
    """Currents clipped at one joint, at what its weight and motion often need."""
    joint = int(draw.rng.integers(len(draw.joints)))
    kind = draw.kind
    home = kind.home_rad
    reach = kind.reach_rad
    pose = np.stack([home, home + reach, home - reach])
    still = np.zeros_like(pose)
    held = np.abs(draw.robot.chain.torques_n_m(pose, still, still))[:, joint].max()
    most = max(float(held), 10.0 * float(kind.noise_n_m[joint]))
    clip = at_index(joint, lambda _, size: most * np.exp(1.0 - size))
    clipped = sets(ceiling=lambda old, size: clip(old + np.zeros(len(draw.joints)), size))
    return RobotChange(clipped, where=(draw.joints[joint],))


@UNLISTED.of_size("rad/(N·m)")
def flexible_base(draw: RobotDraw) -> RobotChange:
    """A base that gives about one axis."""
    angle = draw.rng.uniform(0.0, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    axis = draw.robot.chain.axis[0] if draw.planar else axis
    gives = sets(base_axis=axis, base_stiffness=lambda _, size: np.array(1.0 / size))
    most = 0.5 / float(draw.robot.chain.mass_kg.sum() * 9.81 * draw.longest_link_m)
    return RobotChange(gives, most=most)


@UNLISTED.of_size("N·m", most=60.0)
def push(draw: RobotDraw) -> RobotChange:
    """Someone leans on the robot in one trial."""
    weight = draw.sign() * draw.kind.noise_n_m / draw.kind.noise_n_m.max()
    trial = float(draw.rng.integers(6))
    pushed = sets(push=scaled(weight), push_trial=np.array(trial))
    return RobotChange(pushed, details={"trial": trial})


def with_tolerances(robot: RealRobot, kind: RobotKind, rng: np.random.Generator) -> RealRobot:
    """Manufacturing tolerances: masses and torques to 1 %, centres to 1 mm, zeros to 0.1°."""
    chain = robot.chain
    count = len(robot.damping)
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
