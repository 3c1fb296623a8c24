"""How long the estimate of a push stays away after joints have moved.

    python benchmarks/motion.py [--moves 6] [--seed 7301] [--workers 2] [--write]

The estimator's core answers a simulated arm with its dynamics, at 500 Hz in simulated time, with
the sensors' noise and step. A push acts on a segment while the joints step, or
follow commands that stream at 50 Hz as those of a trajectory do. The time counts from when the
set-points have arrived until there is a force for good. On the way, the share of samples without a
force counts, that of true forces outside the stated interval, and the largest error of a force
that is vouched for.

An arm at rest whose commands are the readings of an encoder is a course too. Its forces are
compared with those at the poses that single commands state.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import harness
import numpy as np
from estimated_arm import START_NS, EstimatedArm
from estimation_settings import estimation_settings
from rich.progress import track

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_msgs_py.messages import ForceState, Load
from cablesense_online.answer import Answer
from cablesense_online.contacts import Situation
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

RATE_HZ = 500
COMMANDS_HZ = 50
PUSH_N = 20.0
BEND_DEG = (5.0, 8.0)
REST_S = 1.5
AFTER_S = 2.0
JOINT_SPEED_RAD_S = float(np.deg2rad(20.0))
LATE_S = 0.1
IN_TIME = 0.99
"""The bar: the force is back so long after the arm may have settled, in this share of moves."""
FIGURES = (
    "no_force_after_arrival_s",
    "share_without_force_on_the_way",
    "share_outside_interval_on_the_way",
    "largest_vouched_error_n",
)
ENCODER = "encoder noise at rest"
NOISE_RAD = 1e-3
NOISE_HZ = 100
NOISY_PUSH_N = 30.0
ANSWERED = 0.95
NOISES = 3.0
"""The bar under noise: this share of samples has a force, and this share of forces is within three
standard deviations of those at single noisy poses."""
SINGLE_POSES = 40
PERCENTILES = ("median", "99 %", "worst")
Course = list[tuple[float, float | Array]]
"""When each command comes, s, and how far each joint has turned by then, rad."""


def stream(speed_rad_s: float, duration_s: float) -> Course:
    """Commands of a steady motion."""
    count = round(duration_s * COMMANDS_HZ)
    return [(k / COMMANDS_HZ, speed_rad_s * k / COMMANDS_HZ) for k in range(1, count + 1)]


def trajectory(turn_rad: float, duration_s: float) -> Course:
    """Commands of a minimum-jerk motion."""
    share = np.arange(1, round(duration_s * COMMANDS_HZ) + 1) / (duration_s * COMMANDS_HZ)
    turned_rad = turn_rad * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return list(zip((share * duration_s).tolist(), turned_rad.tolist(), strict=True))


MOVES: dict[str, Course] = {
    "noise of 0.001 rad that the arm follows": [],
    ENCODER: [],
    "step of 0.1°": [(0.0, np.deg2rad(0.1))],
    "step of 1°": [(0.0, np.deg2rad(1.0))],
    "step of 5°": [(0.0, np.deg2rad(5.0))],
    "0.02 rad/s for 2 s": stream(0.02, 2.0),
    "0.05 rad/s for 2 s": stream(0.05, 2.0),
    "0.1 rad/s for 2.5 s": stream(0.1, 2.5),
    "0.2 rad/s for 1 s": stream(0.2, 1.0),
    "0.5 rad/s for 0.5 s": stream(0.5, 0.5),
    "0.1 rad/s for 1 s, then 1°": [*stream(0.1, 1.0), (1.3, 0.1 + np.deg2rad(1.0))],
    "trajectory of 0.1 rad in 4 s": trajectory(0.1, 4.0),
    "trajectory of 0.2 rad in 2 s": trajectory(0.2, 2.0),
}


def noise(rng: np.random.Generator, joints: int) -> Course:
    """Commands with the noise of an encoder."""
    turned_rad = rng.normal(0.0, NOISE_RAD, (3 * NOISE_HZ, joints))
    return [((k + 1) / NOISE_HZ, turn_rad) for k, turn_rad in enumerate(turned_rad)]


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
        self._tick = 0
        self.now_s = 0.0
        dynamics = ArmDynamics(self.arm)
        self._simulated = SimulatedArm(dynamics, 1e-3, JOINT_SPEED_RAD_S, 0.0, now_s=0.0)
        self.set_points = JointMotion.at_rest(dynamics.command_rad, JOINT_SPEED_RAD_S)

    def go_to(self, angles_rad: Array) -> None:
        """Command arm and estimator."""
        self._simulated.go_to(angles_rad)
        self.set_points = self.set_points.towards(angles_rad)
        self.command(angles_rad)

    def push(self, load: Load) -> None:
        """Push on a segment at its middle."""
        self._load = load
        self._simulated.push(load, self.now_s)

    def pushed_n(self) -> float:
        """The part of the push that is normal to its segment now."""
        rotations = segment_rotations(self.mechanism, self.set_points.angle_rad)
        axis = rotations[self._load.segment - 1][:, 0]
        return float(np.linalg.norm(np.cross(axis, self._load.force_base_n)))

    def reading_n(self) -> Array:
        """Readings (M,) of the tensions now."""
        return self._simulated.reading_n(self.arm.sensors, self.rng)

    def next(self) -> Answer:
        """The answer to the next sample."""
        self._tick += 1
        self.now_s = self._tick / RATE_HZ
        self.set_points = self.set_points.after(1.0 / RATE_HZ)
        self._simulated.advance_to(self.now_s)
        return self.sample(self.reading_n(), self.now_s)

    def rest(self) -> None:
        """Let the arm settle."""
        for _ in range(round(REST_S * RATE_HZ)):
            self.next()


def noisy_n(bench: Bench, here_rad: Array, pushed_n: float) -> float:
    """Standard deviation of forces that are estimated at the poses of single noisy commands."""
    off_n = []
    here_n = unloaded_n(bench.mechanism, here_rad)
    for _ in range(SINGLE_POSES):
        stated_rad = here_rad + bench.rng.normal(0.0, NOISE_RAD, len(here_rad))
        reading_n = bench.reading_n() + here_n - unloaded_n(bench.mechanism, stated_rad)
        contacts = bench.estimation.estimator.contacts
        unloaded = bench.estimation.state.unloaded
        _, estimate = contacts.find(unloaded, reading_n, Situation(here_rad, START_NS))
        sizes_n = [contact.magnitude_n for contact in estimate.contacts] if estimate else []
        off_n.append(max(sizes_n, default=0.0) - pushed_n)
    return float(np.sqrt(np.mean(np.square(off_n))))


def unloaded_n(mechanism: Mechanism, command_rad: Array) -> Array:
    """Tensions (M,) of the untouched arm at a command."""
    return solve_equilibrium(mechanism, command_rad).tensions_n


def moved(seed: int, name: str, title: str, number: int) -> list[float]:
    """The `FIGURES` of one course; of an encoder's noise also the share of forces too far off."""
    rng = np.random.default_rng([seed, *name.encode(), *title.encode(), number])
    bench = Bench(name, rng)
    segment = int(rng.integers(2, 5))
    joints = bench.arm.joint_count
    signs = rng.choice([-1.0, 1.0], joints)  # through the straight arm, within the model's range
    start_rad = -signs * np.deg2rad(rng.uniform(*BEND_DEG, joints))
    bench.rest()
    bench.go_to(start_rad)
    bench.rest()
    angle_deg = rng.uniform(0.0, 360.0)
    push_n = NOISY_PUSH_N if title == ENCODER else PUSH_N
    forces_n = normal_force_n(bench.mechanism, start_rad, segment, angle_deg, push_n)
    bench.push(Load(segment, forces_n[segment - 1]))
    bench.rest()
    most_off_n = NOISES * noisy_n(bench, start_rad, push_n) if title == ENCODER else np.inf
    command, after_s = (bench.command, 0.0) if title == ENCODER else (bench.go_to, AFTER_S)
    began_s = bench.now_s
    commands = list(MOVES[title]) or noise(rng, joints)
    away_s = began_s
    arrived_s = away_s
    away = 0
    on_the_way = 0
    stated = 0
    outside = 0
    far_off = 0
    worst_n = 0.0
    while commands or bench.set_points.moving or bench.now_s < arrived_s + after_s:
        while commands and bench.now_s >= began_s + commands[0][0]:
            command(start_rad + signs * commands.pop(0)[1])
        answer = bench.next()
        contact = answer.contact
        if not contact.segment:
            away_s = bench.now_s
        if commands or bench.set_points.moving:
            arrived_s = bench.now_s
            pushed_n = bench.pushed_n()
            on_the_way += 1
            away += not contact.segment
            right = contact.segment == segment
            off_n = abs(contact.magnitude_n - pushed_n) if right else push_n
            far_off += off_n > most_off_n
            if right and answer.estimate is not None:
                stated += 1
                outside += not answer.estimate.low_n <= pushed_n <= answer.estimate.high_n
            if answer.force is ForceState.CONTACT:
                worst_n = max(worst_n, off_n)
    late_s = max(0.0, away_s - arrived_s)
    shares = [away / on_the_way, outside / max(stated, 1)]
    return [late_s, *shares, worst_n, far_off / on_the_way]


