"""The commanded pose, and whether the arm may still be moving towards it."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Level, Status
from cablesense_sim.joint_motion import move_duration_s

_LONG_AGO_NS = -(2**62)
_CLOCK_JITTER_S = 0.02
"""Between the clock of the stamps and the monotonic one; by more the first has been set."""


class MotionGate:
    """Shut from a changed command until the arm must have arrived and come to rest.

    How far the joints have got is not known, only what they were commanded: while moving, any
    angle between the commands since the last rest counts as possible, and the longest way from
    there is waited for.

    Time is that of the samples' stamps, so that a recording has the same answers: a command counts
    from the first sample after it. Where stamps step back, what is left to wait is kept. Where
    they step forward, it is waited for by the monotonic clock of their arrival.

    Attributes:
        command_rad: (2N,) the command in force.
        lowest_rad, highest_rad: (2N,) angles that count as possible until the arm rests.
        rest_from_ns: stamp from which on the arm rests, as known at the last sample.
        step: 1 where the stamps had stepped forward at the last sample, -1 where back, else 0.
        shortened_s: by how much the wait of a restored state was cut down to one of a move.
    """

    def __init__(self, command_rad: Array, joint_speed_rad_s: float, settle_s: float) -> None:
        """At rest at `command_rad` (2N,); `settle_s` is waited after each arrival."""
        self._speed_rad_s, self._settle_s = joint_speed_rad_s, settle_s
        self.command_rad = self.lowest_rad = self.highest_rad = command_rad.copy()
        self.rest_from_ns = self._last_ns = _LONG_AGO_NS
        self._rest_from_s = 0.0
        self._starting = self._resting = False
        self.step = 0
        self.shortened_s = 0.0

    def command(self, command_rad: Array) -> bool:
        """Take over a command (2N,); gives whether it differs from the one before."""
        if np.array_equal(command_rad, self.command_rad):
            return False
        if not self.shut:
            self.lowest_rad = self.highest_rad = self.command_rad
        self.command_rad = command_rad.copy()
        self.lowest_rad = np.minimum(self.lowest_rad, command_rad)
        self.highest_rad = np.maximum(self.highest_rad, command_rad)
        self._starting, self._resting, self.shortened_s = True, False, 0.0
        return True

    def wait_anew(self) -> None:
        """From the next sample on wait as after a command to where the arm is commanded now."""
        if not self.shut:
            self.lowest_rad = self.highest_rad = self.command_rad
        self._starting, self._resting = True, False

    def moving(self, stamp_ns: int, now_ns: int, now_s: float) -> bool:
        """Whether the arm may still move, or swing, at the next sample's stamp.

        The sample comes at `now_ns` of the clock that sets stamps, at monotonic time `now_s`.
        """
        if self._resting and stamp_ns >= self._last_ns:
            self._last_ns = stamp_ns
            return False
        self.step, self._resting = 0, False
        first, last_ns = self._last_ns == _LONG_AGO_NS, self._last_ns
        if stamp_ns < last_ns:
            self.rest_from_ns -= last_ns - stamp_ns
            self.step = -1
        self._last_ns = stamp_ns
        if first or self._starting:
            latest_ns = stamp_ns + self._longest_wait_ns()
            if first and self.rest_from_ns > latest_ns:
                self.shortened_s = (self.rest_from_ns - latest_ns) * 1e-9
            if self._starting or self.shortened_s:
                self.rest_from_ns = latest_ns
            self._starting = False
            sampled_s = now_s - max(0, now_ns - stamp_ns) * 1e-9
            self._rest_from_s = sampled_s + (self.rest_from_ns - stamp_ns) * 1e-9
        if stamp_ns < self.rest_from_ns:
            return True
        left_s = self._rest_from_s - now_s
        if left_s <= _CLOCK_JITTER_S:
            self._resting = not self.step
            return False
        self.rest_from_ns = stamp_ns + round(left_s * 1e9)
        self.step = 1
        return True

    @property
    def shut(self) -> bool:
        """Whether the arm may have moved at the last sample, or was commanded since."""
        return self._starting or self._last_ns < self.rest_from_ns

    def restore(
        self, command_rad: Array, lowest_rad: Array, highest_rad: Array, rest_from_ns: int
    ) -> None:
        """Continue from the attributes of another gate, as they were at a sample.

        No longer is waited than for a move between these angles.
        """
        self.command_rad = command_rad
        self.lowest_rad = np.minimum(lowest_rad, command_rad)
        self.highest_rad = np.maximum(highest_rad, command_rad)
        self.rest_from_ns, self._last_ns = rest_from_ns, _LONG_AGO_NS
        self._starting, self._resting, self.shortened_s = False, False, 0.0

    def _longest_wait_ns(self) -> int:
        turn = max(
            float((self.highest_rad - self.command_rad).max()),
            float((self.command_rad - self.lowest_rad).max()),
        )
        return round((move_duration_s(turn, self._speed_rad_s) + self._settle_s) * 1e9)

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
        if self.shortened_s:
            values["wait of the state file cut by (s)"] = f"{self.shortened_s:.3f}"
        level, message = Level.OK, "at rest"
        if refused:
            level, message = Level.ERROR, "a command was refused; see the log"
        elif self.shortened_s:
            level = Level.WARN
            message = (
                f"the state file's rest lay {self.shortened_s:.0f} s further ahead than a move "
                "takes (was a clock set?); no longer than for a move was waited"
            )
        elif self.shut:
            message = "moving" if in_motion else "moving: no estimate until the arm rests"
        elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
            level = Level.WARN
            message = f"beyond the poses of the model's training (±{pose_range_deg:g} degrees)"
        elif not received:
            level, message = Level.WARN, "none received: arm assumed to be straight"
        return Status("joint_commands", level, message, values)
