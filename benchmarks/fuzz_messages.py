"""Mutated serialized messages to the estimator: without ROS, and to a live node over Fast DDS.

Without ROS, an oracle reads each message by rosbags, which the estimator does not use. A contact
is right if the bytes are a message with every cable's plausible tension and a present stamp, and
if the model estimates that contact from those tensions; from anything else there must be none.

The live node's arm rests untouched, so every wrench must be zero: only messages that the oracle
calls broken are sent between the good ones, cut to whole words of four bytes, as DDS fills others
up with what lies in memory. At the end a push must be answered, and the node must end with exit
code 0 and no traceback.
"""

from __future__ import annotations

import math
import os
import random
import struct
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from fuzz_mutation import mutated_bytes
from fuzz_watched import FalseAnswerError, Outcome, Result, Run, item_random, require_one_line
from rosbags.typesys import Stores, get_typestore

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_online.estimation import Answer, Estimation
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_online.state import EstimationSettings
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

_KIND = "sensor_msgs/msg/JointState"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_DEFINITION = _STORE.get_msgdef(_KIND)
_HEAD_BYTES = 12

MESSAGES = 100
COMMANDS = 8
TARED_NS = 10**18
SETTINGS = EstimationSettings(
    contact_threshold=0.5,
    stale_after_s=0.2,
    slack_below_n=1.0,
    tare_samples=5,
    tare_steady_n=1.0,
    auto_tare=True,
    joint_speed_rad_s=0.35,
    settle_s=0.5,
)

PATIENCE_S = 30.0
PERIOD_S = 0.002
_NODE = "fuzzed_estimator"


class _Content(NamedTuple):
    """Of a message, as far as the estimator reads it."""

    stamp_ns: int
    names: tuple[str, ...]
    efforts: tuple[float, ...]