def main() -> None:
    """Moves both arms, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "motion.json")
    options.add_argument("--moves", type=int, default=6, help="of each kind and arm")
    options.add_argument("--seed", type=int, default=7301, help="of poses, pushes and noise")
    options.add_argument("--workers", type=int, default=2, help="processes")
    given = options.parse_args()
    result: dict[str, Any] = {"of_each_figure": PERCENTILES}
    latest_s = estimation_settings().settle_s + LATE_S
    in_time = []
    answered = []
    with WorkerPool(given.workers, given.seed) as pool:
        for name, title in product(("cdsm", "cdsm_lab"), MOVES):
            numbers = range(given.moves)
            runs = pool.map(moved, [name] * given.moves, [title] * given.moves, numbers)
            moves = np.array(list(track(runs, f"{name}, {title}", given.moves)))
            figures = dict(zip(FIGURES, moves.T[:-1], strict=True))
            if title == ENCODER:
                figures["share_beyond_three_noises"] = moves[:, -1]
                answered += (1.0 - moves[:, [1, -1]].mean(axis=0)).tolist()
            in_time.append(float(np.mean(moves[:, 0] <= latest_s)))
            of = {what: harness.percentiles(each, PERCENTILES) for what, each in figures.items()}
            short = {what: list(each.values()) for what, each in of.items()}
            result.setdefault(name, {})[title] = {"in_time": in_time[-1], **short}
    result["bars"] = {
        f"back within {latest_s:g} s in {IN_TIME:.0%} of the moves": min(in_time) >= IN_TIME,
        f"{ANSWERED:.0%} answered and near under an encoder's noise": min(answered) >= ANSWERED,
    }
    harness.publish("motion.json", result, given, "mujoco", "numpy")


if __name__ == "__main__":
    main()
