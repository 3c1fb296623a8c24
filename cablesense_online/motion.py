"""The commanded pose, whether the arm may still be moving towards it, and its pose on the way.

Controllers stream commands that differ in the last digit, or turn slowly. Such a motion is
followed along the set-points between the commands (`joint_motion`). Only faster ones shut the
gate. A command sets flags at once; the next sample clears them, and sets what holds from then on:

| a command                     | flags                 | from the next sample | until         |
| ----------------------------- | --------------------- | -------------------- | ------------- |
| within `still_rad`, not shut  | `heading`             | nothing              |               |
| farther, and still `follows`  | `heading`             | `turning`            | arrival + w   |
| any other                     | `heading`, `starting` | `shut`, `turning`    | arrival + w   |
| `waiting_anew`                | `heading`, `starting` | `shut`               | this sample+w |

Arrival is that of the set-points (`turned_ns`), w is `settle_s`. `shut` ends at `rest_from_ns`,
which a command that is followed may bring forward, never put off. What the words do:

| word       | holds                                            | effect                        |
| ---------- | ------------------------------------------------ | ----------------------------- |
| `shut`     | with `starting`, and until `rest_from_ns`        | no estimate                   |
| `turning`  | until w after a turn beyond `still_rad` arrives  | an earlier breath is void     |
| `settling` | as `turning`, and until w after `rest_from_ns`   | misfits are the arm's swing   |
| `_swings`  | until 2 w after the set-points moved             | intervals allow for unrest    |
| `noisy`    | while the latest changes of commands cancel      | they do not                   |
| `stepped`  | where a stamp fell back, or leapt during a wait  | an earlier breath is void     |
| `_rests`   | without flags, not shut, set-points at rest      | a sample brings its time only |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_online.settings import EstimationSettings
from cablesense_sim.joint_motion import SHORTEST_MOVE_S, JointMotion

_POSE_STEP_RAD = 2e-3
"""The pose follows a set-point in motion only beyond this distance: a new pose costs
milliseconds."""
_AVERAGE_KEPT_SHARE = 0.8
"""Share of the last average of changes of the command that each new one keeps."""
_NOISE_SHARE = 0.5
"""Share of their mean size below which the mean of changes is noise: these cancel."""
_ROUNDING_S = 1e-6
"""Waits that differ by less are the same: stamps are whole nanoseconds."""
_SETTLED = 3.0
"""Exponent by which a swing falls within `settle_s`: to a twentieth."""
_SETTLES_REMEMBERED = 2.0
"""A swing is forgotten after this many times `settle_s`."""
_CLOCK_JITTER_S = 0.02
"""Between the stamps' clock and the monotonic one; a larger difference means a clock was set."""

LONG_AGO_NS: Final = -(2**62)
"""A stamp before all others."""


class CommandedMotion(NamedTuple):
    """What is known of the arm's motion at the last sample, and of the commands since.

    Attributes:
        command_rad: (2N,) the command in force; of a machine (C,), rad or m, as all `_rad` here.
        pose_rad: (2N,) pose of the estimates: the command, or a set-point of a followed motion.
        course: the set-points.
        last_ns: stamp of the last sample.
        rest_from_ns: stamp from which on the arm rests.
        rest_from_s: monotonic time of the same.
        course_from_ns: the stamp at which the motion of the set-points began.
        turned_ns: stamp at which the last turn beyond `still_rad` arrives.
        swing_rad_s2: (2N,) accelerations with which the arm swung at a stamp, and
        swung_ns: that stamp.
        net_turn_rad: (2N,) average of the latest changes of the command, and
        turns_rad: of their sizes.
        heading: whether a command came since the last sample.
        starting: whether one came that is not followed.
        stepped: 1 where the stamps had stepped forward at the last sample, -1 where back, else 0.
    """

    command_rad: Array
    pose_rad: Array
    course: JointMotion
    swing_rad_s2: Array
    net_turn_rad: Array
    last_ns: int = LONG_AGO_NS
    rest_from_ns: int = LONG_AGO_NS
    rest_from_s: float = 0.0
    course_from_ns: int = 0
    turned_ns: int = LONG_AGO_NS
    swung_ns: int = LONG_AGO_NS
    turns_rad: float = 0.0
    heading: bool = False
    starting: bool = False
    stepped: int = 0

    @property
    def shut(self) -> bool:
        """Whether the arm may have moved at the last sample, or was commanded since.

        Then there is no estimate, and commands near the pose are moves, too (`follows`).
        """
        return self.starting or self.last_ns < self.rest_from_ns

    @property
    def noisy(self) -> bool:
        """Whether the latest commands go back and forth, as an encoder's readings at rest do."""
        net_rad = float(np.linalg.norm(self.net_turn_rad))
        return net_rad < _NOISE_SHARE * self.turns_rad

    @property
    def waiting_anew(self) -> CommandedMotion:
        """The same, waiting from the next sample on as after a command to the present pose."""
        return self._replace(starting=True, heading=True)


