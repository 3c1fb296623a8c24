"""Contacts on the example machines, made by MuJoCo's contact engine, against the law's statements.

    python benchmarks/machine_touch.py [--samples 200] [--seed 8201] [--write]

The judge shares no statics with the estimate. Capsules around the links' axes are touched by
spheres and edges, which position servos press against them at random places, directions and
depths, with and without friction. MuJoCo steps the machine, with the tendons and servos of its
model, to rest. A machine with torque sensors is held in its pose, and inverse dynamics say what
its drives give. Readings are those during the contact, with the sensors' noise and step; the law
takes the machine as its file describes it. The true point and force are those of
`mj_contactForce`: its foot on the axis, and the lateral force, are compared.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import harness
import mujoco
import numpy as np
from rich.progress import track

from cablesense_base import Array
from cablesense_contact.machine.felt_directions import felt_across
from cablesense_contact.machine.law import MachineLaw
from cablesense_contact.machine.model_file import open_machine_law
from cablesense_contact.machine.observation import Observer
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine, open_machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import AtRest, SimulatedMachine
from cablesense_sim.mujoco_file import compiled, read_spec
from cablesense_training.machine_export import export_machine

FOLDER = Path(__file__).parents[1] / "config" / "machines"
MACHINES = ("finger", "hand", "seven_hinges", "six_axis")
"""A continuum robot is not among them: pressed, it gives way by centimetres, and swings long."""
LINKS = {
    "finger": ("distal", "fingertip"),
    "hand": ("index_middle", "index_distal", "ring_middle", "ring_distal", "thumb_middle"),
    "seven_hinges": ("link_4", "link_5", "link_6", "link_7"),
    "six_axis": ("wrist", "tool"),
}
"""Links beyond enough joints that readings tell place and force there."""
REACH_DEG = 5.0
PUSHED = (0.2, 0.8)
"""Forces that servos aim at, as shares of the largest that a file expects."""
DAMPING_SHARE = 0.3
STEPS = 20_000
AT_REST = 1e-5
"""Largest force of inertia and dampers over that of the contact. Rough obstacles slide for seconds
before they stop, or creep, as the engine's friction is a damper with a limit."""
_TINY = 1e-12
LEAST_SHARE = 0.05
"""Of the largest force: a contact is no weaker."""
COVERAGE = 0.92
PLACE_MM = 3.0
FORCE_SHARE = 0.03


class Kind(NamedTuple):
    """Edges or spheres, and their friction."""

    edge: bool
    friction: float


KINDS = {"sphere": Kind(False, 0.0), "edge": Kind(True, 0.0), "rough sphere": Kind(False, 0.3)}


class EngineContact(NamedTuple):
    """A contact at rest, as MuJoCo has it.

    Attributes:
        link: its number.
        place_m: foot of the point on the link's axis.
        lateral_n: force across the link.
        values: (M,) what channels read without noise.
    """

    link: int
    place_m: float
    lateral_n: float
    values: Array


