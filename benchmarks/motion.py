"""How long the estimate of a push stays away after joints have moved.

    python benchmarks/motion.py [--moves 6] [--seed 7301] [--write]

The estimator's core answers a simulated arm with its dynamics, at 500 Hz in simulated time, with
the sensors' noise and step. A push acts on a segment while the joints step, or
follow commands that stream at 50 Hz as those of a trajectory do. The time counts from when the
set-points have arrived until there is a force for good. On the way, the share of samples without a
force counts, that of true forces outside the stated interval, and the largest error of a force
that is vouched for. Commands with the noise of an encoder are a way, too.
"""

from __future__ import annotations

from typing import Any

import harness
import numpy as np
from estimated_arm import EstimatedArm
from estimation_settings import estimation_settings
from rich.progress import track

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState, Load
from cablesense_online.answer import Answer
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import normal_force_n

RATE_HZ, COMMANDS_HZ = 500, 50
PUSH_N, BEND_DEG = 20.0, (5.0, 8.0)
REST_S, AFTER_S = 1.5, 2.0
JOINT_SPEED_RAD_S = float(np.deg2rad(20.0))
LATE_S = 0.1
"""The bar: the force is back so long after the arm may have settled."""
FIGURES = (
    "no_force_after_arrival_s",
    "share_without_force_on_the_way",
    "share_outside_interval_on_the_way",
    "largest_vouched_error_n",
)
NOISE_HZ = 100
Course = list[tuple[float, float | Array]]
"""When each command comes, s, and how far each joint has turned by then, rad."""


def stream(speed_rad_s: float, duration_s: float) -> Course:
    """Commands of a steady motion."""
    count = round(duration_s * COMMANDS_HZ)
    return [(k / COMMANDS_HZ, speed_rad_s * k / COMMANDS_HZ) for k in range(1, count + 1)]


_NOISE_RAD = np.random.default_rng(7).normal(0.0, 1e-3, (300, 8))
MOVES: dict[str, Course] = {
    "noise of 0.001 rad": [((k + 1) / NOISE_HZ, off) for k, off in enumerate(_NOISE_RAD)],
    "step of 0.1°": [(0.0, np.deg2rad(0.1))],
    "step of 1°": [(0.0, np.deg2rad(1.0))],
    "step of 5°": [(0.0, np.deg2rad(5.0))],
    "0.05 rad/s for 2 s": stream(0.05, 2.0),
    "0.1 rad/s for 2.5 s": stream(0.1, 2.5),
    "0.2 rad/s for 1 s": stream(0.2, 1.0),
    "0.1 rad/s for 1 s, then 1°": [*stream(0.1, 1.0), (1.3, 0.1 + np.deg2rad(1.0))],
}
"""The noise is that of an encoder, whose readings at rest are the commands."""


class Bench(EstimatedArm):
    """The simulated arm that the estimator's core answers, in simulated time `now_s`."""

    def __init__(self, name: str, rng: np.random.Generator) -> None:
        super().__init__(
            name,
            rng,
            joint_speed_rad_s=JOINT_SPEED_RAD_S,
            still_rad=float(np.deg2rad(0.02)),
            follow_rad_s=float(np.deg2rad(4.0)),
        )
        self._tick, self.now_s, dynamics = 0, 0.0, ArmDynamics(self.arm)
        self._simulated = SimulatedArm(dynamics, 1e-3, JOINT_SPEED_RAD_S, 0.0, now_s=0.0)
        self.set_points = JointMotion(dynamics.command_rad, JOINT_SPEED_RAD_S)

    def command(self, angles_rad: Array) -> None:
        """Command arm and estimator."""
        self._simulated.go_to(angles_rad)
        self.set_points.go_to(angles_rad)
        super().command(angles_rad)

    def push(self, load: Load) -> None:
        """Push on a segment at its middle."""
        self._load = load
        self._simulated.push(load, self.now_s)

    def pushed_n(self) -> float:
        """The part of the push that is normal to its segment now."""
        rotations = segment_rotations(self.mechanism, self.set_points.state[0])
        axis = rotations[self._load.segment - 1][:, 0]
        return float(np.linalg.norm(np.cross(axis, self._load.force_base_n)))

    def next(self) -> Answer:
        """The answer to the next sample."""
        self._tick += 1
        self.now_s = self._tick / RATE_HZ
        self.set_points.advance(1.0 / RATE_HZ)
        self._simulated.advance_to(self.now_s)
        return self.sample(self._simulated.reading_n(self.arm.sensors, self.rng), self.now_s)

    def rest(self) -> None:
        """Let the arm settle."""
        for _ in range(round(REST_S * RATE_HZ)):
            self.next()


def away_s(name: str, course: Course, rng: np.random.Generator) -> list[float]:
    """The `FIGURES` of one course."""
    bench, segment = Bench(name, rng), int(rng.integers(2, 5))
    joints = bench.arm.joint_count
    signs = rng.choice([-1.0, 1.0], joints)  # through the straight arm, within the model's range
    start_rad = -signs * np.deg2rad(rng.uniform(*BEND_DEG, joints))
    bench.rest()
    bench.command(start_rad)
    bench.rest()
    angle_deg = rng.uniform(0.0, 360.0)
    forces_n = normal_force_n(bench.mechanism, start_rad, segment, angle_deg, PUSH_N)
    bench.push(Load(segment, forces_n[segment - 1]))
    bench.rest()
    began_s, commands = bench.now_s, list(course)
    away_s = arrived_s = began_s
    away = on_the_way = stated = outside = 0
    worst_n = 0.0
    while commands or bench.set_points.moving or bench.now_s < arrived_s + AFTER_S:
        while commands and bench.now_s >= began_s + commands[0][0]:
            bench.command(start_rad + signs * commands.pop(0)[1])
        answer = bench.next()
        contact = answer.contact
        if not contact.segment:
            away_s = bench.now_s
        if commands or bench.set_points.moving:
            arrived_s, pushed_n = bench.now_s, bench.pushed_n()
            on_the_way += 1
            away += not contact.segment
            if contact.segment == segment and answer.estimate is not None:
                stated += 1
                outside += not answer.estimate.low_n <= pushed_n <= answer.estimate.high_n
            if answer.force is ForceState.CONTACT:
                right = contact.segment == segment
                off_n = abs(contact.magnitude_n - pushed_n) if right else PUSH_N
                worst_n = max(worst_n, off_n)
    late_s = max(0.0, away_s - arrived_s)
    return [late_s, away / on_the_way, outside / max(stated, 1), worst_n]


def main() -> None:
    """Moves both arms, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "motion.json")
    options.add_argument("--moves", type=int, default=6, help="of each kind and arm")
    options.add_argument("--seed", type=int, default=7301, help="of poses, pushes and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    worst_s = 0.0
    for row, name in enumerate(("cdsm", "cdsm_lab")):
        for column, (title, course) in enumerate(MOVES.items()):
            rng = np.random.default_rng([given.seed, row, column])
            times = [away_s(name, course, rng) for _ in track(range(given.moves), title)]
            result.setdefault(name, {})[title] = {
                what: harness.percentiles(each, ["median", "worst"])
                for what, each in zip(FIGURES, np.transpose(times), strict=True)
            }
            worst_s = max(worst_s, *(late_s for late_s, *_ in times))
    settle_s = estimation_settings().settle_s
    result["bars"] = {f"back within {settle_s + LATE_S:g} s": worst_s <= settle_s + LATE_S}
    harness.publish("motion.json", result, given, "mujoco", "numpy")


if __name__ == "__main__":
    main()
