"""Quality of service by purpose, as plain values without rclpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Qos:
    """What a publisher offers or a subscriber asks for; history is always keep-last `depth`.

    Attributes:
        depth, reliable, transient_local: as in ROS.
        lease_s: a publisher whose process shows no sign of life for so long counts as dead with
            those subscribers that ask for a lease as well (liveliness, automatic); 0 for none.
    """

    depth: int
    reliable: bool
    transient_local: bool = False
    lease_s: float = 0.0


PUBLISHER: Final = Qos(depth=10, reliable=True)
"""Every output: the system default, so that reliable and best-effort subscribers both match."""

WRENCH: Final = Qos(depth=10, reliable=True, lease_s=0.05)
"""The estimator's answer: as every output, and a subscriber that asks for a liveliness lease of
0.05 s or more is notified by its own middleware when the estimator's process has died."""

SENSOR: Final = Qos(depth=500, reliable=False)
"""High-rate input: sensor data, best effort. Half a second at 1 kHz, so that no pause of a
process loses a sample; ROS's own sensor profile keeps five."""

COMMAND: Final = Qos(depth=10, reliable=True)
"""Commands and loads: rare, and none may be lost."""

LATCHED: Final = Qos(depth=1, reliable=True, transient_local=True)
"""What a late subscriber must still receive: the robot description."""

JOURNAL: Final = Qos(depth=100, reliable=True, transient_local=True)
"""The estimator's journal: a recorder that comes late gets the latest entries too."""
