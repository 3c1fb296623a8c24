"""The sink: notes every sample and every wrench as bytes; all else is done after the run."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from harness import cpu_s, rss_mb
from numpy.typing import NDArray
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import Qos
from cablesense_ros.node_process import qos_profile

SINK_QOS = Qos(depth=5000, reliable=True)
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_FRAME_DIGIT_AT = 24  # after the stamp and a string's length: the last letter of segment_N
_FORCE_BYTES = 48


class Log:
    """Arrivals of one topic: `size` at most, in memory that is taken at once."""

    def __init__(self, size: int, tail_bytes: int) -> None:
        self.count = 0
        self.lost_at_sink = 0
        self._size = size
        self._tail_bytes = tail_bytes
        self._arrived_ns = np.zeros(size, dtype=np.int64)
        self._heads = bytearray(size * _STAMP.size)
        self._tails = bytearray(size * tail_bytes)
        self._digits = bytearray(size)

    def note(self, raw: bytes) -> None:
        """Keep the stamp and the last bytes, where the numbers stand."""
        at = self.count
        if at == self._size:
            return
        self._arrived_ns[at] = time.time_ns()
        self._heads[at * 8 : at * 8 + 8] = raw[_STAMP_AT : _STAMP_AT + 8]
        self._tails[at * self._tail_bytes : (at + 1) * self._tail_bytes] = raw[-self._tail_bytes :]
        self._digits[at] = raw[_FRAME_DIGIT_AT]
        self.count = at + 1

    def lost(self, event: QoSMessageLostInfo) -> None:
        """The middleware says that messages did not reach this process."""
        self.lost_at_sink += event.total_count_change

    @property
    def arrived_ns(self) -> NDArray[np.int64]:
        """(C,) when each came."""
        return self._arrived_ns[: self.count]

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(C,) what their headers say."""
        pairs = np.frombuffer(self._heads, dtype=[("sec", "<i4"), ("nanosec", "<u4")])
        pairs = pairs[: self.count]
        return pairs["sec"].astype(np.int64) * 1_000_000_000 + pairs["nanosec"]

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(C, n) the last numbers of each."""
        return np.frombuffer(self._tails, dtype="<f8").reshape(self._size, -1)[: self.count]

    @property
    def segments(self) -> NDArray[np.int64]:
        """(C,) the digit that ends the frame's name, 0 where there is none."""
        letters = np.frombuffer(self._digits, dtype=np.uint8)[: self.count].astype(np.int64)
        digits = letters - ord("0")
        return np.where((digits >= 0) & (digits <= 9), digits, 0)


class Sink(Node):
    """Listens to driver and estimator, and looks at the processes once a second.

    Attributes:
        memory: seconds since the start and MB of each process.
        values: the latest diagnostics: (name, key) to text.
    """

    def __init__(self, size: int, cable_count: int, processes: Mapping[str, int]) -> None:
        super().__init__("soak_sink")
        self.tensions = Log(size, 8 * cable_count)
        self.wrenches = Log(size, _FORCE_BYTES)
        self.values: dict[tuple[str, str], str] = {}
        self.memory: list[tuple[float, dict[str, float]]] = []
        self._processes = processes
        self._began_s = time.monotonic()
        self._cpu_began_s = {name: cpu_s(pid) for name, pid in processes.items()}
        for kind, topic, log in (
            (JointState, "cable_tensions", self.tensions),
            (WrenchStamped, "estimator/wrench", self.wrenches),
        ):
            self.create_subscription(
                kind,
                topic,
                log.note,
                qos_profile(SINK_QOS),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(message_lost=log.lost),
            )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self.create_timer(1.0, self._look)

    def begin(self) -> None:
        """What is counted from here on is the run."""
        self._began_s = time.monotonic()
        self._cpu_began_s = {name: cpu_s(pid) for name, pid in self._processes.items()}
        self.memory.clear()

    def cpu_share(self) -> dict[str, float]:
        """Cores that each process took since the beginning, on average."""
        elapsed_s = time.monotonic() - self._began_s
        return {
            name: (cpu_s(pid) - self._cpu_began_s[name]) / elapsed_s
            for name, pid in self._processes.items()
        }

    def _look(self) -> None:
        elapsed_s = time.monotonic() - self._began_s
        rss = {name: rss_mb(pid) for name, pid in self._processes.items()}
        self.memory.append((elapsed_s, rss))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.values.update({(status.name, v.key): v.value for v in status.values})
