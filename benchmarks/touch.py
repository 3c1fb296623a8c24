"""Contacts anywhere on the arm, made by MuJoCo's contact engine, against the posterior by statics.

    python benchmarks/touch.py [--samples 400] [--seed 7001] [--write]

The judge shares no statics with the estimate. Capsules around the segments' axes are touched by
spheres and edges, which position servos press against the arm at random places, directions and
depths, with friction. MuJoCo steps the arm, its cables and actuators to rest. The tensions are
those of its tendons before and during the contact, with the sensors' noise and step; the true
point and force are those of `mj_contactForce`. The true point is on the surface: its foot on the
axis, and the lateral force, are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import harness
import mujoco
import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import (
    ContactPair,
    Location,
    Surface,
    TorqueBalance,
    locate,
    locate_two,
    reach_m,
    torque_balance,
)
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.model import build_spec
from cablesense_sim.replay import difference_variance_n2, read_tensions_n

SURFACE_M = 0.055
"""Radius of the touched surface: just outside the cables, which run 0.05 m from the axis."""
OBSTACLE_M = 0.01
SERVO_N_M, SERVO_KG = 2e3, 0.2
HALF_EDGE_M, GAP_M = 0.04, 0.002
TARE_SAMPLES = 50
STEPS, AT_REST_RAD_S = 6000, 1e-6
NOSLIP_ITERATIONS = 20
EDGE_M = 0.012
"""Contacts stay this far from the ends of a segment's reach: past them two surfaces overlap."""
LEAST_N = 2.0
FRICTION = 0.3
"""The estimate assumes this coefficient for every surface, also for those without friction."""
ARMS = {"cdsm": 100.0, "cdsm_lab": 40.0}
"""The strongest push, N, which these arms bear in every pose within 10 degrees."""


class Kind(NamedTuple):
    """Edges or spheres, their friction, how far they are slid along the arm, and how many."""

    edge: bool = False
    friction: float = 0.0
    slide_m: float = 0.0
    obstacles: int = 1


KINDS = {
    "sphere": Kind(),
    "edge": Kind(edge=True),
    "sphere, slid along the arm": Kind(friction=0.3, slide_m=0.02),
    "two spheres": Kind(obstacles=2),
}


class Press(NamedTuple):
    """Where an obstacle is pressed: segment from 1 on, place on it, side, depth of its target."""

    segment: int
    place_m: float
    angle_rad: float
    depth_m: float


class EngineContact(NamedTuple):
    """A contact at rest, as MuJoCo has it.

    Attributes:
        segment: from 1 on.
        place_m: foot of the contact point on the segment's axis, from its joint centre.
        force_n: (3,) on the arm, along the axes of the segment at the command.
        moment_n_m: (2,) of it about the joint centre, around the y and z axes there.
    """

    segment: int
    place_m: float
    force_n: Array
    moment_n_m: Array


