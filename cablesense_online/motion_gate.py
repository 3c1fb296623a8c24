"""The commanded pose, whether the arm may still be moving towards it, and where it is by then.

Controllers stream commands that differ in the last digit, or turn slowly. Such a motion is
followed: the arm passes from rest to rest along the set-points between the commands
(`joint_motion`), and only what is faster shuts the gate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Level, Status
from cablesense_sim.joint_motion import SHORTEST_MOVE_S, JointMotion, move_duration_s

_POSE_STEPS_RAD = (1e-4, 2e-3)
"""How far a set-point at rest, or on its way, is from the pose before the pose goes with it: a new
pose costs milliseconds."""
_BLIND_S = 3.0
"""Without an estimate for so long, and with commands that go on, a warning is due."""
_SOME_COMMANDS = 3
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

    A command shuts the gate unless it is within `still_rad` of the pose, or the arm is to follow
    at `follow_rad_s` at most: the joints turn no faster, and the command is no farther ahead of
    them than such a motion is in the time of the shortest move.

    Attributes:
        command_rad: (2N,) the command in force.
        pose_rad: (2N,) which estimates at rest are of: the command, or a set-point on the way of
            a motion that is followed; another array whenever it has changed.
        angles_rad: (2N,) the set-point at the last sample, within a few mrad of the pose.
        lowest_rad, highest_rad: (2N,) angles that count as possible until the arm rests.
        rest_from_ns: stamp from which on the arm rests, as known at the last sample.
        step: 1 where the stamps had stepped forward at the last sample, -1 where back, else 0.
        shortened_s: by how much the wait of a restored state was cut down to one of a move.
    """

    def __init__(
        self,
        command_rad: Array,
        joint_speed_rad_s: float,
        settle_s: float,
        still_rad: float = 0.0,
        follow_rad_s: float = 0.0,
    ) -> None:
        """At rest at `command_rad` (2N,); `settle_s` is waited after each arrival."""
        self._speed_rad_s, self._settle_s = joint_speed_rad_s, settle_s
        self._still_rad, self._follow_rad_s = still_rad, follow_rad_s
        self._course = JointMotion(command_rad, joint_speed_rad_s)
        self._heading, self._course_from_ns = False, 0
        self._blind_since_ns: int | None = None
        self._commands_since = 0
        self.command_rad = self.lowest_rad = self.highest_rad = command_rad.copy()
        self.pose_rad = self.angles_rad = self.command_rad
        self.rest_from_ns = self._last_ns = _LONG_AGO_NS
        self._turned_ns = 2 * _LONG_AGO_NS
        self._rest_from_s = 0.0
        self._starting = self._resting = False
        self.step = 0
        self.shortened_s = 0.0

    def command(self, command_rad: Array) -> bool:
        """Take over a command (2N,); gives whether it differs from the one before."""
        if np.array_equal(command_rad, self.command_rad):
            return False
        followed = self.follows(command_rad)
        if not self.shut:
            self.lowest_rad = self.highest_rad = self.command_rad
        self.command_rad = command_rad.copy()
        self.lowest_rad = np.minimum(self.lowest_rad, command_rad)
        self.highest_rad = np.maximum(self.highest_rad, command_rad)
        self._heading, self._resting = True, False
        self._commands_since += 1
        if not followed:
            self._starting, self.shortened_s = True, 0.0
        return True

    def follows(self, command_rad: Array) -> bool:
        """Whether a command (2N,) would be followed with the gate as it is."""
        if float(np.abs(command_rad - self.pose_rad).max()) <= self._still_rad and not self.shut:
            return True
        if not self._follow_rad_s:
            return False
        angle, speed, _ = self._course.state
        ahead_rad = float(np.abs(command_rad - angle).max())
        return (
            ahead_rad <= self._follow_rad_s * SHORTEST_MOVE_S
            and float(np.abs(speed).max()) <= self._follow_rad_s
        )

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
        shut = self._may_move(stamp_ns, now_ns, now_s)
        course = self._course
        if course.moving:
            course.at(max(0, stamp_ns - self._course_from_ns) * 1e-9)
        if self._heading:
            course.go_to(self.command_rad)
            self._heading, self._course_from_ns = False, stamp_ns
        self._resting &= not course.moving
        if not shut:
            self._pose_at(course.state[0] if course.moving else self.command_rad)
        return shut

    def _pose_at(self, angles_rad: Array) -> None:
        off_rad = float(np.abs(angles_rad - self.pose_rad).max())
        if self._follow_rad_s or off_rad > self._still_rad:
            self.angles_rad = angles_rad
            if off_rad > self._still_rad and self._course.moving:  # after a wait it has settled
                self._turned_ns = self._last_ns
            if off_rad > _POSE_STEPS_RAD[self._course.moving]:
                self.pose_rad = angles_rad

    @property
    def turning(self) -> bool:
        """Whether the joints have turned within the time in which the arm settles."""
        return self._last_ns - self._turned_ns <= self._settle_s * 1e9

    def estimated(self, known: bool) -> None:
        """Whether there was an estimate of the last sample; none for long is reported."""
        if known:
            self._blind_since_ns, self._commands_since = None, 0
        elif self._blind_since_ns is None:
            self._blind_since_ns = self._last_ns

    def _may_move(self, stamp_ns: int, now_ns: int, now_s: float) -> bool:
        self.step, self._resting = 0, False
        first, last_ns = self._last_ns == _LONG_AGO_NS, self._last_ns
        if stamp_ns < last_ns:
            self.rest_from_ns -= last_ns - stamp_ns
            self._course_from_ns -= last_ns - stamp_ns
            self.step = -1
        self._last_ns = stamp_ns
        if first or self._starting:
            latest_ns = stamp_ns + self._longest_wait_ns(restored=not self._starting)
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

    @property
    def course(self) -> tuple[float, ...]:
        """The set-points to come, for `restore`; empty where the pose is the command."""
        still = self.pose_rad is self.command_rad and not self._course.moving
        return () if still else (*self.pose_rad.tolist(), *self._course.course)

    def restore(
        self,
        command_rad: Array,
        lowest_rad: Array,
        highest_rad: Array,
        rest_from_ns: int,
        course: Sequence[float] = (),
        at_ns: int = 0,
    ) -> None:
        """Continue from the attributes of another gate, as they were at a sample stamped `at_ns`.

        No longer is waited than for a move between these angles.
        """
        self.command_rad = self.pose_rad = self.angles_rad = command_rad
        self._course, self._heading = JointMotion(command_rad, self._speed_rad_s), False
        if course:
            joints = len(command_rad)
            self.pose_rad = np.array(course[:joints])
            self.angles_rad = command_rad.copy()  # the next sample's are others
            self._course.resume(course[joints:])
            self._course_from_ns = at_ns - round(course[joints] * 1e9)
        self.lowest_rad = np.minimum(lowest_rad, command_rad)
        self.highest_rad = np.maximum(highest_rad, command_rad)
        self.rest_from_ns, self._last_ns = rest_from_ns, _LONG_AGO_NS
        self._starting, self._resting, self.shortened_s = False, False, 0.0

    @property
    def _blind_s(self) -> float:
        """For how long there has been no estimate, where more than one command came since."""
        if self._blind_since_ns is None or self._commands_since < _SOME_COMMANDS:
            return 0.0
        return (self._last_ns - self._blind_since_ns) * 1e-9

    def _longest_wait_ns(self, *, restored: bool) -> int:
        """Of a move to the command; of a `restored` gate's to any that was since the last rest."""
        ends = (self.highest_rad, self.lowest_rad) if restored else (self.command_rad,) * 2
        turn = max(
            float((self.highest_rad - ends[1]).max()), float((ends[0] - self.lowest_rad).max())
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
        elif (blind_s := self._blind_s) > _BLIND_S and not in_motion:
            level = Level.WARN
            message = (
                f"moving: no estimate for {blind_s:.0f} s, as commands go on that are faster than "
                f"{np.rad2deg(self._follow_rad_s):g} deg/s (follow_deg_s), or the arm lags behind "
                "them; a model with memory estimates in motion (cablesense train --network "
                "temporal)"
            )
        elif self.shut:
            message = "moving" if in_motion else "moving: no estimate until the arm rests"
        elif self.turning:
            message = "moving slowly: its set-points are followed"
        elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
            level = Level.WARN
            message = f"beyond the poses of the model's training (±{pose_range_deg:g} degrees)"
        elif not received:
            level, message = Level.WARN, "none received: arm assumed to be straight"
        return Status("joint_commands", level, message, values)
