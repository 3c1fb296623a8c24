"""Contacts anywhere on the arm, made by MuJoCo's contact engine, against the law's statements.

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
from dataclasses import asdict
from typing import Any, NamedTuple

import harness
import mujoco
import numpy as np
from rich.progress import track

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec
from cablesense_sim.replay import read_tensions_n
from cablesense_training.evaluation.law import (
    KnownArm,
    Statements,
    TrueContacts,
    by_segment,
    exact_calibration,
    is_stated,
    stated_contacts,
)
from cablesense_training.evaluation.metrics import plain_values
from cablesense_training.law.build import TorchLaw

SURFACE_M = 0.055
"""Radius of the touched surface: just outside the cables, which run 0.05 m from the axis."""
OBSTACLE_M = 0.01
SERVO_N_M = 2e3
SERVO_KG = 0.2
HALF_EDGE_M = 0.04
GAP_M = 0.002
STEPS = 6000
AT_REST_RAD_S = 1e-6
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
        self._kind = kind
        friction = kind.friction
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
                name=f"surface_{n}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                mass=0.0,
                fromto=[0.0, 0.0, 0.0, float(length), 0.0, 0.0],
                size=[SURFACE_M, 0.0, 0.0],
                contype=2,
                conaffinity=1,
                **rubbing,
            )
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
                type=shape,
                size=[OBSTACLE_M, HALF_EDGE_M * kind.edge, 0.0],
                mass=SERVO_KG,
                quat=[0.5**0.5, 0.5**0.5, 0.0, 0.0],
                contype=1,
                conaffinity=2,
                **rubbing,
            )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._joints = [self.model.joint(name).qposadr[0] for name in arm.joint_names]

    def touch(
        self, command_rad: Array, presses: Sequence[Press], slide_m: float
    ) -> tuple[list[EngineContact], Array] | None:
        """Press the obstacles against the arm; its contacts, and by how much tensions change (M,).

        None if they do not make one contact each, or the arm does not come to rest.
        """
        data = self.data
        mechanism = self.mechanism
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
        touches = sorted(self._contact(k, commanded) for k in range(data.ncon))
        if len({touch.segment for touch in touches}) < len(presses):
            return None
        return touches, self._tensions_n() - before_n

    def _contact(self, k: int, commanded: Array) -> EngineContact:
        data = self.data
        model = self.model
        contact = data.contact[k]
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, k, wrench)
        names = [model.geom(int(g)).name for g in contact.geom]
        surface = next(name for name in names if name.startswith("surface"))
        segment = int(surface.split("_")[1])
        # the contact frame's first axis points from the first geom to the second
        force = contact.frame.reshape(3, 3).T @ wrench[:3]
        if names[0] == surface:
            force = -force
        body = data.body(f"segment_{segment}")
        arm_m = contact.pos - body.xpos
        axes = commanded[segment - 1]
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
    largest_n = ARMS[arm.name]
    reach = reach_m(touched.mechanism)
    commands = []
    contacts = []
    changes = []
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
        outcome = touched.touch(command, presses, rng.choice([-1.0, 1.0]) * kind.slide_m)
        if outcome and all(np.linalg.norm(touch.force_n) >= LEAST_N for touch in outcome[0]):
            commands.append(command)
            contacts.append(outcome[0])
            changes.append(outcome[1])
    return Drawn(np.array(commands), contacts, np.array(changes))


def reach_m(mechanism: Mechanism) -> Array:
    """(N, 2) places that are pressed: from the guide plate after a joint to the next joint."""
    length_m = mechanism.segment_length_m
    return np.stack([np.full(len(length_m), mechanism.plate_offset_m), length_m], axis=1)


def with_surface(arm: Arm) -> Arm:
    """The arm, whose file states its surface."""
    touch = arm.touch.model_copy(update={"radius_m": SURFACE_M, "friction": FRICTION})
    return arm.model_copy(update={"touch": touch})


def answered(arm: Arm, samples: Drawn, rng: np.random.Generator) -> Statements:
    """What is stated of the tensions as the arm's sensors read them."""
    before_n = solve_equilibrium(mechanism_of(arm), samples.command_rad).tensions_n
    readings = np.stack(
        [
            read_tensions_n(tensions_n, arm.sensors, rng)
            for tensions_n in (before_n, before_n + samples.change_n)
        ]
    )
    known = KnownArm(TorchLaw(arm), arm, exact_calibration(arm))
    return known.stated(readings, samples.command_rad)


def figures_of_one(arm: Arm, samples: Drawn, answers: Statements) -> dict[str, Any]:
    """Answers, errors and coverage, of all and by segment."""
    contacts = [touches[0] for touches in samples.contacts]
    segment, place_m, force_n, turned = (np.array(part) for part in zip(*contacts, strict=True))
    lateral_n = np.linalg.norm(force_n[:, 1:], axis=1)
    truth = TrueContacts(segment, place_m, np.linalg.norm(turned, axis=1) / lateral_n, force_n)
    rows = {"all": stated_contacts(arm, truth, answers)}
    for n, row in enumerate(by_segment(arm, truth, answers), start=1):
        rows[f"segment_{n}"] = row
    return dict(plain_values({name: asdict(row) for name, row in rows.items()}))


def figures_of_two(answers: Statements) -> dict[str, Any]:
    """How many are stated as one contact."""
    return {
        "samples": len(answers.state),
        "stated_as_one": round(float(is_stated(answers).mean()), 3),
    }


def main() -> None:
    """Draws, estimates, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "touch.json")
    options.add_argument("--samples", type=int, default=400, help="of each kind and arm")
    options.add_argument("--seed", type=int, default=7001, help="of places, forces and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    for row, name in enumerate(ARMS):
        arm = with_surface(open_arm(name))
        for column, (title, kind) in enumerate(KINDS.items()):
            rng = np.random.default_rng([given.seed, row, column])
            samples = drawn(arm, kind, given.samples, rng, f"{name}, {title}")
            answers = answered(arm, samples, rng)
            if kind.obstacles == 1:
                figures = figures_of_one(arm, samples, answers)
            else:
                figures = figures_of_two(answers)
            result.setdefault(name, {})[title] = figures
    harness.publish("touch.json", result, given, "mujoco", "numpy", "torch")


if __name__ == "__main__":
    main()
