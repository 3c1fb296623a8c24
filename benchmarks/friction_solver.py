"""Rests of arms with capstan friction: all of them found, and what one costs.

    python benchmarks/friction_solver.py [--write]

Random histories of `STEPS` rests on either arm, `TOGETHER` arms side by side. Each arm has its own
friction, pulley wrap, commands and loads, every rest another command and another load; cables go
slack in part of them. The same commands and loads are then followed by arms without friction. An
arm that finds no rest counts as failed with its whole history, and the others go on without it.
Courses as a training draws them have loads up to 100 N; those without a rest are left out there.
One arm alone goes on in small steps at `LEAST_PERIOD_S`, as in the sim node: its joints move, and
a load turns and swells. Costs are processor time.
"""

from __future__ import annotations

import sys
import time
from typing import Any, NamedTuple

import harness
import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import LEAST_PERIOD_S, RestToRestArm
from cablesense_sim.effects.registry import EffectEntry, Variants, checked_entry
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import normal_force_n
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_training.data.motion_protocol import MotionProtocol
from cablesense_training.data.sequences import draw_sequences

ARMS = ("cdsm", "cdsm_lab")
HISTORIES, STEPS, TOGETHER = 2_000, 20, 50
MOST_FRICTION, MOST_WRAP_RAD, MOST_DEG, MOST_N = 0.3, np.pi, 8.0, 80.0
COURSES, COURSE_S = 128, 3.0
SMALL_STEPS, MOVE_EVERY, PUSH_EVERY, SPEED_DEG_S = 3_000, 100, 300, 20.0
BAR_N_M = 1e-6
RESULT = "friction_solver.json"


class Followed(NamedTuple):
    """What a batch of arms came to: residuals (R, P), slack cables (R, P), arms without a rest."""

    residual_n_m: Array
    slack: Array
    failed: int
    seconds: float


def main() -> int:
    """Measure, print, write; 1 where a bar is missed."""
    options = harness.parser(__doc__, f"results/{RESULT}").parse_args()
    arms = {name: _measured(open_arm(name)) for name in ARMS}
    protocol = MotionProtocol(sequences=COURSES, duration_s=COURSE_S)
    rested = len(draw_sequences(open_arm("cdsm_friction"), protocol, 0))
    met = rested == COURSES and all(
        not arm["failed"] and arm["largest_residual_n_m"] <= BAR_N_M for arm in arms.values()
    )
    result = {
        **harness.origin("numpy"),
        "bar": {"every_residual_n_m": BAR_N_M, "met": met},
        "arms": arms,
        "courses_of_cdsm_friction": {
            "drawn": COURSES,
            "duration_s": COURSE_S,
            "left_out": COURSES - rested,
        },
        "cdsm_friction_in_small_steps": _in_small_steps(open_arm("cdsm_friction")),
    }
    harness.publish(RESULT, result, options)
    return 0 if met else 1


def _measured(arm: Arm) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    count = HISTORIES // len(ARMS)
    with_it, without = [], []
    for _ in range(0, count, TOGETHER):
        held, forces = _history(arm, rng)
        frictions = [_friction(arm, rng) for _ in range(TOGETHER)]
        with_it.append(_follow(arm, [[entry] for entry in frictions], held, forces))
        without.append(_follow(arm, [[]] * TOGETHER, held, forces))
    residual = np.concatenate([part.residual_n_m.ravel() for part in with_it])
    cost, plain = (1e3 * sum(p.seconds for p in parts) for parts in (with_it, without))
    return {
        "histories": count,
        "rests": residual.size,
        "failed": sum(part.failed for part in with_it),
        "failed_without_friction": sum(part.failed for part in without),
        "largest_residual_n_m": float(residual.max()),
        "rests_with_slack_cables": sum(int((part.slack > 0).sum()) for part in with_it),
        "cost_of_a_rest_ms": round(cost / residual.size, 4),
        "without_friction_ms": round(plain / sum(p.residual_n_m.size for p in without), 4),
    }


def _history(arm: Arm, rng: np.random.Generator) -> tuple[Array, Array]:
    """Held lengths (R, P, M) and loads (R, P, N, 3)."""
    mechanism, shape = mechanism_of(arm), (STEPS, TOGETHER)
    command = np.deg2rad(rng.uniform(-MOST_DEG, MOST_DEG, (*shape, arm.joint_count)))
    segment = rng.integers(0, arm.segment_count + 1, shape)
    angle_deg, magnitude = rng.uniform(0.0, 360.0, shape), rng.uniform(0.0, MOST_N, shape)
    forces = normal_force_n(mechanism, command, segment, angle_deg, magnitude)
    return held_lengths_m(mechanism, command), forces


def _friction(arm: Arm, rng: np.random.Generator) -> EffectEntry:
    values = {
        "coefficient": rng.uniform(0.0, MOST_FRICTION),
        "pulley_wrap_rad": rng.uniform(0.0, MOST_WRAP_RAD),
    }
    return checked_entry("capstan_friction", "arm", values, arm.segment_count, arm.cable_count)


def _in_small_steps(arm: Arm) -> dict[str, Any]:
    rng, moving = np.random.default_rng(2), RestToRestArm(arm)
    motion = JointMotion(moving.command_rad, np.deg2rad(SPEED_DEG_S))
    costs_ms = []
    for step in range(SMALL_STEPS):
        if step % MOVE_EVERY == 0:
            motion.go_to(np.deg2rad(rng.uniform(-MOST_DEG, MOST_DEG, arm.joint_count)))
        moving.command(motion.advance(LEAST_PERIOD_S))
        segment = 1 + step // PUSH_EVERY % arm.segment_count
        moving.load(segment, [0.0, 30.0 * np.sin(0.05 * step), 20.0 * np.cos(0.03 * step)])
        if step % PUSH_EVERY == PUSH_EVERY - 1:
            moving.load(segment, np.zeros(3))
        moving.advance(LEAST_PERIOD_S)
        start = time.process_time()
        moving.tensions_n  # noqa: B018 (comes to rest when read)
        costs_ms.append(1e3 * (time.process_time() - start))
    within = np.mean(np.array(costs_ms) < 1e3 * LEAST_PERIOD_S)
    return {
        "period_ms": 1e3 * LEAST_PERIOD_S,
        "cost_of_a_rest_ms": {
            "mean": round(float(np.mean(costs_ms)), 3),
            **harness.percentiles(costs_ms, ("median", "99 %", "worst")),
        },
        "share_within_a_period": round(float(within), 4),
    }


def _follow(arm: Arm, variants: Variants, held_m: Array, forces_n: Array) -> Followed:
    start = time.process_time()
    mechanisms = [mechanism_of(arm)] * len(variants)
    arms = QuasiStaticArm(mechanisms, variants, some_may_fail=True)
    residual, slack = [], []
    for step, (held, forces) in enumerate(zip(held_m, forces_n, strict=True)):
        tensions = arms.step(float(step), held, forces)
        residual.append(arms.residual_n_m)
        slack.append((tensions <= 0.0).sum(-1))
    seconds = time.process_time() - start
    failed = int(np.isnan(tensions).any(-1).sum())
    return Followed(np.array(residual), np.array(slack), failed, seconds)


if __name__ == "__main__":
    sys.exit(main())
