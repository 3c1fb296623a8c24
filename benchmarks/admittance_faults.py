"""How far the admittance controller moves an arm whose sensors or cables fail.

    python benchmarks/admittance_faults.py [--arm cdsm] [--workers 2] [--write]

Estimator and controller run in one process, at 50 Hz, with a simulated arm that steps from rest to
rest (no swing). Readings have the sensors' noise and step. Every fault comes to an arm that
nothing touches: after the tare, and 2 s later another node commands a bent pose. It also comes to
an arm that a weight of 40 N pulls, on segment 3, to the controller's limit (1.5 degrees). The
measure is the distance of the controller's commands from the pose that others commanded, or in
contact from the one before the fault.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import harness
import numpy as np
from estimated_arm import START_NS, EstimatedArm

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import open_arm
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from examples.admittance.controller import AdmittanceController
from examples.admittance.law import AdmittanceSettings

ARMS = ("cdsm", "cdsm_lab")
BAR_DEG = 0.5
RATE_HZ = 50.0
FAULT_S, MOVED_S, END_S = 3.0, 5.0, 9.0
DRIFT_S = 14.0
TOUCHED = {"segment": 3, "angle_deg": 70.0, "magnitude_n": 40.0}
TOUCHED_S, GIVEN_WAY_S, TOUCHED_LIMIT_DEG = 3.0, 12.0, 1.5
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


class Fault:
    """A fault of one cable, from 0; `none` has none."""

    def __init__(self, kind: str, size: float, cable: int) -> None:
        self.kind, self.size, self.cable = kind, size, cable
        self._stuck_at_n: float | None = None

    def change(self, reading_n: Array, since_s: float) -> None:
        """Change readings (M,) in place, so long after the fault began, s."""
        at, size = self.cable, self.size
        match self.kind:
            case "zero":
                reading_n[at] = 0.0
            case "scale":
                reading_n[at] *= size
            case "offset":
                reading_n[at] += size
            case "drift":
                reading_n[at] += size * since_s
            case "stuck":
                if self._stuck_at_n is None:
                    self._stuck_at_n = reading_n[at] + size
                reading_n[at] = self._stuck_at_n
            case "exchanged":
                other = (at + round(size)) % len(reading_n)
                reading_n[[at, other]] = reading_n[[other, at]]


def faults(cables: int) -> Iterator[Fault]:
    """Every kind of every cable in all its sizes."""
    yield Fault("none", 0.0, 0)
    for cable in range(cables):
        for kind, sizes in KINDS.items():
            yield from (Fault(kind, size, cable) for size in sizes)


class Run(EstimatedArm):
    """Arm, estimator and controller; every message is answered as the nodes do."""

    def __init__(self, arm_name: str, seed: int, **limits: Any) -> None:
        super().__init__(
            arm_name,
            np.random.default_rng(seed),
            arm_name,
            joint_speed_rad_s=float(np.deg2rad(20.0)),
            tare_deviation_n=2.0,
            tare_drift_n=0.1,
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

    def tick(self, now_s: float, fault: Fault | None, since_s: float) -> float:
        """One sample and what follows; gives the force that was estimated, N."""
        read_n = self.read(self._tensions_n)
        if fault is not None:
            fault.change(read_n, since_s)
        answer = self.sample(np.maximum(read_n, 0.0), now_s)
        contact, controller = answer.contact, self.controller
        force_n, now_ns = np.array(contact.wrench[:3]), START_NS + round(now_s * 1e9)
        given = controller.received(answer.force, contact.segment, force_n, now_ns, now_ns, now_s)
        for command in (given, controller.repeated(now_s)):
            if command is not None:
                self.commanded(command, now_s)
        return contact.magnitude_n


def moved(arm_name: str, fault: Fault, seed: int, *, touched: bool) -> tuple[float, float]:
    """Largest turn of a joint by the controller, degrees, and largest force estimated, N."""
    run = Run(arm_name, seed, **({"joint_limit_deg": TOUCHED_LIMIT_DEG} if touched else {}))
    pose = np.deg2rad(run.rng.uniform(-4.0, 4.0, run.arm.joint_count))
    turned_rad = largest_n = 0.0
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
        force_n = run.tick(now_s, fault if failing else None, now_s - fault_s)
        if failing:
            largest_n = max(largest_n, force_n)
            away_rad = run.controller.command_rad - before_rad
            turned_rad = max(turned_rad, float(np.abs(away_rad).max()))
    assert run.estimation.tares.present is not None
    return float(np.rad2deg(turned_rad)), largest_n


Row = tuple[str, float, int, float, float]


def cable_rows(arm_name: str, touched: bool, cable: int) -> list[Row]:
    """Kind, size, cable, turn (degrees) and largest force (N) of its faults."""
    rows = []
    for number, fault in enumerate(faults(open_arm(arm_name).cable_count)):
        if fault.cable == cable:
            with suppress(EquilibriumError):  # the arm collapses
                found = moved(arm_name, fault, number, touched=touched)
                rows.append((fault.kind, fault.size, cable + 1, *found))
    return rows


def measure(arm_name: str, workers: int, *, touched: bool) -> dict[str, Any]:
    """All faults of one arm, by kind."""
    count = open_arm(arm_name).cable_count
    with WorkerPool(workers, arm_name, touched) as pool:
        rows = [row for found in pool.map(cable_rows, range(count)) for row in found]
    result = {}
    for kind in dict.fromkeys(row[0] for row in rows):
        of = sorted((row for row in rows if row[0] == kind), key=lambda row: -row[3])
        result[kind] = {
            "cases": len(of),
            "moved": sum(row[3] > 0.0 for row in of),
            "beyond_the_bar": [
                f"cable_{cable} {size:g}: {turned_deg:.2f} degrees, {force_n:.1f} N"
                for _, size, cable, turned_deg, force_n in of
                if turned_deg > BAR_DEG
            ],
            "worst_deg": round(of[0][3], 3),
            "largest_estimate_n": round(max(row[4] for row in of), 1),
        }
    return result


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/admittance_faults.json")
    parser.add_argument("--arm", choices=ARMS, action="append", help="only this one")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    result: dict[str, Any] = {**harness.origin(), "bar_deg": BAR_DEG}
    result["arms"] = {
        name: {
            state: measure(name, options.workers, touched=touched)
            for state, touched in (("untouched", False), ("in contact", True))
        }
        for name in options.arm or ARMS
    }
    harness.publish("admittance_faults.json", result, options)


if __name__ == "__main__":
    main()
