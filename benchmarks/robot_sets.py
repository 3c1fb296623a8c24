"""The robots of the blind sets, their hidden effects, and tendons over guides.

Tendons are elastic cable in pieces, which sticks and slips from piece to piece. Between two guides
lies one piece. Each step, cable passes a guide from the looser piece to the tighter one until
the ratio of their tensions is Euler's at most, guide after guide, until no more passes; beyond
the last guide it is held. The piece before the first has the motor's tension.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_gap.robot.recording import RobotRecording
from cablesense_plants.cases import Draws, added, in_turn, sets
from cablesense_plants.robot.cases import RobotCase, draw_case, rms, sets_of_names
from cablesense_plants.robot.causes import (
    LISTED,
    UNLISTED,
    Drawing,
    RobotChange,
    RobotDraw,
    at_joints,
)
from cablesense_plants.robot.motion import ReferenceMotion, prescribed_n_m
from cablesense_plants.robot.robots import RealRobot, RobotKind

PRETENSION_N = 2.0
_STIFF_N_M = 2e4
"""Of a piece: some 5 N/mm for a whole tendon."""
_SWEEPS = 40
_CLOSE_N = 1e-3
_FINGER_M = np.array([[0.011, 0.0], [-0.010, 0.0], [0.009, 0.008], [-0.008, -0.007]])
"""(K, N) by how much a tendon of the finger pulls at a joint."""
_IMPERFECT = (0.05, 0.15)
"""Share of each joint's torque, RMS, that an imperfect nominal robot leaves."""


_LIFT = """<mujoco><worldbody>
<body name="column"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
<body name="carriage" pos="0.3 0 0"><joint name="reach" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></body>
</worldbody></mujoco>"""


@dataclass(frozen=True)
class TendonGuides:
    """Of K tendons, P points each, of a robot whose N joints all turn about y.

    Places in the plane of motion are complex numbers, x + iz.

    Attributes:
        link: (K, P) which each point is on, 0 the base's.
        place_m: (K, P) there.
        origin_m: (N,) of each joint on the link before.
    """

    link: Array
    place_m: Array
    origin_m: Array

    def pose(self, angle: Array) -> tuple[Array, Array]:
        """Points (B, K, P) and joints (B, N) in base axes, at angles (B, N)."""
        turned = np.exp(-1j * np.cumsum(np.pad(angle, ((0, 0), (1, 0))), axis=1))
        joints = np.cumsum(turned[:, :-1] * self.origin_m, axis=1)
        origin = np.pad(joints, ((0, 0), (1, 0)))
        return origin[:, self.link] + turned[:, self.link] * self.place_m, joints

    def torques_n_m(self, pose: tuple[Array, Array], tension_n: Array) -> Array:
        """(B, K, N) of each tendon about each joint, of tensions (B, K, P - 1) in its pieces."""
        points, joints = pose
        piece = np.diff(points)
        pull = tension_n * piece / np.abs(piece)
        force = np.diff(pull, prepend=0.0, append=0.0)
        arm = points[..., None] - joints[:, None, None]
        about_y = -(arm.conj() * force[..., None]).imag
        carried = self.link[..., None] > np.arange(joints.shape[1])
        return np.asarray((about_y * carried).sum(2))

    def moments_m(self, angle: Array) -> Array:
        """(B, K, N) torque by tension without friction."""
        pose = self.pose(angle)
        return self.torques_n_m(pose, np.ones_like(np.diff(pose[0].real)))


class Rubbing:
    """The cable of B robots, and how it lies now."""

    def __init__(self, guides: TendonGuides, friction: Array, angle: Array) -> None:
        """`friction` (B, K) of each tendon with its guides; at angles (B, N) at first."""
        self._guides = guides
        self._friction = friction
        points, _ = guides.pose(angle)
        self._natural_m = np.abs(np.diff(points)) - PRETENSION_N / _STIFF_N_M

    def lost_n_m(self, angle: Array, torque_n_m: Array) -> Array:
        """(B, N) loss of the motors' torques, on the way to angles (B, N)."""
        pose = self._guides.pose(angle)
        piece = np.diff(pose[0])
        turn = np.abs(np.angle(piece[..., 1:] / piece[..., :-1]))
        most = np.exp(self._friction[..., None] * turn)
        tension = _STIFF_N_M * (np.abs(piece) - self._natural_m)
        tension[..., 0] = pulls_n(self._guides.moments_m(angle), torque_n_m)
        self._natural_m += tension / _STIFF_N_M
        rubs = self._friction > 0.0
        tension[~rubs] = tension[~rubs][:, :1]
        tension[rubs] = _settled(tension[rubs], most[rubs])
        self._natural_m -= tension / _STIFF_N_M
        return np.asarray(torque_n_m - self._guides.torques_n_m(pose, tension).sum(1))


