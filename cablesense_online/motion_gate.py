"""The commanded pose, whether the arm may still be moving towards it, and its pose on the way.

Controllers stream commands that differ in the last digit, or turn slowly. Such a motion is
followed along the set-points between the commands (`joint_motion`). Only faster ones shut the
gate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.settings import EstimationSettings
from cablesense_sim.joint_motion import SHORTEST_MOVE_S, JointMotion

_POSE_STEP_RAD = 2e-3
"""The pose follows a set-point in motion only beyond this distance: a new pose costs
milliseconds."""
_BLIND_S = 3.0
_SOME_COMMANDS = 3
"""A warning is due after this time without an estimate, if this number of commands came."""
_KEPT = 0.8
_NOISE = 0.5
"""Changes of the command are averaged, and each new average keeps the first share of the last one.
Changes by noise cancel: their mean is less than the second share of their mean size."""
_ROUNDING_S = 1e-6
"""Waits that differ by less are the same: stamps are whole nanoseconds."""
_SETTLED = 3.0
_SWINGS = 2.0
"""A swing falls to a twentieth within `settle_s`, and is forgotten after twice that time."""
_CLOCK_JITTER_S = 0.02
"""Between the stamps' clock and the monotonic one; a larger difference means a clock was set."""


LONG_AGO_NS: Final = -(2**62)
"""A stamp before all others."""
_NONE: Final = np.zeros(0)


@dataclass
class GateState:
    """Where the arm may be on its way to the command in force.

    Attributes:
        command_rad: (2N,) the command in force.
        pose_rad: (2N,) pose of the estimates: the command, or a set-point of a followed motion.
        rest_from_ns: stamp from which on the arm rests.
        course_from_ns: the stamp at which a motion of the set-points began.
        turned_ns: stamp at which the last turn beyond `still_rad` arrives.
        swing_rad_s2, swung_ns: (2N,) accelerations with which the arm swung at a stamp; empty
            where it has not moved.
        net_turn_rad, turns_rad: averages of the latest changes of the command (2N,), and of their
            sizes.
    """

    command_rad: Array
    pose_rad: Array
    rest_from_ns: int
    course_from_ns: int = 0
    turned_ns: int = LONG_AGO_NS
    swing_rad_s2: Array = field(default_factory=lambda: _NONE)
    swung_ns: int = LONG_AGO_NS
    net_turn_rad: Array = field(default_factory=lambda: _NONE)
    turns_rad: float = 0.0