@dataclass(frozen=True)
class Unrest:
    """How the joints move at a sample.

    Attributes:
        speed_rad_s: (2N,) of the set-points.
        swing_rad_s2: (2N,) accelerations with which the arm swings.
    """

    speed_rad_s: Array
    swing_rad_s2: Array


class MotionGate:
    """Shut from a changed command until its set-points have arrived, and then for `settle_s`.

    Time is that of the samples' stamps, so that a recording has the same answers: a command counts
    from the first sample after it. If stamps step back, the remaining wait is kept. If they step
    forward, it is timed by the monotonic clock of their arrival.

    A command shuts the gate unless it is within `still_rad` of the pose, or the arm is to follow
    at `follow_rad_s` at most: the joints turn no faster, and the command is no farther ahead of
    them than such a motion gets in the time of the shortest move.
    """

    def __init__(self, settings: EstimationSettings, per_radian: float = 1.0) -> None:
        """`per_radian` is by how much commands change at most where a joint turns by one radian.

        How fast actuators reach a length is not known: they are taken to be there at once.
        """
        self._settings = settings
        self._still_within = settings.still_rad * per_radian
        self._follow_s = settings.follow_rad_s * per_radian
        self._pose_step = _POSE_STEP_RAD * per_radian
        self._settle_ns = settings.settle_ns

    def at_rest(self, command_rad: Array) -> CommandedMotion:
        """The arm has been at rest at a command (2N,) for long."""
        rest_rad = command_rad.copy()
        return CommandedMotion(
            command_rad=rest_rad,
            pose_rad=rest_rad,
            course=JointMotion.at_rest(rest_rad, self._settings.joint_speed_rad_s),
            swing_rad_s2=np.zeros_like(rest_rad),
            net_turn_rad=np.zeros_like(rest_rad),
        )

    def commanded(self, motion: CommandedMotion, command_rad: Array) -> CommandedMotion:
        """The motion with another command (2N,) in force."""
        turn_rad = command_rad - motion.command_rad
        size_rad = float(np.linalg.norm(turn_rad))
        return motion._replace(
            command_rad=command_rad.copy(),
            net_turn_rad=_AVERAGE_KEPT_SHARE * motion.net_turn_rad
            + (1.0 - _AVERAGE_KEPT_SHARE) * turn_rad,
            turns_rad=_AVERAGE_KEPT_SHARE * motion.turns_rad
            + (1.0 - _AVERAGE_KEPT_SHARE) * size_rad,
            heading=True,
            starting=motion.starting or not self.follows(motion, command_rad),
        )

    def follows(self, motion: CommandedMotion, command_rad: Array) -> bool:
        """Whether a command (2N,) would be followed with the gate as it is."""
        off_rad = float(np.abs(command_rad - motion.pose_rad).max())
        if off_rad <= self._still_within and not motion.shut:
            return True
        if not self._follow_s:
            return False
        angle, speed, _ = motion.course.state
        ahead_rad = float(np.abs(command_rad - angle).max())
        return (
            ahead_rad <= self._follow_s * SHORTEST_MOVE_S
            and float(np.abs(speed).max()) <= self._follow_s
        )

    def at_sample(
        self, motion: CommandedMotion, stamp_ns: int, now_ns: int, now_s: float
    ) -> CommandedMotion:
        """The motion at the next sample's stamp.

        The sample is of `stamp_ns` and comes at `now_ns`, both of the clock that sets stamps. It
        comes at `now_s` of the monotonic clock, by which a wait is timed whatever the stamps do.
        The set-points have a time of their own, from where they began to move. After a command

            rest_from_ns = stamp_ns + what the set-points still need + settle_s
            swing_rad_s2 = max(|acceleration|, earlier swing x exp(-3 time since / settle_s)).
        """
        if self._rests(motion, stamp_ns):
            return motion._replace(last_ns=stamp_ns, stepped=0)
        is_first = motion.last_ns == LONG_AGO_NS
        at_stamp = _with_stamp(motion, stamp_ns)
        with_set_points = at_stamp
        if at_stamp.course.moving:
            on_course_s = max(0, stamp_ns - at_stamp.course_from_ns) * 1e-9
            moved_on = at_stamp._replace(course=at_stamp.course.at(on_course_s))
            with_set_points = self._swinging_on(moved_on)
        to_command = with_set_points
        if with_set_points.heading:
            to_command = self._headed(with_set_points)
        with_wait = to_command
        if to_command.heading or is_first:
            sample_age_s = max(0, now_ns - stamp_ns) * 1e-9
            sampled_s = now_s - sample_age_s
            with_wait = self._waiting_for_course(to_command, sampled_s, first=is_first)
        with_clock = _held_shut(with_wait, now_s)
        return with_clock if with_clock.shut else self._at_pose(with_clock)

    def turning(self, motion: CommandedMotion) -> bool:
        """Whether the joints have turned within the time in which the arm settles."""
        return motion.last_ns - motion.turned_ns < self._settle_ns

    def settling(self, motion: CommandedMotion) -> bool:
        """Whether the arm may swing: within `settle_s` of a turn, or of the end of a wait."""
        since_ns = max(motion.turned_ns, motion.rest_from_ns)
        return motion.last_ns - since_ns <= self._settle_ns

    def unrest(self, motion: CommandedMotion) -> Unrest | None:
        """How the joints move on a followed motion; None at rest, and under noisy commands.

        The arm swings with the accelerations of the set-points, and settles within `settle_s`.
        """
        if not self._swings(motion) or motion.noisy:
            return None
        _, speed_rad_s, _ = motion.course.state
        return Unrest(speed_rad_s, motion.swing_rad_s2 * self._left_of_swing(motion))

    def _rests(self, motion: CommandedMotion, stamp_ns: int) -> bool:
        """Whether the arm is at rest, and nothing has happened since the last sample."""
        undisturbed = not (motion.heading or motion.starting or motion.stepped)
        at_rest = motion.last_ns >= motion.rest_from_ns and not motion.course.moving
        return undisturbed and at_rest and stamp_ns >= motion.last_ns > LONG_AGO_NS

    def _headed(self, motion: CommandedMotion) -> CommandedMotion:
        """With the set-points on their way to the command from this sample on."""
        turn_rad = float(np.abs(motion.command_rad - motion.course.angle_rad).max())
        course = motion.course.towards(motion.command_rad)
        turned_ns = motion.turned_ns
        if turn_rad > self._still_within:
            turned_ns = motion.last_ns + round(course.remaining_s * 1e9)
        return motion._replace(course=course, course_from_ns=motion.last_ns, turned_ns=turned_ns)

    def _waiting_for_course(
        self, motion: CommandedMotion, sampled_s: float, *, first: bool
    ) -> CommandedMotion:
        """Waiting until the set-points must have arrived; a followed command may come earlier.

        `sampled_s` is the monotonic time of the stamp; `first` is whether no other came before.
        """
        wait_s = motion.course.remaining_s + self._settings.settle_s
        latest_ns = motion.last_ns + round(wait_s * 1e9)
        too_long_s = (motion.rest_from_ns - latest_ns) * 1e-9
        changed = motion.starting or too_long_s > _ROUNDING_S
        rest_from_ns = latest_ns if changed else motion.rest_from_ns
        rest_from_s = motion.rest_from_s
        if changed or first:
            rest_from_s = sampled_s + (rest_from_ns - motion.last_ns) * 1e-9
        return motion._replace(
            rest_from_ns=rest_from_ns, rest_from_s=rest_from_s, heading=False, starting=False
        )

    def _at_pose(self, motion: CommandedMotion) -> CommandedMotion:
        """At the pose of the estimates that follows from the set-points."""
        angles_rad = motion.course.angle_rad if motion.course.moving else motion.command_rad
        off_rad = float(np.abs(angles_rad - motion.pose_rad).max())
        follows = self._follow_s or off_rad > self._still_within
        far = off_rad > self._pose_step or (off_rad and not motion.course.moving)
        return motion._replace(pose_rad=angles_rad) if follows and far else motion

    def _swinging_on(self, motion: CommandedMotion) -> CommandedMotion:
        """With the accelerations of the set-points, or the decayed earlier ones if larger."""
        _, _, acceleration_rad_s2 = motion.course.state
        swing_rad_s2 = np.abs(acceleration_rad_s2)
        if self._swings(motion):
            earlier_rad_s2 = motion.swing_rad_s2 * self._left_of_swing(motion)
            swing_rad_s2 = np.maximum(swing_rad_s2, earlier_rad_s2)
        return motion._replace(swing_rad_s2=swing_rad_s2, swung_ns=motion.last_ns)

    def _swings(self, motion: CommandedMotion) -> bool:
        return motion.last_ns - motion.swung_ns < _SETTLES_REMEMBERED * self._settle_ns

    def _left_of_swing(self, motion: CommandedMotion) -> float:
        passed_s = (motion.last_ns - motion.swung_ns) * 1e-9
        return math.exp(-_SETTLED * passed_s / self._settings.settle_s)


