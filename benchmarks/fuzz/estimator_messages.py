"""Serialized tensions, and commands, into everything that the estimator node does without ROS.

The oracle reads each message by another library. A contact is right if the bytes are a message
with every cable's plausible tension and a present stamp, and if the model says that contact of
those tensions; from anything else there must be none.
"""

from __future__ import annotations

import math
import random
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.estimation import Estimation
from cablesense_ros.estimation_settings import EstimationSettings
from cablesense_ros.outcome import Outcome as Estimated
from cablesense_ros.sample_check import PLAUSIBLE_N
from cablesense_sim.arm_files import open_arm
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.model_files import find_model
from fuzz.joint_state_bytes import joint_state_bytes, mutated_joint_state, read_joint_state
from fuzz.target import FalseAnswerError, Outcome, Run, item_random, require_one_line

Array = NDArray[np.float64]

MESSAGES = 100
COMMANDS = 8
TARED_NS = 10**18
_SETTINGS = EstimationSettings(
    contact_threshold=0.5,
    stale_after_s=0.2,
    slack_below_n=1.0,
    tare_samples=5,
    tare_steady_n=1.0,
    auto_tare=True,
    joint_speed_rad_s=0.35,
    settle_s=0.5,
)


class _Bench:
    """An arm, its model, tensions unloaded and under many pushes."""

    def __init__(self, rng: random.Random) -> None:
        self.arm = open_arm("cdsm")
        self.estimator = Estimator.load(find_model("cdsm"), self.arm)
        self.reference = Estimator.load(find_model("cdsm"), self.arm)
        mechanism = Mechanism.from_arm(self.arm)
        straight = np.zeros((40, self.arm.joint_count))
        forces = np.zeros((40, self.arm.segment_count, 3))
        for row in range(40):
            segment = np.array([1 + row % self.arm.segment_count])
            forces[row] = normal_force_n(
                mechanism,
                straight[:1],
                segment,
                np.array([rng.uniform(0.0, 360.0)]),
                np.array([rng.uniform(5.0, 150.0)]),
            )[0]
        self.unloaded: Array = solve_equilibrium(mechanism, straight[0]).tensions_n
        self.pushed: Array = solve_equilibrium(mechanism, straight, forces).tensions_n


class _Feed:
    """An estimation that was tared, and the clock beside it."""

    def __init__(self, bench: _Bench) -> None:
        self.bench = bench
        self.estimation = Estimation(bench.arm, bench.estimator, _SETTINGS, 0.0)
        self.now_ns = TARED_NS
        self.last_ns = 0
        for _ in range(_SETTINGS.tare_samples):
            self.now_ns += 10**7
            raw = joint_state_bytes(self.now_ns, bench.arm.cable_names, bench.unloaded)
            self.estimation.sample(raw, self.now_ns, self.now_s)

    @property
    def now_s(self) -> float:
        return (self.now_ns - TARED_NS) * 1e-9

    def give(self, raw: bytes) -> Estimated:
        self.now_ns += 10**7
        return self.estimation.sample(raw, self.now_ns, self.now_s)

    def judge(self, raw: bytes, outcome: Estimated) -> None:
        if outcome.problem is not None:
            require_one_line(outcome.problem)
        contact = outcome.contact
        if contact.segment == 0:
            return
        said = read_joint_state(raw)
        order = self.bench.arm.cable_names
        if said is None or sorted(said.names) != sorted(order) or len(said.efforts) != len(order):
            raise FalseAnswerError(f"a contact from no message of this arm: {raw.hex()[:400]}")
        tensions = [said.efforts[said.names.index(name)] for name in order]
        low, high = PLAUSIBLE_N
        if not all(math.isfinite(t) and low < t < high for t in tensions):
            raise FalseAnswerError(f"a contact from tensions {tensions}")
        if said.stamp_ns and abs(said.stamp_ns - self.now_ns) > 0.2e9:
            raise FalseAnswerError(f"a contact from {said.stamp_ns - self.now_ns} ns ago")
        right = self.bench.reference.estimate(
            np.array(tensions) - self.estimation.tare.unloaded_n,
            np.zeros(self.bench.arm.joint_count),
        )
        if (right.angle_deg, right.magnitude_n) != (contact.angle_deg, contact.magnitude_n):
            raise FalseAnswerError(f"{contact} where the model says {right}")


