"""Real robots: drives, joints and sensors in addition to rigid bodies; and three nominal ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import NO_FAULT
from cablesense_plants.robot.chain import LinkChain, read_chain
from cablesense_plants.robot.guides import TendonGuides, read_guides

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
        model: as MuJoCo read it, if not from the file.
        home_rad, reach_rad: (N,) where trials begin and end, and how far they go from there.
        speed_hz: the fastest of the sines, by joint (N,).
        encoder_rad: an encoder's step.
        noise_n_m: (N,) standard deviation of one sample of a torque.
        rate_hz: of the recording.
        trial_s: of each trial.
        gain_1_s2: of the controller's position error, by each joint's own inertia.
        drives: names of its actuators.
        tendon_m: (K, N) by how much tendon k pulls at joint n, m; none where motors sit in joints.
        guides: over which its tendons run, where they do.
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
    tendon_m: Array | None = None
    guides: TendonGuides | None = None
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
        moved, capstan = np.eye(len(joints)), np.zeros(len(self.drives))
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
        own = np.where(stiffness >= _RIGID, _BASE_INERTIA, inertia)
        return own, 2.0 * _SETTLE_SHARE * np.sqrt(stiffness * (own + inertia))

    def read_n_m(self, torque_n_m: Array, time_s: Array) -> Array:
        """Torques (T, B, N) as sensors without noise give them, at times (T,) of the motion."""
        late = np.empty_like(torque_n_m)
        rows = np.arange(len(time_s))
        for b, steps in enumerate(self.delay_s[:, 0] / (time_s[1] - time_s[0])):
            at = np.clip(rows - steps, 0, len(rows) - 1)
            low = np.minimum(at.astype(int), len(rows) - 2)
            part = (at - low)[:, None]
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
    each: Any = robots
    values: Any = np.stack(np.broadcast_arrays(*each))
    return values if values.ndim > 1 else values[:, None]


MODELS = Path(__file__).parents[2] / "config" / "robots"

KINDS = {
    kind.name: kind
    for kind in (
        RobotKind(
            path=MODELS / "arm_6.xml",
            home_rad=np.array([0.0, -0.7, 1.1, 0.0, 0.5, 0.0]),
            reach_rad=np.array([1.2, 0.6, 0.8, 1.2, 0.9, 1.5]),
            speed_hz=np.array([0.5, 0.5, 0.6, 0.8, 0.8, 1.0]),
            encoder_rad=2.0 * np.pi / 2**16,
            noise_n_m=np.array([0.2, 0.25, 0.15, 0.04, 0.04, 0.02]),
            rate_hz=250,
            trial_s=4.0,
            gain_1_s2=600.0,
            drives=tuple(f"motor_{n + 1}" for n in range(6)),
        ),
        RobotKind(
            path=MODELS / "two_links.xml",
            home_rad=np.array([0.3, -0.2]),
            reach_rad=np.array([1.8, 2.2]),
            speed_hz=np.array([1.0, 1.3]),
            encoder_rad=2.0 * np.pi / 2**15,
            noise_n_m=np.array([0.02, 0.012]),
            rate_hz=200,
            trial_s=5.0,
            gain_1_s2=500.0,
            drives=("motor_1", "motor_2"),
        ),
        RobotKind(
            path=MODELS / "finger.xml",
            home_rad=np.array([0.5, 0.5]),
            reach_rad=np.array([0.7, 0.8]),
            speed_hz=np.array([1.5, 1.8]),
            encoder_rad=2.0 * np.pi / 2**14,
            noise_n_m=np.array([0.0012, 0.0008]),
            rate_hz=500,
            trial_s=4.0,
            gain_1_s2=900.0,
            drives=("flexor_1", "extensor_1", "flexor_2", "extensor_2"),
            tendon_m=np.array([[0.011, 0.0], [-0.010, 0.0], [0.009, 0.008], [-0.008, -0.007]]),
        ),
    )
}
_SERVO_GAIN_1_S2, _CAMERA_RAD = 300.0, 1e-3
SERVOS = {
    name: replace(
        KINDS[name], gain_1_s2=_SERVO_GAIN_1_S2, encoder_rad=_CAMERA_RAD, rate_hz=100, servos=True
    )
    for name in ("arm_6", "two_links")
}
"""Robots under position servos that a camera watches."""
_GUIDED = MODELS / "guided_finger.xml"
GUIDED = replace(KINDS["finger"], path=_GUIDED, tendon_m=None, guides=read_guides(_GUIDED))
"""The finger with tendons over guides, for causes that the others cannot show."""