def _joint_state(
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


def _content(raw: bytes) -> _Content | None:
    """None where the bytes are no such message; more may stand behind it."""
    try:
        if raw[0] != 0 or raw[1] > 1:
            return None
        read = _DEFINITION.deserialize_cdr_le if raw[1] else _DEFINITION.deserialize_cdr_be
        message: Any = read(raw[4:], 0, _DEFINITION.cls, _STORE)[0]
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        content = _Content(stamp_ns, tuple(message.name), tuple(map(float, message.effort)))
    except Exception:  # whatever fails, it is no message
        return None
    return content if stamp.nanosec < 10**9 else None


def _plausible(content: _Content | None, cables: Sequence[str]) -> bool:
    """Whether a message holds a plausible tension of every cable, in any order."""
    low, high = PLAUSIBLE_N
    return (
        content is not None
        and sorted(content.names) == sorted(cables)
        and len(content.efforts) == len(content.names)
        and all(low < effort < high for effort in content.efforts)
    )


def _mutated_joint_state(
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
    written = _joint_state(stamp_ns, names, efforts, **more)
    if rng.random() < 0.2 and len(written) > _HEAD_BYTES:
        at = 4 * rng.randrange(1, len(written) // 4)
        written = written[:at] + struct.pack("<I", rng.getrandbits(32)) + written[at + 4 :]
    return written


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
            segment = 1 + row % self.arm.segment_count
            angle_deg, force_n = rng.uniform(0.0, 360.0), rng.uniform(5.0, 150.0)
            forces[row] = normal_force_n(mechanism, straight[0], segment, angle_deg, force_n)
        self.unloaded: Array = solve_equilibrium(mechanism, straight[0]).tensions_n
        self.pushed: Array = solve_equilibrium(mechanism, straight, forces).tensions_n


class _Feed:
    """An estimation that was tared, and the clock beside it."""

    def __init__(self, bench: _Bench) -> None:
        self.bench = bench
        self.estimation = Estimation(bench.arm, bench.estimator, SETTINGS, 0.0)
        self.now_ns = TARED_NS
        for _ in range(SETTINGS.tare_samples):
            self.now_ns += 10**7
            raw = _joint_state(self.now_ns, bench.arm.cable_names, bench.unloaded)
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
        content, order = _content(raw), self.bench.arm.cable_names
        if content is None or not _plausible(content, order):
            raise FalseAnswerError(f"a contact from no message of this arm: {raw.hex()[:400]}")
        tensions = [content.efforts[content.names.index(name)] for name in order]
        if content.stamp_ns and abs(content.stamp_ns - self.now_ns) > 0.2e9:
            raise FalseAnswerError(f"a contact from {content.stamp_ns - self.now_ns} ns ago")
        right = self.bench.reference.estimate(
            np.array(tensions) - self.estimation.tares.unloaded_n,
            np.zeros(self.bench.arm.joint_count),
        )
        if (right.angle_deg, right.magnitude_n) != (contact.angle_deg, contact.magnitude_n):
            raise FalseAnswerError(f"{contact} where the model estimates {right}")


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
            raw = _joint_state(stamp_ns, bench.arm.cable_names, tensions)
            if rng.random() < 0.67:
                mutated += 1
                raw = _mutated_joint_state(
                    rng, raw, bench.arm.cable_names, tensions.tolist(), stamp_ns
                )
            outcome = feed.give(raw)
            refused += outcome.problem is not None
            feed.judge(raw, outcome)
        feed.now_ns += 10**9
        raw = _joint_state(feed.now_ns + 10**7, bench.arm.cable_names, bench.pushed[0])
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
                    raise FalseAnswerError(f"{wanted} was read as another command")
            outcome = feed.give(
                _joint_state(feed.now_ns + 10**7, bench.arm.cable_names, bench.pushed[0])
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


def fuzz_live_node(seed: int, count: int) -> Result:
    """Send `count` broken messages to a live estimator node; what was found."""
    import rclpy  # only here, as the fuzzed children need no ROS

    from cablesense_ros.discovery import own_graph
    from cablesense_ros.processes import Process, node_command

    os.environ.update(own_graph())
    result = Result(items=count, refused=count)
    with tempfile.TemporaryDirectory() as folder:
        command = node_command("estimator", remaps={"__node": _NODE})
        node = Process(_NODE, command, Path(folder) / "node.log")
        rclpy.init()
        try:
            _send_broken(result, node, seed, count)
        finally:
            rclpy.shutdown()
            code, text = node.stop(PATIENCE_S), node.log
    if code != 0 or "Traceback" in text:
        result.count("crashes", f"{_NODE}: exit code {code}: {text[-600:]}")
    if "sample refused" not in text:
        result.count("false_answers", f"{_NODE}: its log has no line on refused samples")
    return result


def _send_broken(result: Result, process: Any, seed: int, count: int) -> None:
    """Good and broken messages by turns, then a push that must be answered."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    arm = open_arm("cdsm")
    mechanism, straight = mechanism_of(arm), np.zeros(arm.joint_count)
    unloaded_n = solve_equilibrium(mechanism, straight).tensions_n
    force_n = np.zeros((arm.segment_count, 3))
    force_n[2, 1] = 40.0
    pushed_n = solve_equilibrium(mechanism, straight, force_n).tensions_n
    node = rclpy.create_node("fuzzer")
    publisher = node.create_publisher(JointState, topics.CABLE_TENSIONS, 100)
    wrenches: list[Any] = []
    node.create_subscription(
        WrenchStamped, f"/{_NODE}/wrench", wrenches.append, qos_profile_sensor_data
    )

    def spin() -> None:
        for _ in range(4):
            rclpy.spin_once(node, timeout_sec=0.0)

    def send(raw: bytes) -> None:
        publisher.publish(raw)
        spin()
        time.sleep(PERIOD_S)

    def send_good(tensions_n: Array) -> None:
        send(_joint_state(time.time_ns(), arm.cable_names, tensions_n))

    def spin_until(ended: Callable[[], object], within_s: float) -> bool:
        end_s = time.monotonic() + within_s
        while not ended() and time.monotonic() < end_s:
            spin()
        return bool(ended())

    if not spin_until(publisher.get_subscription_count, PATIENCE_S):
        raise TimeoutError("waited in vain for the node")
    for _ in range(150):
        send_good(unloaded_n)
    wrenches.clear()
    started_s = time.monotonic()
    for number in range(count):
        send(_broken(item_random("live", seed, number), arm.cable_names, pushed_n))
        result.inputs += 1
        if number % 4 == 0:
            send_good(unloaded_n)
    result.longest_item_s = (time.monotonic() - started_s) / count
    touched = sum(wrench.header.frame_id.startswith("segment") for wrench in wrenches)
    if touched:
        result.count("false_answers", f"{_NODE}: {touched} wrenches that are not zero")
        result.false_answers += touched - 1
    spin_until(lambda: False, 0.5)  # until no stamp is ahead of the clock
    wrenches.clear()
    end_s = time.monotonic() + PATIENCE_S
    while not any(wrench.header.frame_id == "segment_3" for wrench in wrenches):
        if not process.alive or time.monotonic() > end_s:
            result.count("hangs", f"{_NODE}: answers no push after {count} messages")
            return
        send_good(pushed_n)


def _broken(rng: random.Random, cables: Sequence[str], tensions_n: Array) -> bytes:
    """A mutated message from which no contact may come."""
    while True:
        stamp_ns = time.time_ns()
        raw = _joint_state(stamp_ns, cables, tensions_n)
        raw = _mutated_joint_state(rng, raw, cables, tensions_n.tolist(), stamp_ns)
        raw = raw[: len(raw) // 4 * 4]
        content = _content(raw)
        if content is None or not _plausible(content, cables):
            return raw
        if content.stamp_ns and abs(content.stamp_ns - stamp_ns) > 0.5e9:
            return raw