def make_messages(seed: int) -> Run:
    """Items are a hundred messages, of which two thirds are mutated, to a tared estimation."""
    bench = _Bench(random.Random(seed))

    def run(item: int) -> Outcome:
        rng = item_random("messages", seed, item)
        feed = _Feed(bench)
        refused = mutated = 0
        while mutated < MESSAGES:
            tensions = bench.pushed[rng.randrange(len(bench.pushed))]
            stamp_ns = feed.now_ns + 10**7 - rng.randint(0, 10**6)
            raw = joint_state_bytes(stamp_ns, bench.arm.cable_names, tensions)
            if rng.random() < 0.67:
                mutated += 1
                raw = mutated_joint_state(
                    rng, raw, bench.arm.cable_names, tensions.tolist(), stamp_ns
                )
            outcome = feed.give(raw)
            refused += outcome.problem is not None
            feed.judge(raw, outcome)
        feed.now_ns += 10**9
        raw = joint_state_bytes(feed.now_ns + 10**7, bench.arm.cable_names, bench.pushed[0])
        if feed.give(raw).contact.segment != 1:
            raise FalseAnswerError("a good message after bad ones was not answered")
        return Outcome(inputs=mutated, refused=refused, taken=max(0, mutated - refused))

    return run


def make_commands(seed: int) -> Run:
    """Items are a few commands as ROS hands them over, mutated, to a tared estimation."""
    bench = _Bench(random.Random(seed))

    def run(item: int) -> Outcome:
        rng = item_random("commands", seed, item)
        feed = _Feed(bench)
        refused = 0
        for _ in range(COMMANDS):
            before = feed.estimation.command_deg
            message = _command(rng, bench.arm.joint_names)
            try:
                feed.estimation.command(message)
            except CableSenseError as error:
                require_one_line(error)
                refused += 1
                if feed.estimation.command_deg != before:
                    raise FalseAnswerError("a refused command counts") from error
            else:
                angles = dict(zip(message.name, message.position, strict=True))
                wanted = [math.degrees(angles[name]) for name in bench.arm.joint_names]
                if not np.allclose(feed.estimation.command_deg, wanted, atol=1e-9):
                    raise FalseAnswerError(f"{wanted} was taken for another command")
            outcome = feed.give(
                joint_state_bytes(feed.now_ns + 10**7, bench.arm.cable_names, bench.pushed[0])
            )
            moved = feed.estimation.command_deg != before
            if outcome.contact.segment and (moved or any(feed.estimation.command_deg)):
                raise FalseAnswerError("a contact while the arm may move")
        return Outcome(inputs=COMMANDS, refused=refused, taken=COMMANDS - refused)

    return run


def _command(rng: random.Random, names: tuple[str, ...]) -> SimpleNamespace:
    given, angles = list(names), [rng.uniform(-0.15, 0.15) for _ in names]
    for _ in range(rng.randint(0, 2)):
        at = rng.randrange(len(angles)) if angles else 0
        action = rng.randrange(5)
        if action == 0 and angles:
            angles[at] = rng.choice((math.nan, math.inf, -math.inf, 1e308, 1.0, -0.6, 57.0))
        elif action == 1:
            del angles[at:]
        elif action == 2:
            given[rng.randrange(len(given))] = rng.choice(("", "joint_1_pitch", "x" * 9999, "\0"))
        elif action == 3:
            given += rng.choice((given[:1], ["x"] * 5000))
        else:
            order = list(range(min(len(given), len(angles))))
            rng.shuffle(order)
            given, angles = [given[i] for i in order], [angles[i] for i in order]
            if not given:
                given = [""]
    return SimpleNamespace(name=given, position=angles)