class TouchedArm:
    """An arm with capsules around its segments, and obstacles on servos next to it."""

    def __init__(self, arm: Arm, kind: Kind) -> None:
        """An edge is a thin capsule across the segment, otherwise an obstacle is a sphere."""
        self._kind, friction = kind, kind.friction
        self.mechanism = mechanism_of(arm)
        spec = build_spec(self.mechanism)
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # without the solver of dry friction, MuJoCo's friction creeps to zero at rest
        spec.option.noslip_iterations = NOSLIP_ITERATIONS if friction else 0
        rubbing: dict[str, Any] = {
            "friction": [friction, 0.0, 0.0],
            "condim": 3 if friction else 1,
            # the default contact gives way by millimetres: the touched radius would not be known
            "solref": [0.004, 1.0],
            "solimp": [0.99, 0.999, 1e-4, 0.5, 2.0],
        }
        for n, length in enumerate(self.mechanism.segment_length_m, start=1):
            spec.body(f"segment_{n}").add_geom(
                name=f"surface_{n}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, mass=0.0,
                fromto=[0.0, 0.0, 0.0, float(length), 0.0, 0.0], size=[SURFACE_M, 0.0, 0.0],
                contype=2, conaffinity=1, **rubbing,
            )  # fmt: skip
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE if kind.edge else mujoco.mjtGeom.mjGEOM_SPHERE
        for k in range(kind.obstacles):
            holder = spec.worldbody.add_body(name=f"holder_{k}", mocap=True)
            body = holder.add_body(name=f"obstacle_{k}")
            body.gravcomp = 1.0
            for name, axis in (("press", [0.0, 0.0, -1.0]), ("slide", [1.0, 0.0, 0.0])):
                joint = body.add_joint(
                    name=f"{name}_{k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis
                )
                servo = spec.add_actuator(
                    name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
                )
                servo.set_to_position(kp=SERVO_N_M, kv=2.0 * np.sqrt(SERVO_N_M * SERVO_KG))
            body.add_geom(
                type=shape, size=[OBSTACLE_M, HALF_EDGE_M * kind.edge, 0.0], mass=SERVO_KG,
                quat=[0.5**0.5, 0.5**0.5, 0.0, 0.0], contype=1, conaffinity=2, **rubbing,
            )  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._joints = [self.model.joint(name).qposadr[0] for name in arm.joint_names]

    def touch(
        self, command_rad: Array, presses: Sequence[Press], slide_m: float
    ) -> tuple[list[EngineContact], Array] | None:
        """Press the obstacles against the arm; its contacts, and by how much tensions change (M,).

        None if they do not make one contact each, or the arm does not come to rest.
        """
        data, mechanism = self.data, self.mechanism
        mujoco.mj_resetData(self.model, data)
        data.qpos[self._joints] = command_rad
        straight = kinematics.cable_lengths_m(mechanism, np.zeros(mechanism.joint_count))
        drawn = straight - kinematics.cable_lengths_m(mechanism, command_rad)
        cables = slice(mechanism.cable_count)  # their actuators come before those of obstacles
        if np.isfinite(mechanism.actuator_stiffness_n_m):
            data.ctrl[cables] = drawn
        else:
            data.mocap_pos[cables, 0] = -mechanism.run_m - drawn
        count = self._kind.obstacles
        holders = [self.model.body(f"holder_{k}").mocapid[0] for k in range(count)]
        data.mocap_pos[holders] = np.arange(1, count + 1)[:, None] * [0.0, 0.0, 10.0]
        self._settle()
        before_n = self._tensions_n()
        for k, press in enumerate(presses):
            body = data.body(f"segment_{press.segment}")
            axes = body.xmat.reshape(3, 3)
            outward = axes @ [0.0, np.sin(press.angle_rad), np.cos(press.angle_rad)]
            away = SURFACE_M + OBSTACLE_M + GAP_M
            place = body.xpos + press.place_m * axes[:, 0] + away * outward
            data.mocap_pos[holders[k]] = place
            frame = np.stack([axes[:, 0], np.cross(outward, axes[:, 0]), outward], axis=1)
            mujoco.mju_mat2Quat(data.mocap_quat[holders[k]], frame.ravel())
            data.ctrl[self.model.actuator(f"press_{k}").id] = press.depth_m + GAP_M
        self._settle()
        if slide_m:
            for k in range(len(presses)):
                data.ctrl[self.model.actuator(f"slide_{k}").id] = slide_m
            self._settle()
        if data.ncon != len(presses) or np.abs(data.qvel).max() > AT_REST_RAD_S:
            return None
        commanded = kinematics.segment_rotations(mechanism, command_rad)
        found = sorted(self._contact(k, commanded) for k in range(data.ncon))
        if len({touch.segment for touch in found}) < len(presses):
            return None
        return found, self._tensions_n() - before_n

    def _contact(self, k: int, commanded: Array) -> EngineContact:
        data, model = self.data, self.model
        contact, wrench = data.contact[k], np.zeros(6)
        mujoco.mj_contactForce(model, data, k, wrench)
        names = [model.geom(int(g)).name for g in contact.geom]
        surface = next(name for name in names if name.startswith("surface"))
        segment = int(surface.split("_")[1])
        # the contact frame's first axis points from the first geom to the second
        force = contact.frame.reshape(3, 3).T @ wrench[:3]
        if names[0] == surface:
            force = -force
        body = data.body(f"segment_{segment}")
        arm_m, axes = contact.pos - body.xpos, commanded[segment - 1]
        place_m = float(arm_m @ body.xmat.reshape(3, 3)[:, 0])
        return EngineContact(
            segment, place_m, axes.T @ force, (axes.T @ np.cross(arm_m, force))[1:]
        )

    def _tensions_n(self) -> Array:
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves lengths as at its start
        mujoco.mj_tendon(self.model, self.data)
        stretch_m = self.data.ten_length - self.model.tendon_lengthspring[:, 1]
        return np.asarray(self.mechanism.cable_stiffness_n_m * np.maximum(stretch_m, 0.0))

    def _settle(self) -> None:
        for _ in range(STEPS):
            mujoco.mj_step(self.model, self.data)
            if np.abs(self.data.qvel).max() < 0.1 * AT_REST_RAD_S:
                break


class Drawn(NamedTuple):
    """B samples: commands (B, 2N), K contacts each, and changes of the tensions (B, M)."""

    command_rad: Array
    contacts: list[list[EngineContact]]
    change_n: Array


def drawn(arm: Arm, kind: Kind, count: int, rng: np.random.Generator, title: str) -> Drawn:
    """Samples of one kind; those without the right contacts are left out."""
    touched = TouchedArm(arm, kind)
    largest_n, reach = ARMS[arm.name], reach_m(touched.mechanism)
    commands, contacts, changes = [], [], []
    edge_m = EDGE_M + kind.slide_m
    for _ in track(range(count), title):
        command = np.deg2rad(rng.uniform(-10.0, 10.0, arm.joint_count))
        first = 1 if kind.obstacles > 1 else 0  # of two, none on segment 1: place not determined
        segments = rng.permutation(np.arange(first, arm.segment_count))[: kind.obstacles]
        presses = [
            Press(
                int(n) + 1,
                rng.uniform(reach[n, 0] + edge_m, reach[n, 1] - edge_m),
                rng.uniform(0.0, 2.0 * np.pi),
                rng.uniform(LEAST_N, largest_n / kind.obstacles) / SERVO_N_M,
            )
            for n in segments
        ]
        found = touched.touch(command, presses, rng.choice([-1.0, 1.0]) * kind.slide_m)
        if found and all(np.linalg.norm(touch.force_n) >= LEAST_N for touch in found[0]):
            commands.append(command)
            contacts.append(found[0])
            changes.append(found[1])
    return Drawn(np.array(commands), contacts, np.array(changes))


