"""Serialized tensions, and commands, into everything that the estimator node does without ROS.

The oracle reads each message by another library. A contact is right if the bytes are a message
with every cable's plausible tension and a present stamp, and if the model says that contact of
those tensions; from anything else there must be none.

Serialized `JointState` messages, written and read by rosbags: the estimator uses it not.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_typestore

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_online.estimation import Answer, Estimation
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_online.state import EstimationSettings
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from fuzz.mutation import mutated_bytes
from fuzz.watched import FalseAnswerError, Outcome, Run, item_random, require_one_line

_KIND = "sensor_msgs/msg/JointState"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_DEFINITION = _STORE.get_msgdef(_KIND)
_HEAD_BYTES = 12


class Said(NamedTuple):
    """What a message says."""

    stamp_ns: int
    names: tuple[str, ...]
    efforts: tuple[float, ...]


def joint_state_bytes(
    stamp_ns: int, names: Sequence[str], efforts: Sequence[float], **more: Any
) -> bytes:
    """A message; `more` are other fields: `frame_id`, `position`, `velocity`, `little`."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    seconds = min(max(seconds, -(2**31)), 2**31 - 1)
    header = _STORE.types["std_msgs/msg/Header"](
        stamp=_STORE.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds),
        frame_id=more.get("frame_id", "base_link"),
    )
    message = _STORE.types[_KIND](
        header=header,
        name=list(names),
        position=np.array(more.get("position", ()), dtype=np.float64),
        velocity=np.array(more.get("velocity", ()), dtype=np.float64),
        effort=np.array(efforts, dtype=np.float64),
    )
    little = more.get("little", True)
    return bytes(_STORE.serialize_cdr(message, _KIND, little_endian=little))


def read_joint_state(raw: bytes) -> Said | None:
    """What the bytes say, or None where they are no such message; more may stand behind it."""
    try:
        if raw[0] != 0 or raw[1] > 1:
            return None
        read = _DEFINITION.deserialize_cdr_le if raw[1] else _DEFINITION.deserialize_cdr_be
        message: Any = read(raw[4:], 0, _DEFINITION.cls, _STORE)[0]
        stamp = message.header.stamp
        said = Said(
            stamp.sec * 10**9 + stamp.nanosec,
            tuple(message.name),
            tuple(float(value) for value in message.effort),
        )
    except Exception:  # whatever it stumbles over, it is no message
        return None
    return said if stamp.nanosec < 10**9 else None


def mutated_joint_state(
    rng: random.Random, raw: bytes, names: Sequence[str], efforts: Sequence[float], stamp_ns: int
) -> bytes:
    """The message changed in its bytes, or written anew with other fields."""
    if rng.random() < 0.5:
        return mutated_bytes(rng, raw, most=3)
    names, efforts, more = list(names), list(efforts), {}
    for _ in range(rng.randint(1, 2)):
        action = rng.randrange(9)
        at = rng.randrange(len(efforts)) if efforts else 0
        if action == 0 and efforts:
            efforts[at] = rng.choice(
                (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e6, -21.0, 5e-324)
            )
        elif action == 1:
            del efforts[at : at + rng.randint(1, 12)]
        elif action == 2 and names:
            names[rng.randrange(len(names))] = rng.choice(
                ("", "cable_1", "cable_13", "rope", "cable_1\0", "é" * 40, "x" * 5000)
            )
        elif action == 3:
            names += rng.choice((["cable_1"], ["x"] * 5000, list(names)))
        elif action == 4:
            efforts += [0.0] * rng.choice((1, 12, 10_000))
        elif action == 5:
            stamp_ns = rng.choice(
                (0, 1, stamp_ns - 10**9, stamp_ns + 10**9, -(2**31) * 10**9, 2**31 * 10**9 - 1)
            )
        elif action == 6:
            more |= {"frame_id": rng.choice(("", "x" * 3000, "\0")), "little": rng.random() < 0.5}
        elif action == 7:
            more |= {"position": [math.nan] * rng.choice((1, 12, 5000)), "velocity": [1.0] * 12}
        else:
            order = list(range(min(len(names), len(efforts))))
            rng.shuffle(order)
            names = [names[i] for i in order]
    written = joint_state_bytes(stamp_ns, names, efforts, **more)
    if rng.random() < 0.2 and len(written) > _HEAD_BYTES:
        at = 4 * rng.randrange(1, len(written) // 4)
        written = written[:at] + struct.pack("<I", rng.getrandbits(32)) + written[at + 4 :]
    return written


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
        mechanism = mechanism_of(self.arm)
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

    @property
    def command_deg(self) -> list[float]:
        return np.rad2deg(self.estimation.gate.command_rad).tolist()

    def give(self, raw: bytes) -> Answer:
        self.now_ns += 10**7
        return self.estimation.sample(raw, self.now_ns, self.now_s)

    def judge(self, raw: bytes, outcome: Answer) -> None:
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
            np.array(tensions) - self.estimation.tares.unloaded_n,
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
            before = feed.command_deg
            message = _command(rng, bench.arm.joint_names)
            try:
                feed.estimation.command(message)
            except CableSenseError as error:
                require_one_line(error)
                refused += 1
                if feed.command_deg != before:
                    raise FalseAnswerError("a refused command counts") from error
            else:
                angles = dict(zip(message.name, message.position, strict=True))
                wanted = [math.degrees(angles[name]) for name in bench.arm.joint_names]
                if not np.allclose(feed.command_deg, wanted, atol=1e-9):
                    raise FalseAnswerError(f"{wanted} was taken for another command")
            outcome = feed.give(
                joint_state_bytes(feed.now_ns + 10**7, bench.arm.cable_names, bench.pushed[0])
            )
            moved = feed.command_deg != before
            if outcome.contact.segment and (moved or any(feed.command_deg)):
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
