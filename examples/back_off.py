"""A controller that backs off: above 20 N the arm turns in the direction in which it is pushed.

    python -m examples.back_off  # while `cablesense demo` runs, in its ROS_DOMAIN_ID

Each step turns the joints by a fixed gain times the joint torques of the contact. The estimator
gives no force while the arm moves fast, so the steps are small and slow. This one takes no notice
of an estimator that has died; `examples/admittance.py` does, and moves the arm smoothly.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

from sensor_msgs.msg import JointState

from examples.read_topics import ReadTopics, spin

THRESHOLD_N = 20.0
GAIN_RAD_PER_N_M = 0.004
LIMIT_RAD = math.radians(8.0)
EVERY_S = 1.0  # longer than a step and the time that the arm needs to settle


def next_command_rad(
    command_rad: Sequence[float], torques_n_m: Sequence[float], force_n: float
) -> list[float]:
    """The next joint angles (2N,) for the external joint torques (2N,) of a force."""
    gain = GAIN_RAD_PER_N_M if force_n > THRESHOLD_N else 0.0
    steps_rad = (gain * torque for torque in torques_n_m)
    return [
        min(max(angle + step, -LIMIT_RAD), LIMIT_RAD)
        for angle, step in zip(command_rad, steps_rad, strict=True)
    ]


class BackOff(ReadTopics):
    """Reads the estimator's topics, publishes `joint_commands`."""

    def __init__(self) -> None:
        super().__init__("back_off")
        self._command_rad: list[float] = []
        self._stepped_s = time.monotonic()
        self._out = self.create_publisher(JointState, "joint_commands", 10)
        self.listen(JointState, "estimator/joint_torques", self._on_torques)

    def _on_torques(self, message: JointState) -> None:
        if self.state != "contact" or time.monotonic() - self._stepped_s < EVERY_S:
            return
        command_rad = self._command_rad or [0.0] * len(message.name)
        next_rad = next_command_rad(command_rad, message.effort, self.force_n())
        if next_rad != command_rad:
            self._command_rad = next_rad
            self._stepped_s = time.monotonic()
            stamped = JointState(name=message.name, position=next_rad)
            stamped.header.stamp = self.get_clock().now().to_msg()
            self._out.publish(stamped)


if __name__ == "__main__":
    sys.exit(spin(BackOff))
