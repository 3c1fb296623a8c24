"""The admittance loop over real nodes and in statics: force without and with the controller.

    python benchmarks/admittance.py --write

For every segment, four directions and walls of several stiffnesses the loop of law, wall and arm
at rest runs for `STEPS` steps (`run_loop`: no noise, nothing swings). Stable means that the force
of the last steps does not rise and fall by more than `CHATTER_N`. Then the nodes run over the
middleware, in simulated dynamics with the sensors' noise:
`python -m examples.admittance --json`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import harness
import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from examples.admittance.__main__ import play
from examples.admittance.law import AdmittanceLaw, AdmittanceSettings, ContactForce
from examples.admittance.wall import ElasticWall, wall_beside

RESULT = "admittance.json"
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


def main() -> None:
    """Measure, print, write."""
    options = harness.parser(__doc__, f"results/{RESULT}").parse_args()
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
    report = {
        **harness.origin("mujoco"),
        "assumed_worst_stiffness_n_m": settings.worst_stiffness_n_m,
        "deadband_n": settings.deadband_n,
        "period_s": PERIOD_S,
        "steps": STEPS,
        "stable": f"{sum(case['stable'] for case in cases)} of {len(cases)}",
        "real_nodes": {k: round(v, 2) if isinstance(v, float) else v for k, v in nodes.items()},
        "cases": cases,
    }
    harness.publish(RESULT, report, options)


def _case(
    arm: str, settings: AdmittanceSettings, segment: int, angle_deg: float, stiffness_n_m: float
) -> dict[str, Any]:
    mechanism = mechanism_of(open_arm(arm))
    home = np.zeros(mechanism.joint_count)
    law = AdmittanceLaw(mechanism, settings)
    wall = wall_beside(mechanism, home, segment, angle_deg, stiffness_n_m)
    advance = HELD_N * (1.0 / stiffness_n_m + wall.compliance_m_n)
    forces, commands = run_loop(mechanism, law, wall, segment, home, advance, STEPS, PERIOD_S)
    final = float(forces[-1])
    unsettled = np.flatnonzero(np.abs(forces - final) > SETTLED_WITHIN_N)
    return {
        "case": f"{arm}, segment {segment}, {angle_deg:g} degrees, {stiffness_n_m:g} N/m",
        "loop_gain": round(law.loop_gain(home, segment, wall.normal, stiffness_n_m, PERIOD_S), 3),
        "without_n": round(float(forces[0]), 2),
        "with_n": round(final, 2),
        "settling_s": round(float(unsettled[-1] + 1) * PERIOD_S if len(unsettled) else 0.0, 2),
        "stable": bool(np.ptp(forces[-LAST:]) <= CHATTER_N or np.all(np.diff(forces) <= 1e-3)),
        "largest_angle_deg": round(float(np.rad2deg(np.abs(commands[-1]).max())), 3),
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
) -> tuple[Array, Array]:
    """Wall, arm in static equilibrium, an exact estimate and the law: a step every `period_s`.

    Starts at home (2N,) against the wall at an advance. Gives the wall's forces (K+1,), N, and the
    commands (K+1, 2N), rad, before each of K steps and after the last.

    Raises:
        EquilibriumError: the arm cannot rest under the wall's force.
    """
    command, forces_n, commands_rad = home_rad, [], []
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
        commands_rad.append(command)
        if len(forces_n) > step_count:
            return np.array(forces_n), np.array(commands_rad)
        axis = kinematics.segment_rotations(mechanism, command)[segment - 1][:, 0]
        normal = loads[segment - 1] - axis * (axis @ loads[segment - 1])
        contact = ContactForce(segment, np.asarray(normal)) if normal.any() else None
        command = law.step(command, home_rad, contact, period_s)


if __name__ == "__main__":
    main()
