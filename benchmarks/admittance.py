"""The admittance controller against walls, and on arms whose sensors or cables fail.

    python benchmarks/admittance.py [--write]

For every segment, four directions and walls of several stiffnesses the loop of law, wall and arm
at rest runs for `STEPS` steps (`run_loop`: no noise, nothing swings). Stable means that the force
of the last steps does not rise and fall by more than `CHATTER_N`. Then the nodes run over the
middleware, in simulated dynamics with the sensors' noise:
`python -m examples.admittance --json`.

    python benchmarks/admittance.py --faults [--workers 2] [--write]

Estimator and controller run in one process, at 50 Hz, with a simulated arm that steps from rest to
rest (no swing). Readings have the sensors' noise and step. Every fault comes to an arm that
nothing touches: after the tare, and 2 s later another node commands a bent pose. It also comes to
an arm that a weight of 40 N pulls, on segment 3, to the controller's limit (1.5 degrees). The
measure is the distance of the controller's commands from the pose that others commanded, or in
contact from the one before the fault.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import harness
import numpy as np
import pandas as pd
from estimated_arm import START_NS, EstimatedArm

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from examples.admittance.__main__ import play
from examples.admittance.controller import AdmittanceController
from examples.admittance.law import AdmittanceLaw, AdmittanceSettings, ContactForce
from examples.admittance.wall import ElasticWall, wall_beside

ARMS = ("cdsm", "cdsm_lab")
ANGLES_DEG = (0.0, 90.0, 180.0, 270.0)
STIFFNESSES_N_M = (2_000.0, 10_000.0, 20_000.0, 40_000.0, 100_000.0)
HELD_N = 30.0
STEPS = 40
PERIOD_S = 0.73
"""The node's cycle with the static estimator: move 0.1 s, settle 0.5 s, measure 0.1 s."""
SETTLED_WITHIN_N = 1.0
CHATTER_N = 0.5
LAST = 8
DEMO_S = 24.0
BALANCED_N = 1e-4
MOST_ITERATIONS = 60

BAR_DEG = 0.5
RATE_HZ = 50.0
FAULT_S = 3.0
MOVED_S = 5.0
END_S = 9.0
DRIFT_S = 14.0
TOUCHED = {"segment": 3, "angle_deg": 70.0, "magnitude_n": 40.0}
TOUCHED_S = 3.0
GIVEN_WAY_S = 12.0
TOUCHED_LIMIT_DEG = 1.5
"""The times of weight and fault, and the limit of the controller."""
LOOSE_N = -1e5
"""Pretension of a broken cable: it would have to stretch by centimetres to be taut."""

KINDS: dict[str, tuple[float, ...]] = {
    "zero": (0.0,),
    "broken cable": (0.0,),
    "scale": (0.5, 0.8, 0.9, 1.1, 2.0),
    "offset": (-20.0, -5.0, 2.0, 5.0, 20.0),
    "stuck": (0.0, 0.5, -0.5, 1.0, -1.0),
    "exchanged": (1, 2, 3, 5, 6),
    "drift": (0.03, 0.1, 0.3, 1.0, 5.0),
}
"""Sizes of every kind: a factor, newtons, newtons a second, or how many cables further on."""


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/admittance.json or admittance_faults.json")
    parser.add_argument("--faults", action="store_true", help="sensors and cables fail instead")
    parser.add_argument("--workers", type=int, default=2, help="processes, for faults")
    options = parser.parse_args()
    if options.faults:
        harness.publish("admittance_faults.json", _faults(options.workers), options)
    else:
        harness.publish("admittance.json", _walls(), options, "mujoco")


def _walls() -> dict[str, Any]:
    settings = AdmittanceSettings()
    cases = [
        _case(arm, settings, segment, angle, stiffness)
        for arm in ARMS
        for stiffness in STIFFNESSES_N_M
        for segment in range(1, open_arm(arm).segment_count + 1)
        for angle in ANGLES_DEG
    ]
    with tempfile.TemporaryDirectory() as folder:
        nodes = play(DEMO_S, Path(folder))
    return {
        "stable": f"{sum(case['stable'] for case in cases)} of {len(cases)}",
        "real_nodes": {k: round(v, 2) if isinstance(v, float) else v for k, v in nodes.items()},
        "cases": cases,
    }


