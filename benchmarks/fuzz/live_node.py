"""Mutated messages over real Fast DDS to a live estimator node.

The arm rests untouched, so every wrench must be zero: only messages that the oracle calls broken
are sent between the good ones. They are of whole words of four bytes: others DDS fills up with
what happens to lie there, be it the end of the message before. At the end a push must be answered,
and the node must end by itself with exit code 0 and no traceback.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_msgs_py import topics
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_ros.discovery import own_graph
from cablesense_ros.processes import Process, node_command
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from fuzz.messages import joint_state_bytes, mutated_joint_state, read_joint_state
from fuzz.watched import Result, item_random

PATIENCE_S = 30.0
PERIOD_S = 0.002
_NODE = "fuzzed_estimator"


def fuzz_live_node(seed: int, count: int) -> Result:
    """Send `count` broken messages; what was found."""
    os.environ.update(own_graph())
    import rclpy

    result = Result(items=count)
    with tempfile.TemporaryDirectory() as folder:
        command = node_command("estimator", remaps={"__node": _NODE})
        node = Process(_NODE, command, Path(folder) / "node.log")
        rclpy.init()
        try:
            _Fuzzer(result, node).run(seed, count)
        finally:
            rclpy.shutdown()
            code, text = node.stop(PATIENCE_S), node.log
    result.refused = count
    if code != 0 or "Traceback" in text:
        result.crashes += 1
        result.findings.append(f"{_NODE}: exit code {code}: {text[-600:]}")
    if "sample refused" not in text:
        result.false_answers += 1
        result.findings.append(f"{_NODE}: its log has no line on refused samples")
    return result


class _Fuzzer:
    def __init__(self, result: Result, node: Process) -> None:
        from geometry_msgs.msg import WrenchStamped
        from rclpy.node import Node
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self._result, self._process = result, node
        self._arm = open_arm("cdsm")
        mechanism = mechanism_of(self._arm)
        straight = np.zeros(self._arm.joint_count)
        self._rest_n = solve_equilibrium(mechanism, straight).tensions_n
        force = np.zeros((self._arm.segment_count, 3))
        force[2, 1] = 40.0
        self._pushed_n = solve_equilibrium(mechanism, straight, force).tensions_n
        self._node = Node("fuzzer")
        self._tensions = self._node.create_publisher(JointState, topics.CABLE_TENSIONS, 100)
        self._wrenches: list[Any] = []
        self._node.create_subscription(
            WrenchStamped, f"/{_NODE}/wrench", self._wrenches.append, qos_profile_sensor_data
        )

    def run(self, seed: int, count: int) -> None:
        """Good and broken messages by turns, then a push that must be answered."""
        self._until(self._tensions.get_subscription_count, "the node")
        for _ in range(150):
            self._send(self._good(self._rest_n))
        self._wrenches.clear()
        started_s = time.monotonic()
        for number in range(count):
            self._send(self._broken(seed, number))
            self._result.inputs += 1
            if number % 4 == 0:
                self._send(self._good(self._rest_n))
        self._result.longest_item_s = (time.monotonic() - started_s) / count
        touched = [w for w in self._wrenches if w.header.frame_id.startswith("segment")]
        if touched:
            self._result.false_answers += len(touched)
            self._result.findings.append(f"{_NODE}: {len(touched)} wrenches that are not zero")
        self._wait_out_stamps_ahead()
        self._wrenches.clear()
        end_s = time.monotonic() + PATIENCE_S
        while not any(w.header.frame_id == "segment_3" for w in self._wrenches):
            if not self._process.alive or time.monotonic() > end_s:
                self._result.hangs += 1
                self._result.findings.append(f"{_NODE}: answers no push after {count} messages")
                return
            self._send(self._good(self._pushed_n))

    def _wait_out_stamps_ahead(self) -> None:
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            self._spin()

    def _good(self, tensions_n: Any) -> bytes:
        return joint_state_bytes(time.time_ns(), self._arm.cable_names, tensions_n)

    def _broken(self, seed: int, number: int) -> bytes:
        rng = item_random("live", seed, number)
        while True:
            stamp_ns = time.time_ns()
            raw = joint_state_bytes(stamp_ns, self._arm.cable_names, self._pushed_n)
            raw = mutated_joint_state(
                rng, raw, self._arm.cable_names, self._pushed_n.tolist(), stamp_ns
            )
            raw = raw[: len(raw) // 4 * 4]
            read = read_joint_state(raw)
            if read is None or sorted(read.names) != sorted(self._arm.cable_names):
                return raw
            low, high = PLAUSIBLE_N
            plausible = all(low < effort < high for effort in read.efforts)
            if len(read.efforts) != len(read.names) or not plausible:
                return raw
            if read.stamp_ns and abs(read.stamp_ns - stamp_ns) > 0.5e9:
                return raw

    def _send(self, raw: bytes) -> None:
        self._tensions.publish(raw)
        self._spin()
        time.sleep(PERIOD_S)

    def _spin(self) -> None:
        import rclpy

        for _ in range(4):
            rclpy.spin_once(self._node, timeout_sec=0.0)

    def _until(self, condition: Any, what: str) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > end_s:
                raise TimeoutError(f"waited in vain for {what}")
            self._spin()
            time.sleep(0.02)