def _settled(tension_n: Array, most: Array) -> Array:
    """Tensions (C, P - 1) of which neighbours differ by a factor of `most` (C, P - 2) at most."""
    pieces = tension_n.T.copy()
    low = 1.0 / most.T
    for _ in range(_SWEEPS):
        before = pieces.copy()
        for n in range(1, len(pieces)):
            near = pieces[n - 1]
            far = pieces[n]
            ratio = np.minimum(np.maximum(near / far, low[n - 1]), most[:, n - 1])
            if n == 1:  # the motor holds what lies before
                pieces[n] = near / ratio
            else:
                passed = (near - ratio * far) / (1.0 + ratio)
                pieces[n - 1] = near - passed
                pieces[n] = far + passed
        if np.abs(pieces - before).max(initial=0.0) < _CLOSE_N:
            break
    return np.maximum(pieces.T, 1e-3)


def pulls_n(moment_m: Array, torque_n_m: Array) -> Array:
    """Tensions (…, K) of a pair of tendons for each joint, the last joint's first.

    They make torques (…, N) by moments (…, K, N) or (K, N), and none is below the pretension.
    """
    remaining_n_m = torque_n_m.copy()
    pulls = np.full((*remaining_n_m.shape[:-1], moment_m.shape[-2]), PRETENSION_N)
    for joint in reversed(range(remaining_n_m.shape[-1])):
        pair = slice(2 * joint, 2 * joint + 2)
        remaining_n_m = remaining_n_m - PRETENSION_N * moment_m[..., pair, :].sum(-2)
        for tendon in (2 * joint, 2 * joint + 1):
            more = np.maximum(remaining_n_m[..., joint] / moment_m[..., tendon, joint], 0.0)
            pulls[..., tendon] += more
            remaining_n_m = remaining_n_m - more[..., None] * moment_m[..., tendon, :]
    return pulls


def read_guides(path: Path) -> TendonGuides:
    """The tendons of one of these MJCFs; short ones have points more on their first piece."""
    model = mujoco.MjModel.from_xml_path(str(path))
    most = int(model.tendon_num.max())
    links = []
    places = []
    at_m = model.site_pos @ (1.0, 0.0, 1j)
    for first, count in zip(model.tendon_adr, model.tendon_num, strict=True):
        sites = model.wrap_objid[first : first + count]
        missing = most - count
        link = model.site_bodyid[sites]
        place_m = at_m[sites]
        links.append(np.pad(link, (missing, 0), mode="edge"))
        between = np.linspace(place_m[0], place_m[1], missing + 1, endpoint=False)
        places.append([*between, *place_m[1:]])
    return TendonGuides(np.array(links), np.array(places), model.body_pos[1:] @ (1.0, 0.0, 1j))


_MODELS = Path(__file__).parents[1] / "config" / "robots"

