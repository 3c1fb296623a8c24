"""Equilibria per second with cables that only pull, and how long time-stepping takes for the same.

    python benchmarks/equilibria.py [--cases 65536] [--write]

Worker processes, one per core and each with one BLAS thread, solve random poses within ±10
degrees under one contact of 0 to 200 N. Handing out the cases and taking back the tensions counts,
starting the workers does not. Then 2,000 hard cases (±20 degrees, one to four contacts) with their
residuals.

The baseline steps the same model in time, from the unloaded rest until no joint moves faster than
`STILL_RAD_S`, under loads at which no plates of either arm touch. The ratio compares the time
per case: `ArmDynamics.settle` on one core against the solver on all.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import harness
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

SHARE = 2_048
HARD_CASES = 2_000
STEPPED_CASES = 12
STILL_RAD_S = {"cdsm": 1e-8, "cdsm_lab": 1e-6}
STEPPED_LARGEST_N = {"cdsm": 200.0, "cdsm_lab": 100.0}
BAR_PER_S = 10_000
RATIO_BAR = 500


def main() -> int:
    """Measure, print, write; 1 where a bar is missed."""
    parser = harness.parser(__doc__, "results/equilibria.json")
    parser.add_argument("--cases", type=int, default=65_536, help="random poses of each arm")
    options = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "MKL"):  # read by the workers, which start afterwards
        os.environ[f"{library}_NUM_THREADS"] = "1"
    with WorkerPool(len(os.sched_getaffinity(0))) as pool:
        arms = {name: _measure(pool, name, options.cases) for name in STILL_RAD_S}
    command, forces = _cases(mechanism_of(open_arm("cdsm")), HARD_CASES, degrees=20, contacts=4)
    good = _with_rest("cdsm", command, forces)
    _, residual_n_m = _solve("cdsm", command[good], forces[good])
    report = {
        "arms": arms,
        "hard": {
            "cases": HARD_CASES,
            "converged": len(good),
            "largest_residual_n_m": float(residual_n_m.max()),
        },
        "bars": {
            f"{BAR_PER_S} a second": all(a["per_second"] >= BAR_PER_S for a in arms.values()),
            f"cdsm_lab: ratio of {RATIO_BAR}": arms["cdsm_lab"]["ratio_as_run"] >= RATIO_BAR,
            "every hard case converged": len(good) == HARD_CASES,
        },
    }
    return harness.publish("equilibria.json", report, options, "numpy", "mujoco")


def _cases(
    mechanism: Mechanism, count: int, degrees: float, contacts: int, largest_n: float = 200.0
) -> tuple[Array, Array]:
    """Commands (B, 2N) and forces (B, N, 3), one to `contacts` contacts each."""
    rng = np.random.default_rng(1)
    segments = mechanism.segment_count
    command = np.deg2rad(rng.uniform(-degrees, degrees, (count, mechanism.joint_count)))
    order = rng.random((count, segments)).argsort(axis=1)
    touched = order < rng.integers(1, contacts + 1, (count, 1))
    forces = np.zeros((count, segments, 3))
    for n in range(segments):
        magnitude = rng.uniform(0, largest_n, count) * touched[:, n]
        forces += normal_force_n(mechanism, command, n + 1, rng.uniform(0, 360, count), magnitude)
    return command, forces


def _with_rest(name: str, command: Array, forces: Array) -> NDArray[np.int64]:
    """Positions of the cases in which the plates do not touch."""
    try:
        _solve(name, command, forces)
    except EquilibriumError as error:
        return np.delete(np.arange(len(command)), error.failed)
    return np.arange(len(command))


def _solve(name: str, command: Array, forces: Array) -> tuple[Array, Array]:
    """Tensions and residuals."""
    rest = solve_equilibrium(mechanism_of(open_arm(name)), command, forces)
    return rest.tensions_n, rest.residual_n_m


def _measure(pool: WorkerPool, name: str, cases: int) -> dict[str, Any]:
    command, forces = _cases(mechanism_of(open_arm(name)), cases, degrees=10, contacts=1)
    # also warms the workers up: each has solved before the clock starts
    parts = [slice(i, i + SHARE) for i in range(0, cases, SHARE)]
    tasks = [(name, command[part], forces[part]) for part in parts]
    kept = pool.map(_with_rest, *zip(*tasks, strict=True))
    good = np.concatenate([p.start + rows for p, rows in zip(parts, kept, strict=True)])
    shares = np.array_split(good, len(parts))
    tasks = [(name, command[share], forces[share]) for share in shares]
    start = time.perf_counter()
    solved = list(pool.map(_solve, *zip(*tasks, strict=True)))
    seconds = time.perf_counter() - start
    ((stepping_s, difference_n),) = pool.map(_step_to_rest, [name])
    return {
        "cases": len(good),
        "per_second": len(good) / seconds,
        "without_rest": cases - len(good),
        "largest_residual_n_m": float(max(residual.max() for _, residual in solved)),
        "stepped_cases": STEPPED_CASES,
        "stepping_ms": 1e3 * stepping_s,
        "largest_tension_difference_n": difference_n,
        "ratio_as_run": stepping_s * len(good) / seconds,
    }


def _step_to_rest(name: str) -> tuple[float, float]:
    """Mean processor seconds of a case, and the largest difference from equilibrium, N."""
    arm = open_arm(name)
    mechanism = mechanism_of(arm)
    dynamics = ArmDynamics(arm)
    command, forces = _cases(mechanism, STEPPED_CASES, 10, 1, STEPPED_LARGEST_N[name])
    rest = solve_equilibrium(mechanism, command, forces)
    seconds = 0.0
    difference_n = 0.0
    for i in range(STEPPED_CASES):
        dynamics.reset(command[i])
        for n in range(arm.segment_count):
            dynamics.load(n + 1, forces[i, n])
        start = time.process_time()
        dynamics.settle(STILL_RAD_S[name])
        seconds += time.process_time() - start
        off_n = np.abs(dynamics.tensions_n - rest.tensions_n[i]).max()
        difference_n = max(difference_n, float(off_n))
    return seconds / STEPPED_CASES, difference_n


if __name__ == "__main__":
    sys.exit(main())
