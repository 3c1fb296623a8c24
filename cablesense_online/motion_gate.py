"""The commanded pose, and whether the arm may still be moving towards it."""

from __future__ import annotations

import numpy as np

from cablesense_base.arrays import Array
from cablesense_msgs_py.messages import Level, Status
from cablesense_sim.joint_motion import move_duration_s

_LONG_AGO_NS = -(2**62)


class MotionGate:
    """Shut from a changed command until the arm must have arrived and come to rest.

    How far the joints have got is not known, only what they were commanded: while moving, any
    angle between the commands since the last rest counts as possible, and the longest way from
    there is waited for.

    Time is that of the samples' stamps, so that a recording has the same answers: a command counts
    from the first sample after it. Where stamps step back, what is left to wait is kept.

    Attributes:
        command_rad: (2N,) the command in force.
        lowest_rad, highest_rad: (2N,) angles that count as possible until the arm rests.
        rest_from_ns: stamp from which on the arm rests, as known at the last sample.
        stepped_back: whether the last sample's stamp lay before that of the one before it.
    """

    def __init__(self, command_rad: Array, joint_speed_rad_s: float, settle_s: float) -> None:
        """At rest at `command_rad` (2N,); `settle_s` is waited after each arrival."""
        self._speed_rad_s, self._settle_s = joint_speed_rad_s, settle_s
        self.command_rad = self.lowest_rad = self.highest_rad = command_rad.copy()
        self.rest_from_ns = self._last_ns = _LONG_AGO_NS
        self._starting = self.stepped_back = False

    def command(self, command_rad: Array) -> bool:
        """Take over a command (2N,); gives whether it differs from the one before."""
        if np.array_equal(command_rad, self.command_rad):
            return False
        if not self.shut:
            self.lowest_rad = self.highest_rad = self.command_rad
        self.command_rad = command_rad.copy()
        self.lowest_rad = np.minimum(self.lowest_rad, command_rad)
        self.highest_rad = np.maximum(self.highest_rad, command_rad)
        self._starting = True
        return True

    def moving(self, stamp_ns: int) -> bool:
        """Whether the arm may still move, or swing, at the next sample's stamp."""
        self.stepped_back = stamp_ns < self._last_ns
        if self.stepped_back:
            self.rest_from_ns -= self._last_ns - stamp_ns
        self._last_ns = stamp_ns
        if self._starting:
            self._starting = False
            turn = max(
                float((self.highest_rad - self.command_rad).max()),
                float((self.command_rad - self.lowest_rad).max()),
            )
            wait_s = move_duration_s(turn, self._speed_rad_s) + self._settle_s
            self.rest_from_ns = stamp_ns + round(wait_s * 1e9)
        return stamp_ns < self.rest_from_ns

    @property
    def shut(self) -> bool:
        """Whether the arm may have moved at the last sample, or was commanded since."""
        return self._starting or self._last_ns < self.rest_from_ns

    def restore(
        self, command_rad: Array, lowest_rad: Array, highest_rad: Array, rest_from_ns: int
    ) -> None:
        """Continue from the attributes of another gate, as they were at a sample."""
        self.command_rad = command_rad
        self.lowest_rad, self.highest_rad = lowest_rad, highest_rad
        self.rest_from_ns, self._last_ns = rest_from_ns, _LONG_AGO_NS
        self._starting = False

    def status(
        self, pose_range_deg: float, refused: int, *, received: bool, in_motion: bool
    ) -> Status:
        """What is known of the arm's pose, for a model that was trained within ± `pose_range_deg`.

        `refused` commands since the last report; `received`: whether any has come; `in_motion`:
        whether the model estimates while the arm moves.
        """
        command_deg = np.rad2deg(self.command_rad).tolist()
        values = {
            "commands refused": str(refused),
            "command (deg)": ", ".join(f"{angle:.2f}" for angle in command_deg),
        }
        level, message = Level.OK, "at rest"
        if refused:
            level, message = Level.ERROR, "a command was refused; see the log"
        elif self.shut:
            message = "moving" if in_motion else "moving: no estimate until the arm rests"
        elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
            level = Level.WARN
            message = f"beyond the poses of the model's training (±{pose_range_deg:g} degrees)"
        elif not received:
            level, message = Level.WARN, "none received: arm assumed to be straight"
        return Status("joint_commands", level, message, values)