def _case(
    arm: str, settings: AdmittanceSettings, segment: int, angle_deg: float, stiffness_n_m: float
) -> dict[str, Any]:
    mechanism = mechanism_of(open_arm(arm))
    home = np.zeros(mechanism.joint_count)
    law = AdmittanceLaw(mechanism, settings)
    wall = wall_beside(mechanism, home, segment, angle_deg, stiffness_n_m)
    advance = HELD_N * (1.0 / stiffness_n_m + wall.compliance_m_n)
    forces = run_loop(mechanism, law, wall, segment, home, advance, STEPS, PERIOD_S)
    final = float(forces[-1])
    unsettled = np.flatnonzero(np.abs(forces - final) > SETTLED_WITHIN_N)
    settled = int(unsettled[-1]) + 1 if len(unsettled) else 0
    return {
        "case": f"{arm}, segment {segment}, {angle_deg:g} degrees, {stiffness_n_m:g} N/m",
        "without_n": round(float(forces[0]), 2),
        "with_n": round(final, 2),
        "settling_s": round(settled * PERIOD_S, 2),
        "stable": bool(np.ptp(forces[-LAST:]) <= CHATTER_N or np.all(np.diff(forces) <= 1e-3)),
    }


def _faults(workers: int) -> dict[str, Any]:
    """Every kind of fault of every cable in all its sizes, untouched and in contact."""
    cases = []
    for arm, touched in product(ARMS, (False, True)):
        faults = [Fault("none", 0.0, 0)]
        for cable in range(open_arm(arm).cable_count):
            faults += [Fault(kind, size, cable) for kind in KINDS for size in KINDS[kind]]
        cases += [(arm, touched, fault, seed) for seed, fault in enumerate(faults)]
    with WorkerPool(workers) as pool:
        turns_deg = list(pool.map(turned_deg, *zip(*cases, strict=True)))
    table = pd.DataFrame(cases, columns=["arm", "in_contact", "fault", "seed"])
    table["kind"] = [fault.kind for fault in table.fault]
    table["deg"] = turns_deg
    by_kind = table.dropna().groupby(["arm", "in_contact", "kind"], sort=False).deg
    kinds = by_kind.agg(cases="count", moved=lambda deg: (deg > 0.0).sum(), worst_deg="max")
    return {
        "kinds": kinds.reset_index().to_dict("records"),
        "bars": {f"within {BAR_DEG:g} degrees": bool(table.deg.max() <= BAR_DEG)},
    }


def run_loop(
    mechanism: Mechanism,
    law: AdmittanceLaw,
    wall: ElasticWall,
    segment: int,
    home_rad: Array,
    advance_m: float,
    step_count: int,
    period_s: float,
) -> Array:
    """Wall, arm in static equilibrium, an exact estimate and the law: a step every `period_s`.

    Starts at home (2N,) against the wall at an advance. Gives the wall's forces (K+1,), N, before
    each of K steps and after the last.

    Raises:
        EquilibriumError: the arm cannot rest under the wall's force.
    """
    command = home_rad
    forces_n: list[float] = []
    while True:
        loads = np.zeros((mechanism.segment_count, 3))
        for _ in range(MOST_ITERATIONS):
            before_n = wall.force_n
            angles = solve_equilibrium(mechanism, command, loads).joint_angles_rad
            point = kinematics.contact_points_m(mechanism, angles)[segment - 1]
            loads[segment - 1] = wall.update(point, advance_m)
            if abs(wall.force_n - before_n) <= BALANCED_N:
                break
        forces_n.append(wall.force_n)
        if len(forces_n) > step_count:
            return np.array(forces_n)
        axis = kinematics.segment_rotations(mechanism, command)[segment - 1][:, 0]
        normal = loads[segment - 1] - axis * (axis @ loads[segment - 1])
        contact = ContactForce(segment, np.asarray(normal)) if normal.any() else None
        command = law.step(command, home_rad, contact, period_s)