class MotionGate:
    """Shut from a changed command until its set-points have arrived, and then for `settle_s`.

    Time is that of the samples' stamps, so that a recording has the same answers: a command counts
    from the first sample after it. If stamps step back, the remaining wait is kept. If they step
    forward, it is timed by the monotonic clock of their arrival.

    A command shuts the gate unless it is within `still_rad` of the pose, or the arm is to follow
    at `follow_rad_s` at most: the joints turn no faster, and the command is no farther ahead of
    them than such a motion gets in the time of the shortest move.

    Attributes:
        state: command, pose and set-points.
        angles_rad: (2N,) the set-point at the last sample, within a few mrad of the pose; another
            array whenever it has changed, as the pose is.
        step: 1 where the stamps had stepped forward at the last sample, -1 where back, else 0.
    """

    def __init__(self, command_rad: Array, settings: EstimationSettings) -> None:
        """At rest at a command (2N,)."""
        self._settings = settings
        self._blind_since_ns: int | None = None
        self._commands_since = 0
        self._rest_from_s = 0.0
        self.rest_at(command_rad)

    def rest_at(self, command_rad: Array) -> None:
        """The arm has been at rest at a command (2N,) for long."""
        rest_rad = command_rad.copy()
        self.state = GateState(command_rad=rest_rad, pose_rad=rest_rad, rest_from_ns=LONG_AGO_NS)
        self.angles_rad = rest_rad
        self._course = JointMotion(rest_rad, self._settings.joint_speed_rad_s)
        self._last_ns = LONG_AGO_NS
        self._heading = False
        self._starting = False
        self._resting = False
        self.step = 0

    @property
    def command_rad(self) -> Array:
        """(2N,) the command in force."""
        return self.state.command_rad

    @property
    def pose_rad(self) -> Array:
        """(2N,) pose of the estimates: the command, or a set-point of a followed motion."""
        return self.state.pose_rad

    @property
    def unrest(self) -> tuple[Array, Array] | None:
        """Speeds (2N,), rad/s, and accelerations (2N,), rad/s², at the last sample; None at rest.

        The arm swings with the accelerations of the set-points, and settles within `settle_s`.
        """
        if not self._swinging:
            return None
        return self._course.state[1], self.state.swing_rad_s2 * self._left_of_swing()

    @property
    def noisy(self) -> bool:
        """Whether the latest commands go back and forth, as an encoder's readings at rest do."""
        net_rad = float(np.linalg.norm(self.state.net_turn_rad))
        return net_rad < _NOISE * self.state.turns_rad

    @property
    def shut(self) -> bool:
        """Whether the arm may have moved at the last sample, or was commanded since."""
        return self._starting or self._last_ns < self.state.rest_from_ns

    @property
    def turning(self) -> bool:
        """Whether the joints have turned within the time in which the arm settles."""
        return self._last_ns - self.state.turned_ns < self._settings.settle_s * 1e9

    @property
    def settling(self) -> bool:
        """Whether the arm may swing: within `settle_s` of a turn, or of the end of a wait."""
        since_ns = max(self.state.turned_ns, self.state.rest_from_ns)
        return self._last_ns - since_ns <= self._settings.settle_s * 1e9

    def command(self, command_rad: Array) -> bool:
        """Take over a command (2N,); gives whether it differs from the previous one."""
        if np.array_equal(command_rad, self.command_rad):
            return False
        if not self.follows(command_rad):
            self._starting = True
        state = self.state
        turn_rad = command_rad - self.command_rad
        earlier_rad = state.net_turn_rad if state.net_turn_rad.size else np.zeros(len(turn_rad))
        state.net_turn_rad = _KEPT * earlier_rad + (1.0 - _KEPT) * turn_rad
        size_rad = float(np.linalg.norm(turn_rad))
        state.turns_rad = _KEPT * state.turns_rad + (1.0 - _KEPT) * size_rad
        state.command_rad = command_rad.copy()
        self._heading = True
        self._resting = False
        self._commands_since += 1
        return True

    def follows(self, command_rad: Array) -> bool:
        """Whether a command (2N,) would be followed with the gate as it is."""
        settings = self._settings
        off_rad = float(np.abs(command_rad - self.pose_rad).max())
        if off_rad <= settings.still_rad and not self.shut:
            return True
        if not settings.follow_rad_s:
            return False
        angle, speed, _ = self._course.state
        ahead_rad = float(np.abs(command_rad - angle).max())
        return (
            ahead_rad <= settings.follow_rad_s * SHORTEST_MOVE_S
            and float(np.abs(speed).max()) <= settings.follow_rad_s
        )

    def wait_anew(self) -> None:
        """Wait, from the next sample on, as after a command to the present pose."""
        self._starting = True
        self._heading = True
        self._resting = False

    def moving(self, stamp_ns: int, now_ns: int, now_s: float) -> bool:
        """Whether the arm may still move, or swing, at the next sample's stamp.

        The sample comes at `now_ns` of the clock that sets stamps, at monotonic time `now_s`.
        """
        if self._resting and stamp_ns >= self._last_ns:
            self._last_ns = stamp_ns
            return False
        state = self.state
        course = self._course
        last_ns = self._last_ns
        self.step = 0
        self._resting = False
        self._last_ns = stamp_ns
        if stamp_ns < last_ns:
            state.rest_from_ns -= last_ns - stamp_ns
            state.course_from_ns -= last_ns - stamp_ns
            state.turned_ns -= last_ns - stamp_ns
            state.swung_ns -= last_ns - stamp_ns
            self.step = -1
        if course.moving:
            course.at(max(0, stamp_ns - state.course_from_ns) * 1e-9)
            self._swing(stamp_ns)
        if self._heading:
            turn_rad = float(np.abs(self.command_rad - course.state[0]).max())
            course.go_to(self.command_rad)
            state.course_from_ns = stamp_ns
            if turn_rad > self._settings.still_rad:
                state.turned_ns = stamp_ns + round(course.remaining_s * 1e9)
        if self._heading or last_ns == LONG_AGO_NS:
            sampled_s = now_s - max(0, now_ns - stamp_ns) * 1e-9
            self._wait_for_course(stamp_ns, sampled_s, first=last_ns == LONG_AGO_NS)
        shut = self._may_move(stamp_ns, now_s)
        self._resting &= not course.moving
        if not shut:
            self._pose_at(course.state[0] if course.moving else self.command_rad)
        return shut

    def _wait_for_course(self, stamp_ns: int, sampled_s: float, *, first: bool) -> None:
        """Wait until the set-points must have arrived; a followed command may bring that forward.

        `sampled_s` is the monotonic time of the stamp; `first` is whether no other came before.
        """
        state = self.state
        wait_s = self._course.remaining_s + self._settings.settle_s
        latest_ns = stamp_ns + round(wait_s * 1e9)
        too_long_s = (state.rest_from_ns - latest_ns) * 1e-9
        changed = self._starting or too_long_s > _ROUNDING_S
        if changed:
            state.rest_from_ns = latest_ns
        if changed or first:
            self._rest_from_s = sampled_s + (state.rest_from_ns - stamp_ns) * 1e-9
        self._heading = False
        self._starting = False

    def _may_move(self, stamp_ns: int, now_s: float) -> bool:
        state = self.state
        if stamp_ns < state.rest_from_ns:
            return True
        left_s = self._rest_from_s - now_s
        if left_s <= _CLOCK_JITTER_S:
            self._resting = not self.step
            return False
        rest_from_ns = stamp_ns + round(left_s * 1e9)
        if state.course_from_ns < stamp_ns:  # set-points have not jumped with the stamps
            state.course_from_ns += rest_from_ns - state.rest_from_ns
            state.turned_ns += rest_from_ns - state.rest_from_ns
            self._course.at(max(0, stamp_ns - state.course_from_ns) * 1e-9)
        state.rest_from_ns = rest_from_ns
        self.step = 1
        return True

    def _swing(self, stamp_ns: int) -> None:
        """Note the accelerations of the set-points, or the decayed earlier ones if larger."""
        state = self.state
        now_rad_s2 = np.abs(self._course.state[2])
        if self._swinging:
            now_rad_s2 = np.maximum(now_rad_s2, state.swing_rad_s2 * self._left_of_swing())
        state.swing_rad_s2 = now_rad_s2
        state.swung_ns = stamp_ns

    @property
    def _swinging(self) -> bool:
        passed_ns = self._last_ns - self.state.swung_ns
        return bool(self.state.swing_rad_s2.size) and (
            passed_ns < _SWINGS * self._settings.settle_s * 1e9
        )

    def _left_of_swing(self) -> float:
        passed_s = (self._last_ns - self.state.swung_ns) * 1e-9
        return math.exp(-_SETTLED * passed_s / self._settings.settle_s)

    def _pose_at(self, angles_rad: Array) -> None:
        off_rad = float(np.abs(angles_rad - self.pose_rad).max())
        still_rad = self._settings.still_rad
        if self._settings.follow_rad_s or off_rad > still_rad:
            self.angles_rad = angles_rad
            if off_rad > _POSE_STEP_RAD or (off_rad and not self._course.moving):
                self.state.pose_rad = angles_rad

    def estimated(self, known: bool) -> None:
        """Note whether the last sample had an estimate; a long time without one is reported."""
        if known:
            self._blind_since_ns = None
            self._commands_since = 0
        elif self._blind_since_ns is None:
            self._blind_since_ns = self._last_ns

    def status(self, pose_range_deg: float, refused: int, *, received: bool) -> Status:
        """Command, motion and pose, for diagnostics.

        Args:
            pose_range_deg: the model was trained within ± this.
            refused: number of commands refused since the last report.
            received: whether any command has come.
        """
        command_deg = np.rad2deg(self.command_rad).tolist()
        values = {
            "commands refused": str(refused),
            "command (deg)": ", ".join(f"{angle:.2f}" for angle in command_deg),
        }
        blind_s = 0.0
        if self._blind_since_ns is not None and self._commands_since >= _SOME_COMMANDS:
            blind_s = (self._last_ns - self._blind_since_ns) * 1e-9
        level = Level.WARN
        message = ""
        if refused:
            level = Level.ERROR
            message = "a command was refused; see the log"
        elif blind_s > _BLIND_S and (self.shut or self.turning):
            message = (
                f"moving: no estimate for {blind_s:.0f} s, as commands continue that exceed "
                f"{np.rad2deg(self._settings.follow_rad_s):g} deg/s (follow_deg_s), or the arm "
                "lags behind them"
            )
        elif self.shut or self.turning:
            level = Level.OK
            message = "moving slowly: its set-points are followed"
            if self.shut:
                message = "moving: no estimate until the arm rests"
        elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
            message = f"beyond the poses that the model is for (±{pose_range_deg:g} degrees)"
        elif not received:
            message = "none received: arm assumed to be straight"
        else:
            level = Level.OK
            message = "at rest"
        return Status("joint_commands", level, message, values)
