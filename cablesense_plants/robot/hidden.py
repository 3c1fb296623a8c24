"""A real robot: its drives, joints and sensors in addition to rigid bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cablesense_base import Array
from cablesense_plants.robot.chain import LinkChain, read_chain
from cablesense_plants.robot.guides import TendonGuides

_T = TypeVar("_T")
_RIGID = 1e9
"""Stiffness of a base that does not give, N·m/rad."""
_BASE_INERTIA = 1e6
_FLANK_RAD_S = 1000.0
"""At which a rotor would swing on the flank of a tooth."""
_SETTLE_SHARE = 0.3
"""Of a base's critical damping."""


@dataclass(frozen=True)
class RobotKind:
    """A nominal robot, how it is run, and how well it is measured.

    Attributes:
        home_rad, reach_rad: (N,) where trials begin and end, and how far they go from there.
        speed_hz: the fastest of the sines, by joint (N,).
        encoder_rad: an encoder's step.
        noise_n_m: (N,) standard deviation of one sample of a torque.
        rate_hz: of the recording.
        trial_s: of each trial.
        gain_1_s2: (N,) of the controller's position error, by the joint's own inertia.
        tendon_m: (K, N) by how much tendon k pulls at joint n, m; none where motors sit in joints.
        guides: over which its tendons run, where they do.
        drives: names of its actuators.
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
    tendon_m: Array | None = None
    guides: TendonGuides | None = None

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.stem

    def nominal(self) -> tuple[RealRobot, list[str], list[str]]:
        """The robot without anything hidden; names of its joints and links."""
        chain, sizes, joints, links = read_chain(self.path)
        count = len(joints)
        none = np.zeros(count)
        robot = RealRobot(
            chain=chain,
            **sizes,
            dry=none,
            proportional=none,
            capstan=np.zeros(len(self.drives)),
            stribeck=np.array(0.0),
            stribeck_speed=np.array(0.05),
            presliding_rad=np.full(count, 0.002),
            play_rad=none,
            cogging=none,
            cogging_phase=none,
            cogging_waves=np.full(count, 20.0),
            tie=none,
            tie_rad=none,
            push=none,
            push_trial=np.array(-1.0),
            zero=none,
            encoder_scale=none,
            moved=np.eye(count),
            scale=none,
            offset=none,
            warming=none,
            ceiling=np.full(count, np.inf),
            delay_s=np.array(0.0),
            base_axis=np.array([0.0, 1.0, 0.0]),
            base_stiffness=np.array(_RIGID),
        )
        return robot, joints, links


@dataclass(frozen=True)
class RealRobot:
    """One robot, or several with a leading axis (B,) to every array; by joint (N,) unless stated.

    Attributes:
        damping, armature, stiffness: as of MuJoCo.
        dry, proportional: kinetic friction, N·m, and its share of the drive's torque.
        capstan: (K,) friction of tendons with their guides.
        stribeck, stribeck_speed: () by how much more it is at rest, as a share, and until when.
        presliding_rad: how far a stuck joint gives until it slips.
        play_rad: between a motor and its joint, from one flank of the teeth to the other.
        cogging, cogging_phase, cogging_waves: a ripple of torque over a turn.
        tie, tie_rad: stiffness of what catches a joint beyond an angle; its sign has the side.
        push, push_trial: torque by someone in the second half of one trial; () its number.
        zero, encoder_scale: encoders read (1 + scale) times the motor's angle, and zero.
        moved: (N, N) joints' angles by motors' angles.
        scale, offset, warming, ceiling: torques read (1 + scale + warming over the recording)
            times what they are, and offset, and at most a ceiling.
        delay_s: () by how much later than angles torques are read.
        base_axis, base_stiffness: (3,) and () of what the robot stands on.
    """

    chain: LinkChain
    damping: Array
    armature: Array
    stiffness: Array
    dry: Array
    proportional: Array
    capstan: Array
    stribeck: Array
    stribeck_speed: Array
    presliding_rad: Array
    play_rad: Array
    cogging: Array
    cogging_phase: Array
    cogging_waves: Array
    tie: Array
    tie_rad: Array
    push: Array
    push_trial: Array
    zero: Array
    encoder_scale: Array
    moved: Array
    scale: Array
    offset: Array
    warming: Array
    ceiling: Array
    delay_s: Array
    base_axis: Array
    base_stiffness: Array

    def kinetic_n_m(self, speed: Array, drive_n_m: Array) -> Array:
        """Size of the friction that slipping meets."""
        more = self.stribeck * np.exp(-((speed / self.stribeck_speed) ** 2))
        return (self.dry + self.proportional * np.abs(drive_n_m)) * (1.0 + more)

    def motor_n_m(self, angle: Array, speed: Array) -> Array:
        """What resists at the motors, at their angles and speeds, beside rotors and friction."""
        ripple = self.cogging * np.sin(self.cogging_waves * angle + self.cogging_phase)
        return self.damping * speed + ripple

    def spring_n_m(self, angle: Array) -> Array:
        """Torque of springs at the joints, at their angles."""
        beyond = np.maximum((angle - self.tie_rad) * np.sign(self.tie), 0.0)
        return self.stiffness * angle + np.abs(self.tie) * beyond * np.sign(self.tie)

    def flank_n_m(self, ahead: Array, closing: Array) -> Array:
        """Torque through touching teeth, by the lead of motors over joints and its speed."""
        stiffness = self.armature * _FLANK_RAD_S**2
        pressed = ahead - np.clip(ahead, -0.5 * self.play_rad, 0.5 * self.play_rad)
        force = stiffness * pressed + 0.6 * self.armature * _FLANK_RAD_S * closing
        return np.asarray(
            np.where(pressed > 0.0, np.maximum(force, 0.0), np.minimum(force, 0.0))
            * (pressed != 0.0)
        )

    def on_base(self) -> LinkChain:
        """The chain with the base as a first link, which turns about `base_axis`."""
        chain = self.chain
        lead = chain.mass_kg[..., :1]
        return LinkChain(
            axis=np.concatenate([self.base_axis[..., None, :], chain.axis], -2),
            origin_m=_led(chain.origin_m, -2),
            mass_kg=np.concatenate([np.zeros_like(lead), chain.mass_kg], -1),
            centre_m=_led(chain.centre_m, -2),
            inertia_kg_m2=_led(chain.inertia_kg_m2, -3),
            gravity_m_s2=chain.gravity_m_s2,
        )

    def base(self, inertia: Array) -> tuple[Array, Array]:
        """Own inertia and damping (B,) of the base that carries `inertia`."""
        rigid = self.base_stiffness >= _RIGID
        own = np.where(rigid, _BASE_INERTIA, inertia)
        damping = 2.0 * _SETTLE_SHARE * np.sqrt(self.base_stiffness * (own + inertia))
        return own, damping

    def read_n_m(self, torque_n_m: Array, time_s: Array) -> Array:
        """Torques (T, B, N) as sensors without noise give them, at times (T,) of the motion."""
        step_s = time_s[1] - time_s[0]
        late = np.empty_like(torque_n_m)
        shift = np.broadcast_to(self.delay_s, torque_n_m.shape[1:2]) / step_s
        rows = np.arange(len(time_s))
        for b, steps in enumerate(shift):
            at = np.clip(rows - steps, 0, len(rows) - 1)
            low = np.minimum(at.astype(int), len(rows) - 2)
            part = (at - low)[:, None]
            late[:, b] = (1.0 - part) * torque_n_m[low, b] + part * torque_n_m[low + 1, b]
        share = (time_s / time_s[-1])[:, None, None]
        read = (1.0 + self.scale + self.warming * share) * late + self.offset
        return np.clip(read, -self.ceiling, self.ceiling)


def stacked(robots: Sequence[_T]) -> _T:
    """Robots side by side, each array with a leading axis."""
    first: Any = robots[0]
    if not is_dataclass(first):
        return np.stack(robots)  # type: ignore[return-value, arg-type]
    parts = {f.name: stacked([getattr(r, f.name) for r in robots]) for f in fields(first)}
    together: Any = replace(first, **parts)  # type: ignore[type-var]
    return _columns(together)


def _columns(robots: Any) -> Any:
    """Numbers by robot (B,) as columns (B, 1), where they meet joints."""
    if not isinstance(robots, RealRobot):
        return robots
    return replace(
        robots,
        stribeck=robots.stribeck[:, None],
        stribeck_speed=robots.stribeck_speed[:, None],
        push_trial=robots.push_trial[:, None],
    )


def _led(values: Array, axis: int) -> Array:
    """Zeros for the base before the links' values."""
    first = np.take(values, [0], axis)
    return np.concatenate([np.zeros_like(first), values], axis)