@dataclass
class Fault:
    """A fault of one cable, from 0; `none` has none. A stuck sensor keeps its first reading."""

    kind: str
    size: float
    cable: int
    stuck_at_n: float | None = None

    def change(self, reading_n: Array, since_s: float) -> None:
        """Change readings (M,) in place, so long after the fault began, s."""
        cable = self.cable
        size = self.size
        match self.kind:
            case "zero":
                reading_n[cable] = 0.0
            case "scale":
                reading_n[cable] *= size
            case "offset":
                reading_n[cable] += size
            case "drift":
                reading_n[cable] += size * since_s
            case "stuck":
                if self.stuck_at_n is None:
                    self.stuck_at_n = reading_n[cable] + size
                reading_n[cable] = self.stuck_at_n
            case "exchanged":
                other = (cable + round(size)) % len(reading_n)
                reading_n[[cable, other]] = reading_n[[other, cable]]


class Run(EstimatedArm):
    """Arm, estimator and controller; every message is answered as the nodes do."""

    def __init__(self, arm_name: str, seed: int, **limits: Any) -> None:
        super().__init__(
            arm_name, np.random.default_rng(seed), joint_speed_rad_s=float(np.deg2rad(20.0))
        )
        self.controller = AdmittanceController(self.mechanism, AdmittanceSettings(**limits), 0.0)
        self.forces_n: Array | None = None
        self.commanded(np.zeros(self.arm.joint_count), 0.0)

    def commanded(self, command_rad: Array, now_s: float) -> None:
        """A command is on the topic; all receive it, and the arm goes there."""
        self.command(command_rad)
        self.controller.received_command(command_rad, now_s)
        self.command_rad = command_rad
        self.rest()

    def rest(self) -> None:
        """Find the arm's rest at its command, under its load.

        Raises:
            EquilibriumError: it collapses.
        """
        rest = solve_equilibrium(self.mechanism, self.command_rad, self.forces_n)
        self._tensions_n = rest.tensions_n

    def tick(self, now_s: float, fault: Fault | None, since_s: float) -> None:
        """One sample and what follows."""
        read_n = self.read(self._tensions_n)
        if fault is not None:
            fault.change(read_n, since_s)
        answer = self.sample(np.maximum(read_n, 0.0), now_s)
        contact = answer.contact
        controller = self.controller
        force_n = np.array(contact.wrench[:3])
        now_ns = START_NS + round(now_s * 1e9)
        response = controller.received(
            answer.force, contact.segment, force_n, now_ns, now_ns, now_s
        )
        for command in (response, controller.repeated(now_s)):
            if command is not None:
                self.commanded(command, now_s)


def turned_deg(arm_name: str, touched: bool, fault: Fault, seed: int) -> float:
    """Largest turn of a joint by the controller; NaN where the arm collapses."""
    try:
        return _turned_deg(arm_name, touched, fault, seed)
    except EquilibriumError:
        return float("nan")


def _turned_deg(arm_name: str, touched: bool, fault: Fault, seed: int) -> float:
    run = Run(arm_name, seed, **({"joint_limit_deg": TOUCHED_LIMIT_DEG} if touched else {}))
    pose = np.deg2rad(run.rng.uniform(-4.0, 4.0, run.arm.joint_count))
    turned_rad = 0.0
    fault_s = GIVEN_WAY_S if touched else FAULT_S
    end_s = fault_s + (DRIFT_S if fault.kind == "drift" else END_S) - FAULT_S
    before_rad = run.controller.home_rad
    for number in range(1, round(end_s * RATE_HZ)):
        now_s = number / RATE_HZ
        if touched and math.isclose(now_s, TOUCHED_S):
            run.forces_n = normal_force_n(run.mechanism, run.command_rad, **TOUCHED)
            run.rest()
        if math.isclose(now_s, fault_s):
            before_rad = run.controller.command_rad
            if fault.kind == "broken cable":
                pretension_n = run.mechanism.pretension_n.copy()
                pretension_n[fault.cable] = LOOSE_N
                run.mechanism = replace(run.mechanism, pretension_n=pretension_n)
                run.rest()
        if not touched and math.isclose(now_s, MOVED_S):
            run.commanded(pose, now_s)
            before_rad = pose
        failing = now_s >= fault_s
        run.tick(now_s, fault if failing else None, now_s - fault_s)
        if failing:
            away_rad = run.controller.command_rad - before_rad
            turned_rad = max(turned_rad, float(np.abs(away_rad).max()))
    assert run.estimation.state.unloaded.known
    return float(np.rad2deg(turned_rad))


if __name__ == "__main__":
    main()