class TouchedMachine:
    """A machine with capsules around its links, and an obstacle on a servo next to it."""

    def __init__(self, machine: Machine, kind: Kind) -> None:
        """An edge is a thin capsule across the link, otherwise an obstacle is a sphere."""
        self._machine = machine
        self._kind = kind
        links = machine.links
        self._felt_across = felt_across(Observer(machine))
        self._largest_n = machine.source.file.touch.largest_n
        self._size_m = 0.3 * float(np.median(links.radius_m))
        # pressed by the largest force, a servo gives way by half the obstacle's size
        self._servo_n_m = 2.0 * self._largest_n / self._size_m
        spec = read_spec(machine.source.model_path, MachineError)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.noslip_iterations = 20 if kind.friction else 0
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        spec.option.timestep = 5e-4
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        # the default contact gives way by millimetres: the touched radius would not be known
        rubbing: dict[str, Any] = {
            "friction": [kind.friction, 0.0, 0.0],
            "condim": 3 if kind.friction else 1,
            "solref": [0.004, 1.0],
            "solimp": [0.99, 0.999, 1e-4, 0.5, 2.0],
        }
        for body in spec.bodies:
            for geom in body.geoms:
                geom.contype = 0
                geom.conaffinity = 0
        for name, (start, end), axes, origin, radius in zip(
            links.names, links.touched_m, links.axes, links.origin_m, links.radius_m, strict=True
        ):
            ends = origin + np.outer([start, end], axes[:, 0])
            spec.body(name).add_geom(
                name=f"surface of {name}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                mass=0.0,
                fromto=ends.ravel(),
                size=[radius, 0.0, 0.0],
                contype=2,
                conaffinity=4,
                **rubbing,
            )
        holder = spec.worldbody.add_body(name="obstacle's holder", mocap=True)
        obstacle = holder.add_body(name="obstacle")
        obstacle.gravcomp = 1.0
        joint = obstacle.add_joint(
            name="press", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, -1.0]
        )
        mass_kg = 1e-4 * self._servo_n_m
        servo = spec.add_actuator(
            name="press", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_position(
            kp=self._servo_n_m, kv=2.0 * float(np.sqrt(self._servo_n_m * mass_kg))
        )
        # nor is it limited as the model's own are by default
        servo.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE if kind.edge else mujoco.mjtGeom.mjGEOM_SPHERE
        obstacle.add_geom(
            type=shape,
            size=[self._size_m, 4.0 * self._size_m * kind.edge, 0.0],
            mass=mass_kg,
            # an edge lies across the link
            quat=[0.5**0.5, 0.5**0.5, 0.0, 0.0],
            contype=4,
            conaffinity=2,
            **rubbing,
        )
        self.model = compiled(spec, machine.source.model_path, MachineError)
        self.data = mujoco.MjData(self.model)
        self._inertial = np.zeros(self.model.nv)
        parameters = MachineParameters(machine)
        self._described = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
        self._damp()

    def touch(
        self, command: Array, link: int, place_m: float, angle_rad: float, force_n: float
    ) -> EngineContact | None:
        """Press the obstacle against the machine; None if that makes no contact on this link."""
        machine = self._machine
        links = machine.links
        data = self.data
        untouched = self._described.untouched(command)
        self._take_pose(command, untouched)
        body = int(links.bodies[link])
        axes = data.xmat[body].reshape(3, 3) @ links.axes[link]
        origin = data.xpos[body] + data.xmat[body].reshape(3, 3) @ links.origin_m[link]
        outward = axes @ [0.0, np.sin(angle_rad), np.cos(angle_rad)]
        gap_m = 0.1 * self._size_m
        away_m = links.radius_m[link] + self._size_m + gap_m
        holder = self.model.body("obstacle's holder").mocapid[0]
        data.mocap_pos[holder] = origin + place_m * axes[:, 0] + away_m * outward
        frame = np.stack([axes[:, 0], np.cross(outward, axes[:, 0]), outward], axis=1)
        mujoco.mju_mat2Quat(data.mocap_quat[holder], frame.ravel())
        data.ctrl[self.model.actuator("press").id] = gap_m + force_n / self._servo_n_m
        if not self._settled(untouched):
            return None
        return self._contact(link, axes)

    def _take_pose(self, command: Array, untouched: AtRest) -> None:
        machine = self._machine
        data = self.data
        mujoco.mj_resetData(self.model, data)
        machine_joint_count = self.model.nq - 1
        data.qpos[:machine_joint_count] = machine.coordinates.positions(untouched.pose)
        if not machine.is_measured:
            tendons = machine.tendons
            unstretched_m = self._described.unstretched_m(command)
            data.ctrl[tendons.drawn_by] = tendons.gear * unstretched_m
        mujoco.mj_forward(self.model, data)

    def _settled(self, untouched: AtRest) -> bool:
        data = self.data
        held = self._machine.coordinates.positions(untouched.pose)
        restless = np.inf
        for _ in range(STEPS):
            if self._machine.is_measured:
                data.qpos[:-1] = held
                data.qvel[:-1] = 0.0
            mujoco.mj_step(self.model, data)
            restless = self._restlessness()
            if restless < AT_REST:
                break
        if self._machine.is_measured:
            data.qpos[:-1] = held
            data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, data)
        return data.ncon == 1 and restless < AT_REST

    def _restlessness(self) -> float:
        """Force of inertia and dampers over that of the contact: of joints, or of the obstacle."""
        data = self.data
        mujoco.mj_mulM(self.model, data, self._inertial, data.qacc)
        damping = self.model.dof_damping * data.qvel
        pressing = self.model.actuator("press").id
        damping[-1] -= self.model.actuator_biasprm[pressing, 2] * data.qvel[-1]
        moving = np.abs(self._inertial) + np.abs(damping)
        touching = np.maximum(np.abs(data.qfrc_constraint), _TINY)
        of_obstacle = float(moving[-1] / touching[-1])
        if self._machine.is_measured:
            return of_obstacle
        return max(of_obstacle, float(moving[:-1].max() / touching[:-1].max()))

    def _contact(self, link: int, axes: Array) -> EngineContact | None:
        """Along the axes that the link had at the command, as it was placed then."""
        data = self.data
        model = self.model
        machine = self._machine
        contact = data.contact[0]
        names = [model.geom(int(g)).name for g in contact.geom]
        surface = f"surface of {machine.links.names[link]}"
        if surface not in names:
            return None
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, 0, wrench)
        # the contact frame's first axis points from the first geom to the second
        force = contact.frame.reshape(3, 3).T @ wrench[:3]
        if names[0] == surface:
            force = -force
        body = int(machine.links.bodies[link])
        turn = data.xmat[body].reshape(3, 3)
        origin = data.xpos[body] + turn @ machine.links.origin_m[link]
        along = turn @ machine.links.axes[link][:, 0]
        channels = machine.channels
        if machine.is_measured:
            at_point = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, at_point, None, contact.pos, body)
            torques = data.qfrc_bias - data.qfrc_passive - force @ at_point
            values = torques[machine.coordinates.joints[channels.coordinate]]
        else:
            drawn = machine.tendons.drawn_by[channels.tendon]
            values = -data.actuator_force[drawn] * machine.tendons.gear[channels.tendon]
        lateral = self._felt_across[link] @ axes[:, 1:].T @ force
        return EngineContact(
            link, float((contact.pos - origin) @ along), float(np.hypot(*lateral)), values
        )

    def _damp(self) -> None:
        """Rest does not depend on damping, but comes sooner with some."""
        machine = self._machine
        if machine.is_measured:
            return
        tendons = machine.tendons
        moment = self._described.built.statics.at(machine.reference).moment
        stiffness = (moment.T**2) @ tendons.stiffness_n_m
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        joints = machine.coordinates.joints
        inertia = np.diag(full)[joints]
        self.model.dof_damping[joints] += 2.0 * DAMPING_SHARE * np.sqrt(stiffness * inertia)


