"""Records the contract's topics of running nodes into one MCAP file."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Int32

from cablesense_gap.recordings.bag_rows import BagRows
from cablesense_gap.recordings.bag_writer import BagWriter
from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.qos_profiles import overridable, qos_profile
from cablesense_ros.throttled_log import ThrottledLog
from cablesense_sim.arm import Arm

SILENT_AFTER_S = 3.0
"""A topic that has said nothing for this long from the start is worth a word."""

_HINTS = {
    topics.CABLE_TENSIONS: "is the arm's driver or the sim node running, in this ROS_DOMAIN_ID "
    "and without a namespace?",
    topics.JOINT_COMMANDS: "publish the command once more, also for a straight arm: samples "
    "before the first command are of no use",
}


class Recorder:
    """Subscribes a node to the contract's topics, and writes what comes until it is closed.

    With an arm, messages that break its contract are logged and left out.
    """

    def __init__(
        self, node: Node, path: str | Path, arm: Arm | None, say: Callable[[str], object]
    ) -> None:
        """`say` takes a line for people.

        Raises:
            RecordingError: the file exists already, or cannot be written.
        """
        self._path = Path(path)
        if self._path.exists():
            raise RecordingError(f"{path}: exists already; give another name, or move it away")
        self._bag = BagWriter(path)
        self._node = node
        self._say = say
        self._warn = ThrottledLog(say, time.monotonic)
        self._contract = None if arm is None else BagRows(arm, keep=False)
        self._started_s = time.monotonic()
        self._hinted: set[str] = set()
        self.counts: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self._listen(JointState, topics.CABLE_TENSIONS, qos.SENSOR, self._on_tensions)
        self._listen(JointState, topics.JOINT_COMMANDS, qos.COMMAND, self._on_command)
        self._listen(WrenchStamped, topics.APPLIED_WRENCH, qos.COMMAND, self._on_load)
        self._listen(Int32, topics.TRIAL, qos.COMMAND, self._on_trial)

    @property
    def status(self) -> str:
        """One line: how long, and how much of what."""
        elapsed_s = time.monotonic() - self._started_s
        parts = [f"{elapsed_s:.0f} s"]
        for topic in (topics.CABLE_TENSIONS, topics.JOINT_COMMANDS, topics.APPLIED_WRENCH):
            count, refused = self.counts[topic], self.refused[topic]
            left_out = f" ({refused} left out)" if refused else ""
            parts.append(f"{topic} {count or 'nothing yet'}{left_out}")
        return " · ".join(parts)

    def hint_at_silence(self) -> None:
        """Say once of each topic that nothing has come, and what may help."""
        if time.monotonic() - self._started_s < SILENT_AFTER_S:
            return
        for topic, hint in _HINTS.items():
            if not self.counts[topic] and topic not in self._hinted:
                self._hinted.add(topic)
                self._say(f"nothing on {topic} so far: {hint}")

    def close(self) -> None:
        """Finish the file.

        Raises:
            RecordingError: nothing worth a file came, or it cannot be written.
        """
        if self.counts[topics.CABLE_TENSIONS]:
            self._bag.close()
            return
        self._bag.discard()
        took_s = time.monotonic() - self._started_s
        raise RecordingError(
            f"nothing on {topics.CABLE_TENSIONS} in {took_s:.0f} s, and so no file; "
            f"{_HINTS[topics.CABLE_TENSIONS]}"
        )

    def _listen(
        self, kind: type, topic: str, profile: qos.Qos, write: Callable[[int, Any], None]
    ) -> None:
        self._node.create_subscription(
            kind,
            topic,
            partial(self._take, topic, write),
            qos_profile(profile),
            qos_overriding_options=overridable(),
        )

    def _take(self, topic: str, write: Callable[[int, Any], None], message: Any) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        try:
            if self._contract is not None:
                self._contract.take(topic, now_ns, message)
        except CableSenseError as error:
            self.refused[topic] += 1
            self._warn(topic, f"{topic}: left out: {error}")
            return
        write(now_ns, message)
        self.counts[topic] += 1

    def _on_tensions(self, now_ns: int, message: Any) -> None:
        self._bag.tensions(now_ns, _stamp_ns(message), message.name, message.effort)

    def _on_command(self, now_ns: int, message: Any) -> None:
        self._bag.command(now_ns, _stamp_ns(message), message.name, message.position)

    def _on_load(self, now_ns: int, message: Any) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        self._bag.load(
            now_ns,
            _stamp_ns(message),
            message.header.frame_id,
            (force.x, force.y, force.z),
            (torque.x, torque.y, torque.z),
        )

    def _on_trial(self, now_ns: int, message: Any) -> None:
        self._bag.trial(now_ns, message.data)


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)