KINDS = {
    kind.name: kind
    for kind in (
        RobotKind(
            path=_MODELS / "arm_6.xml",
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
            path=_MODELS / "two_links.xml",
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
            path=_MODELS / "finger.xml",
            home_rad=np.array([0.5, 0.5]),
            reach_rad=np.array([0.7, 0.8]),
            speed_hz=np.array([1.5, 1.8]),
            encoder_rad=2.0 * np.pi / 2**14,
            noise_n_m=np.array([0.0012, 0.0008]),
            rate_hz=500,
            trial_s=4.0,
            gain_1_s2=900.0,
            drives=("flexor_1", "extensor_1", "flexor_2", "extensor_2"),
            pulls_n=lambda _angle, _drive, asked: pulls_n(_FINGER_M, asked),
        ),
    )
}
_SERVO_GAIN_1_S2 = 300.0
_CAMERA_RAD = 1e-3
SERVOS = {
    name: replace(
        KINDS[name], gain_1_s2=_SERVO_GAIN_1_S2, encoder_rad=_CAMERA_RAD, rate_hz=100, servos=True
    )
    for name in ("arm_6", "two_links")
}
"""Robots under position servos that a camera watches."""
_GUIDED = _MODELS / "guided_finger.xml"
GUIDES = read_guides(_GUIDED)
GUIDED = replace(
    KINDS["finger"],
    path=_GUIDED,
    pulls_n=lambda angle, drive, _asked: pulls_n(GUIDES.moments_m(angle), drive),
    rubbing=lambda friction, angle: Rubbing(GUIDES, friction, angle).lost_n_m,
)
"""The finger with tendons over guides, for causes that the others cannot show."""
_MOVING = Draws()
_IN_SERVOS = Draws()
_TENDONS = Draws()
_MOVING.of_size("rad", most=0.04)(
    at_joints("play_rad", form="teeth with play", one=True), "backlash"
)
_IN_SERVOS.of_size("1", most=0.6)(
    at_joints("servo_scale", form="another gain", signed=True, one=True), "servo_gain"
)


@_TENDONS.of_size("1", most=1.0)
def capstan_friction(draw: RobotDraw) -> RobotChange:
    """Tendons that rub on their guides."""
    names = draw.kind.drives
    chosen = draw.some(len(names))
    weight = np.zeros(len(names))
    weight[chosen] = 1.0
    where = tuple(names[k] for k in sorted(chosen))
    return RobotChange(sets(capstan=added(weight)), "elastic tendons stick and slip", where)


_IN_TORQUES = ("torque_delay", "torque_offset", "torque_scale", "warming", "torque_ceiling")


def drawn(
    count: int, seed: int, *, commands: bool = False, imperfect: bool = False
) -> list[RobotCase]:
    """Cases of a seed: robots in turn; shares of `none`, `unknown`, one and several effects.

    By `commands` causes are left out that show in torques alone, and play is added, which they
    show. With `imperfect` the nominal robots lack friction by position, springs of cable bundles
    and ripples of gears, which all recordings have.
    """
    rng = np.random.default_rng([seed])
    known: list[dict[str, Drawing]] = [LISTED, UNLISTED]
    if commands:
        known = [
            {name: cause for name, cause in pool.items() if name not in _IN_TORQUES}
            for pool in (LISTED | _MOVING, UNLISTED)
        ]
    hidden = sets_of_names(rng, count, known)
    kinds = in_turn(rng, list(KINDS))
    lacking = with_what_models_lack if imperfect else None
    return [
        draw_case(KINDS[next(kinds)], cause, seed, index, known, lacking)
        for index, cause in enumerate(hidden, start=1)
    ]


def with_what_models_lack(
    robot: RealRobot, kind: RobotKind, rng: np.random.Generator, asked: ReferenceMotion
) -> RealRobot:
    """The robot with what its model lacks, in random shares, joint by joint."""
    count = len(kind.home_rad)
    whole = prescribed_n_m(kind, robot, asked)
    mix = rng.uniform(0.2, 1.0, (3, count))
    mix *= rng.uniform(*_IMPERFECT, count) / np.linalg.norm(mix, axis=0)
    robot = replace(
        robot,
        worn_waves=rng.uniform(1.0, 6.0, count),
        worn_phase=rng.uniform(0.0, 2.0 * np.pi, count),
        harness_rad=kind.home_rad + rng.uniform(-0.5, 0.5, count) * kind.reach_rad,
        harness_reach=kind.reach_rad,
        ripple_waves=rng.uniform(6.0, 30.0, count),
        ripple_phase=rng.uniform(0.0, 2.0 * np.pi, count),
    )
    sizes: dict[str, Any] = {}
    for name, share in zip(("worn", "harness", "ripple"), mix, strict=True):
        probe: Any = 0.1 * (np.ones(count) if name == "ripple" else whole.std(0))
        made = prescribed_n_m(kind, replace(robot, **{name: probe}), asked) - whole
        sizes[name] = probe * share * rms(whole) / rms(made)
    return replace(robot, **sizes)