class Bench:
    """One machine with its law, known as its file describes it after a tare."""

    def __init__(self, name: str) -> None:
        self.machine = open_machine(FOLDER / f"{name}.yaml")
        self.law = _exported_law(self.machine)
        self.parameters = self.law.observer.parameters
        count = len(self.machine.coordinates)
        self.unrest = np.zeros((count, count))
        self.holding = Holding(self.machine)

    def command(self, rng: np.random.Generator) -> Array:
        """One that holds the machine near a pose within reach of the reference."""
        coordinates = self.machine.coordinates
        away = np.deg2rad(rng.uniform(-REACH_DEG, REACH_DEG, len(coordinates)))
        return self.holding.command_of(self.machine.reference + away * coordinates.is_hinge)

    def figures(self, kind: Kind, samples: int, rng: np.random.Generator, title: str) -> Any:
        """Of contacts of one kind."""
        machine = self.machine
        touched = TouchedMachine(machine, kind)
        largest_n = machine.source.file.touch.largest_n
        numbers = [machine.links.names.index(name) for name in LINKS[machine.name]]
        exact = np.zeros(len(self.parameters))
        covariance = np.zeros((len(exact), len(exact)))
        span_m = machine.links.touched_m[:, 1] - machine.links.touched_m[:, 0]
        before_m = np.cumsum(span_m) - machine.links.touched_m[:, 1]
        rows = []
        for _ in track(range(samples), title):
            command = self.command(rng)
            link = int(rng.choice(numbers))
            low_m, high_m = machine.links.touched_m[link]
            place_m = rng.uniform(low_m, high_m)
            angle_rad = rng.uniform(0.0, 2.0 * np.pi)
            force_n = largest_n * rng.uniform(*PUSHED)
            try:
                contact = touched.touch(command, link, place_m, angle_rad, force_n)
            except MachineError:
                continue
            if contact is None or contact.lateral_n < LEAST_SHARE * largest_n:
                continue
            if not low_m <= contact.place_m <= high_m:
                continue
            reading = machine.channels.read(contact.values, rng)
            seen = self.law(reading[None], command[None], exact, covariance, self.unrest)
            likeliest = int(seen.contact_evidence[0].argmax())
            along_m = before_m[link] + contact.place_m
            lateral_n = float(np.hypot(*seen.force_n[0, 1:]))
            low_n, high_n = seen.magnitude_ci95_n[0]
            start_m, end_m = seen.region_m[0]
            off_m = abs(before_m[likeliest] + float(seen.place_m[0]) - along_m)
            rows.append(
                (
                    likeliest == link,
                    1e3 * off_m,
                    abs(lateral_n - contact.lateral_n) / contact.lateral_n,
                    start_m - 1e-4 <= along_m <= end_m + 1e-4,
                    low_n <= contact.lateral_n <= high_n,
                )
            )
        if not rows:
            return {"contacts": 0}
        right, off_mm, off_share, in_region, in_force = np.array(rows, dtype=float).T
        return {
            "contacts": len(rows),
            "of": samples,
            "link right": round(float(right.mean()), 3),
            "place, mm": harness.percentiles(off_mm, ("median", "95 %")),
            "force, share": harness.percentiles(off_share, ("median", "95 %"), 4),
            "region holds": round(float(in_region.mean()), 3),
            "force interval holds": round(float(in_force.mean()), 3),
        }