def _with_stamp(motion: CommandedMotion, stamp_ns: int) -> CommandedMotion:
    """The motion at another stamp; where stamps have stepped back, all times step with them."""
    back_ns = motion.last_ns - stamp_ns
    if back_ns <= 0:
        return motion._replace(last_ns=stamp_ns, stepped=0)
    return motion._replace(
        last_ns=stamp_ns,
        rest_from_ns=motion.rest_from_ns - back_ns,
        course_from_ns=motion.course_from_ns - back_ns,
        turned_ns=motion.turned_ns - back_ns,
        swung_ns=motion.swung_ns - back_ns,
        stepped=-1,
    )


def _held_shut(motion: CommandedMotion, now_s: float) -> CommandedMotion:
    """With the wait prolonged where stamps have stepped forward in the midst of it."""
    left_s = motion.rest_from_s - now_s
    if motion.last_ns < motion.rest_from_ns or left_s <= _CLOCK_JITTER_S:
        return motion
    rest_from_ns = motion.last_ns + round(left_s * 1e9)
    if motion.course_from_ns >= motion.last_ns:
        return motion._replace(rest_from_ns=rest_from_ns, stepped=1)
    # set-points have not jumped with the stamps
    jump_ns = rest_from_ns - motion.rest_from_ns
    course_from_ns = motion.course_from_ns + jump_ns
    elapsed_s = max(0, motion.last_ns - course_from_ns) * 1e-9
    return motion._replace(
        rest_from_ns=rest_from_ns,
        course_from_ns=course_from_ns,
        turned_ns=motion.turned_ns + jump_ns,
        course=motion.course.at(elapsed_s),
        stepped=1,
    )