def with_play(count: int, seed: int) -> list[RobotCase]:
    """Pendulums of two links, each with backlash in one joint."""
    kind = KINDS["two_links"]
    return [draw_case(kind, ["backlash"], seed, k + 1, [_MOVING]) for k in range(count)]


def with_tendons(count: int, seed: int) -> list[RobotCase]:
    """Fingers with guides: of four two have tendons that rub, one other friction, one nothing."""
    alike = ("joint_friction", "load_friction", "viscous_friction")
    known = [_TENDONS, {name: LISTED[name] for name in alike}]
    others = in_turn(np.random.default_rng([seed]), alike)
    cases = []
    for k in range(count):
        names = ["capstan_friction"] if k % 2 == 0 else []
        if k % 4 == 3:
            names = [next(others)]
        cases.append(draw_case(GUIDED, names, seed, k + 1, known))
    return cases


def with_servos(count: int, seed: int) -> list[RobotCase]:
    """Robots under position servos that a camera watches: one cause in turn, then nothing.

    Play is the pendulum's, see `with_play`.
    """
    listed = ("joint_zero", "backlash", "joint_coupling", "payload", "servo_gain")
    known = {name: (LISTED | _MOVING | _IN_SERVOS)[name] for name in listed}
    turns = [*([name] for name in listed), []]
    cases = []
    kinds = in_turn(np.random.default_rng([seed]), list(SERVOS))
    for k in range(count):
        names = turns[k % len(turns)]
        kind = "two_links" if "backlash" in names else next(kinds)
        cases.append(draw_case(SERVOS[kind], names, seed, k + 1, [known]))
    return cases


def with_payload(size: float, seed: int, index: int) -> RobotCase:
    """A pendulum or an arm with `size` times the mass of one of its links on that link."""

    def payload(draw: RobotDraw) -> RobotChange:
        drawn = LISTED["payload"](draw)
        mass_kg = size * float(draw.robot.chain.mass_kg[draw.links.index(drawn.where[0])])
        return replace(drawn, least=mass_kg, most=mass_kg)

    kind = KINDS[("two_links", "arm_6")[index % 2]]
    return draw_case(kind, ["payload"], seed, index, [{"payload": payload}])


def lifted(size: float, rng: np.random.Generator, folder: Path) -> tuple[Path, RobotRecording]:
    """A carriage of 0.5 kg on a lift of 2 kg, which bears `size` times its mass: Newton's law."""
    path = folder / "lift.xml"
    parts = []
    path.write_text(_LIFT, encoding="utf-8")
    time_s = np.arange(0.0, 4.0, 0.01)
    mass_kg = 0.5 * (1.0 + size)
    for trial in range(5):
        w = 2.0 * np.pi * rng.uniform(0.3, 0.9, 2)
        place_m = 0.1 * np.sin(w * time_s[:, None] + rng.uniform(0.0, 6.0, 2))
        moved_kg = np.array([2.0 + mass_kg, mass_kg])
        force_n = moved_kg * ([9.81, 0.0] - w**2 * place_m)
        read_n = force_n + 0.02 * rng.standard_normal(force_n.shape)
        parts.append((time_s, np.full(len(time_s), trial), place_m, read_n))
    at_s, trials, position, force = (np.concatenate(each) for each in zip(*parts, strict=True))
    return path, RobotRecording("lift", at_s, trials, position, force, np.empty((len(at_s), 0)))


def servo_file(kind: RobotKind, folder: Path) -> Path:
    """The robot's model with position servos in place of its motors, written to a folder."""
    text = kind.path.read_text(encoding="utf-8")
    for stiffness, damping in zip(*kind.gains(), strict=True):
        text = text.replace("<motor ", f'<position kp="{stiffness:.6g}" kv="{damping:.6g}" ', 1)
    path = folder / kind.path.name
    path.write_text(re.sub(r' ctrlrange="[^"]*"', "", text), encoding="utf-8")
    return path