def _exported_law(machine: Machine) -> MachineLaw:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{machine.name}.onnx"
        export_machine(machine, path, "benchmarks/machine_touch.py")
        return open_machine_law(path, machine)


def bars_of(where: str, figures: dict[str, Any]) -> dict[str, bool]:
    """Which bars are kept."""
    place_mm = figures["place, mm"]["median"]
    share = figures["force, share"]["median"]
    bars = {
        f"{where}: median place {place_mm:.3g} mm, at most {PLACE_MM:g}": place_mm <= PLACE_MM,
        f"{where}: median force {share:.3g}, at most {FORCE_SHARE:g}": share <= FORCE_SHARE,
    }
    for what in ("region holds", "force interval holds"):
        bars[f"{where}: {what} {figures[what]:g}, at least {COVERAGE:g}"] = (
            figures[what] >= COVERAGE
        )
    return bars


def main() -> None:
    """Draws, estimates, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "machine_touch.json")
    options.add_argument("--samples", type=int, default=200, help="of each kind and machine")
    options.add_argument("--machines", nargs="*", default=list(MACHINES), help="some of them")
    options.add_argument("--seed", type=int, default=8201, help="of places, forces and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    bars: dict[str, bool] = {}
    for name in given.machines:
        bench = Bench(name)
        for column, (title, kind) in enumerate(KINDS.items()):
            rng = np.random.default_rng([given.seed, MACHINES.index(name), column])
            figures = bench.figures(kind, given.samples, rng, f"{name}, {title}")
            result.setdefault(name, {})[title] = figures
            bars |= bars_of(f"{name}, {title}", figures)
    result["bars"] = bars
    harness.publish("machine_touch.json", result, given, "mujoco", "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
