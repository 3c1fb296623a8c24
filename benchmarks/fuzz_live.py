"""Broken messages to a live estimator node over Fast DDS.

Its arm rests untouched, so every wrench must be zero: only messages that the oracle calls broken
are sent between the good ones, cut to whole words of four bytes, as DDS fills others up with what
lies in memory. At the end a push must be answered, and the node must end with exit code 0.
"""

from __future__ import annotations

import random
import time

from fuzz_messages import content_of, joint_state, mutated_joint_state, rig
from fuzz_watched import Result, item_random
from geometry_msgs.msg import WrenchStamped
from live_run import LiveRun, SpunNode
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_ros.processes import node_command

PERIOD_S = 0.002
NODE = "fuzzed_estimator"


def fuzz_live_node(seed: int, count: int) -> Result:
    """Send `count` broken messages to a live estimator node; what was found."""
    result = Result(items=count, inputs=count, refused=count)
    _, unloaded_n, pushed_n = rig()
    frames: list[str] = []
    with LiveRun() as run:
        process = run.start(NODE, node_command("estimator", remaps={"__node": NODE}))
        node = SpunNode("fuzzer")
        publisher = node.create_publisher(JointState, topics.CABLE_TENSIONS, 100)

        def note(wrench: WrenchStamped) -> None:
            frames.append(wrench.header.frame_id)

        node.create_subscription(WrenchStamped, f"/{NODE}/wrench", note, qos_profile_sensor_data)

        def send(raw: bytes) -> None:
            publisher.publish(raw)
            node.spin(PERIOD_S)

        def push_answered() -> bool:
            send(joint_state(time.time_ns(), pushed_n[2]))
            return "segment_3" in frames

        node.spin_until(publisher.get_subscription_count, "the node")
        for _ in range(150):
            send(joint_state(time.time_ns(), unloaded_n))
        frames.clear()
        started_s = time.monotonic()
        for number in range(count):
            send(_broken(item_random("live", seed, number), pushed_n[2]))
            if number % 4 == 0:
                send(joint_state(time.time_ns(), unloaded_n))
        result.longest_item_s = (time.monotonic() - started_s) / count
        if touched := sum(frame.startswith("segment") for frame in frames):
            result.count("false_answers", f"{NODE}: {touched} wrenches that are not zero")
            result.false_answers += touched - 1
        node.spin(0.5)  # until no stamp is ahead of the clock
        try:
            node.spin_until(push_answered, "the answer to a push")
        except TimeoutError:
            result.count("hangs", f"{NODE}: answers no push after {count} messages")
        node.destroy_node()
        code, text = run.stop()[NODE], process.log
    if code != 0 or "Traceback" in text:
        result.count("crashes", f"{NODE}: exit code {code}: {text[-600:]}")
    if "sample refused" not in text:
        result.count("false_answers", f"{NODE}: its log has no line on refused samples")
    return result


def _broken(rng: random.Random, tensions_n: Array) -> bytes:
    """A mutated message from which no contact may come."""
    while True:
        stamp_ns = time.time_ns()
        raw = mutated_joint_state(rng, stamp_ns, tensions_n)
        raw = raw[: len(raw) // 4 * 4]
        content = content_of(raw)
        if content is None or not content.plausible:
            return raw
        if content.stamp_ns and abs(content.stamp_ns - stamp_ns) > 0.5e9:
            return raw