def balanced(arm: Arm, samples: Drawn, rng: np.random.Generator) -> TorqueBalance:
    """The balance of the tensions as the arm's sensors read them, less an averaged tare."""
    mechanism, sensors = mechanism_of(arm), arm.sensors
    before_n = solve_equilibrium(mechanism, samples.command_rad).tensions_n
    tare_n = np.mean([read_tensions_n(before_n, sensors, rng) for _ in range(TARE_SAMPLES)], 0)
    difference_n = read_tensions_n(before_n + samples.change_n, sensors, rng) - tare_n
    variance_n2 = difference_variance_n2(sensors, TARE_SAMPLES)
    return torque_balance(mechanism, samples.command_rad, difference_n, variance_n2)


def figures_of_one(samples: Drawn, found: Location) -> dict[str, Any]:
    """Errors and coverage: beyond the first segment of place and force, on it of the moment."""
    contacts = [touches[0] for touches in samples.contacts]
    truth, place_m, force_n, turned = (np.array(part) for part in zip(*contacts, strict=True))
    lateral_n = np.linalg.norm(force_n[:, 1:], axis=1)
    right = found.segment == truth
    far, first = right & (truth > 1), right & (truth == 1)
    lateral_off = np.linalg.norm((found.force_n - force_n)[:, 1:], axis=1) / lateral_n
    off_moment = np.linalg.norm(found.moment_n_m - turned, axis=1) / np.linalg.norm(turned, axis=1)
    place_held = _holds(found.place_ci95_m, place_m)
    force_held = _holds(found.magnitude_ci95_n, lateral_n)
    return {
        "contacts": len(contacts),
        "segment_right": round(float(right.mean()), 4),
        "place_mm": _of(1e3 * np.abs(found.place_m - place_m)[far]),
        "lateral_force_share": _of(lateral_off[far]),
        "place_coverage95": _share(place_held[far]),
        "magnitude_coverage95": _share(force_held[far]),
        "segment_1_moment_share": _of(off_moment[first]),
        "segment_1_place_coverage95": _share(place_held[first]),
        "segment_1_magnitude_coverage95": _share(force_held[first]),
    }


def figures_of_two(samples: Drawn, found: ContactPair, single: Location) -> dict[str, Any]:
    """Errors where the segments are right, and whether the evidence is for two contacts."""
    truth, place_m, force_n = (
        np.array([[touch[k] for touch in both] for both in samples.contacts]) for k in range(3)
    )
    both = (found.segments == truth).all(axis=1)
    interval_m = found.place_m[..., None] + 1.96 * found.place_std_m[..., None] * [-1.0, 1.0]
    off_n = np.linalg.norm((found.force_n - force_n)[..., 1:], axis=-1)
    return {
        "samples": len(truth),
        "two_by_evidence": _share(found.log_evidence > single.log_evidence),
        "segments_right": _share(both),
        "place_coverage95": _share(_holds(interval_m, place_m)[both]),
        "place_std_mm": _of(1e3 * found.place_std_m[both]),
        "place_mm": _of(1e3 * np.abs(found.place_m - place_m)[both]),
        "lateral_force_n": _of(off_n[both]),
    }


def _holds(interval: Array, value: Array) -> NDArray[np.bool_]:
    return np.asarray((value >= interval[..., 0]) & (value <= interval[..., 1]))


def _share(rows: NDArray[np.bool_]) -> float:
    return round(float(rows.mean()), 3)


def _of(values: Array) -> dict[str, float]:
    return harness.percentiles(values, ["median", "95 %", "worst"], 4)


def main() -> None:
    """Draws, estimates, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "touch.json")
    options.add_argument("--samples", type=int, default=400, help="of each kind and arm")
    options.add_argument("--seed", type=int, default=7001, help="of places, forces and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    surface = Surface(SURFACE_M, FRICTION)
    for row, name in enumerate(ARMS):
        arm = open_arm(name)
        reach = reach_m(mechanism_of(arm))
        for column, (title, kind) in enumerate(KINDS.items()):
            rng = np.random.default_rng([given.seed, row, column])
            samples = drawn(arm, kind, given.samples, rng, f"{name}, {title}")
            balance = balanced(arm, samples, rng)
            single = locate(balance, reach, surface)
            if kind.obstacles == 1:
                figures = figures_of_one(samples, single)
            else:
                pairs = locate_two(balance, reach, surface=surface)
                figures = figures_of_two(samples, pairs, single)
            result.setdefault(name, {})[title] = figures
    harness.publish("touch.json", result, given, "mujoco", "numpy")


if __name__ == "__main__":
    main()
