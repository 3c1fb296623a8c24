"""The state of a running arm as the page shows it, and the estimator's errors so far.

`LiveArm` collects the contract's messages (duck-typed: no ROS is needed here) and gives a
`Snapshot` of the present; `Score` compares true and estimated contacts while the arm stands still.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import (
    Level,
    Load,
    NamedOrder,
    breath_turn,
    joint_command_rad,
    read_load,
)
from cablesense_msgs_py.topics import CABLE_TENSIONS, Frames
from cablesense_online.samples import FollowedPublisher
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import contact_angle_deg, normal_force_n


@dataclass(frozen=True)
class Contact:
    """A single force on the arm, true or estimated.

    Attributes:
        segment: 1 … N.
        angle_deg: contact angle at the commanded pose, from the segment's +z towards its +y.
        magnitude_n: newtons.
        force_base_n: (3,) the same force in base axes.
    """

    segment: int
    angle_deg: float
    magnitude_n: float
    force_base_n: Array


@dataclass(frozen=True)
class Status:
    """The estimator's state: level, headline, and notes for a person."""

    level: Level
    headline: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """One moment of the arm; None is not known.

    Attributes:
        time_s: of the newest tensions, any steady clock.
        joint_angles_rad: (2N,) measured or commanded.
        tensions_n: (M,).
        true: the load that is really applied.
        estimate: the estimated contact; None also when nothing touches.
        probabilities: (N + 1,) of no contact and of each segment.
        status: of the estimator.
    """

    time_s: float
    joint_angles_rad: Array
    tensions_n: Array | None
    true: Contact | None
    estimate: Contact | None
    probabilities: Array | None
    status: Status


SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
STILL_N = 0.01
STILL_RAD = 0.003
"""Load and pose that change by less stand still."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True)
class Errors:
    """Mean errors over the `count` moments compared so far; None before the first of their kind.

    `segment_right` is the share, 0 … 1, of moments with the right segment (or rightly none); the
    other two are over those with the right segment.
    """

    count: int
    segment_right: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


class Score:
    """Adds up errors while the true load stays put."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self._still: Snapshot | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Discards every comparison."""
        self._count = self._right = 0
        self._contacts, self._sums = 0, np.zeros(2)  # of errors in degrees and newtons

    def add(self, snapshot: Snapshot) -> bool:
        """Compares one moment; gives whether it counted: load and pose must have stood still."""
        if snapshot.status.level is Level.STALE:
            return False
        if self._changed(snapshot):
            self._still_since_s = snapshot.time_s
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return False
        true, estimate = snapshot.true, snapshot.estimate
        self._count += 1
        if true is None or estimate is None:
            self._right += true is estimate
        elif true.segment == estimate.segment:
            self._right += 1
            self._contacts += 1
            self._sums += (
                angle_error_deg(true.angle_deg, estimate.angle_deg),
                abs(true.magnitude_n - estimate.magnitude_n),
            )
        return True

    def _changed(self, snapshot: Snapshot) -> bool:
        """Whether load or pose differ from those since which the arm has stood still."""
        still = self._still
        if still is not None and (still.true is None) == (snapshot.true is None):
            force_moved = 0.0
            if still.true is not None and snapshot.true is not None:
                difference = still.true.force_base_n - snapshot.true.force_base_n
                force_moved = float(np.abs(difference).max())
            pose_moved = float(np.abs(still.joint_angles_rad - snapshot.joint_angles_rad).max())
            if force_moved < STILL_N and pose_moved < STILL_RAD:
                return False
        self._still = snapshot
        return True

    @property
    def errors(self) -> Errors:
        """The errors so far."""
        right = self._right / self._count if self._count else None
        means = (self._sums / self._contacts).tolist() if self._contacts else (None, None)
        return Errors(self._count, right, *means)


STALE_S = 0.5
"""Tensions and estimates older than this are not shown as the present."""
DIAGNOSTICS_STALE_S = 4.0


class LiveArm:
    """Collects messages and gives a Snapshot of the present; safe to call from several threads.

    Methods named `on_…` take a message and raise CableSenseError when it breaks the contract, or
    commands what the arm cannot do. Times are of one monotonic clock, s.

    Attributes:
        mechanism, frames: of the arm.
        tension_publisher: the one whose tensions are shown; others are an error.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        joint_speed_rad_s: float,
        frame_prefix: str = "",
        estimator: str = "estimator",
    ) -> None:
        self.mechanism = mechanism_of(arm)
        self.frames = Frames(arm.segment_count, frame_prefix)
        self.tension_publisher = FollowedPublisher()
        self._estimator = estimator
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._motion = JointMotion(np.zeros(arm.joint_count), joint_speed_rad_s)
        self._motion_s: float | None = None
        self._tensions_s = self._estimate_s = -np.inf
        self._tensions_n: Array | None = None
        self._joint_angles_rad: Array | None = None
        self._loads: dict[int, Array] = {}
        self._estimate: tuple[int, Array] | None = None
        self._probabilities: Array | None = None
        self._health: dict[str, tuple[float, Level, str]] = {}
        self._lock = threading.Lock()

    def on_tensions(self, message: Any, now_s: float) -> None:
        """Takes a `cable_tensions` message."""
        tensions = self._cables.arrange(message.name, message.effort, "effort")
        with self._lock:
            self._tensions_n, self._tensions_s = tensions, now_s

    def on_joint_states(self, message: Any) -> None:
        """Takes a `joint_states` message."""
        self._joint_angles_rad = self._joints.arrange(message.name, message.position, "position")

    def on_joint_commands(self, message: Any) -> None:
        """Takes a `joint_commands` message: contact angles are counted at the commanded pose.

        A breath leaves that as it is.
        """
        if breath_turn(message) is not None:
            return
        command = checked_command(self.mechanism, joint_command_rad(message, self._joints))
        with self._lock:
            self._motion.go_to(command)

    def on_load(self, message: Any) -> None:
        """Takes an `applied_wrench` message; it replaces the load on its segment."""
        load = read_load(message, self.frames)
        with self._lock:
            self._loads[load.segment] = load.force_base_n

    def on_wrench(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench`: a force in the axes of its segment, else none."""
        force = message.wrench.force
        local_n = np.array([force.x, force.y, force.z])
        estimate = None
        if np.abs(local_n).max() > 0.0:  # not a number is no force
            estimate = (self.frames.segment_number(message.header.frame_id), local_n)
        with self._lock:
            self._estimate, self._estimate_s = estimate, now_s

    def on_probabilities(self, message: Any) -> None:
        """Takes the estimator's `contact_probabilities`; another length is not this arm's."""
        probabilities = np.asarray(message.data, dtype=float)
        if probabilities.shape == (self.mechanism.segment_count + 1,):
            self._probabilities = probabilities

    def on_diagnostics(self, message: Any, now_s: float) -> None:
        """Takes a `/diagnostics` message and keeps the estimator's own statuses."""
        with self._lock:
            for status in message.status:
                node, _, part = status.name.partition(": ")
                if node.strip("/") == self._estimator and part:
                    level = Level(min(int.from_bytes(status.level, "little"), Level.STALE))
                    self._health[part] = (now_s, level, status.message)

    def content_with(self, part: str) -> bool:
        """Whether the estimator's latest status of a part, such as `tare`, is OK."""
        latest = self._health.get(part)
        return latest is not None and latest[1] is Level.OK

    def loads_of(self, segment: int, angle_deg: float, magnitude_n: float) -> list[Load]:
        """The loads that make this push, and no other, the only one on the arm.

        Raises:
            LoadError: no such segment, or numbers that are not finite.
        """
        with self._lock:
            command = self._motion.advance(0.0)
            pushed = {number for number, force in self._loads.items() if force.any()}
        forces = normal_force_n(self.mechanism, command, segment, angle_deg, magnitude_n)
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        return [*released, Load(segment, forces[segment - 1])] if segment else released

    def snapshot(self, now_s: float) -> Snapshot:
        """The present state, as far as it is known."""
        with self._lock:
            elapsed_s = 0.0 if self._motion_s is None else now_s - self._motion_s
            self._motion_s = now_s
            command = self._motion.advance(elapsed_s)
            fresh = now_s - self._estimate_s <= STALE_S
            estimate = self._estimated(command) if fresh else None
            status = self._status(estimate, now_s)
            if now_s - self.tension_publisher.refused_s <= DIAGNOSTICS_STALE_S:
                note = f"{CABLE_TENSIONS} has two publishers; those of one are shown"
                status = Status(Level.ERROR, status.headline, (note, *status.notes))
            measured = self._joint_angles_rad
            return Snapshot(
                time_s=self._tensions_s if self._tensions_n is not None else now_s,
                joint_angles_rad=command if measured is None else measured,
                tensions_n=self._tensions_n,
                true=self._true(command),
                estimate=estimate,
                probabilities=self._probabilities if fresh else None,
                status=status,
            )

    def _true(self, command_rad: Array) -> Contact | None:
        """The largest load, which is the only one as long as the page alone pushes."""
        pushes = [(float(np.linalg.norm(f)), n, f) for n, f in self._loads.items() if f.any()]
        if not pushes:
            return None
        magnitude, segment, force = max(pushes, key=lambda push: push[0])
        angle = float(contact_angle_deg(self.mechanism, command_rad, segment, force))
        return Contact(segment, angle, magnitude, force)

    def _estimated(self, command_rad: Array) -> Contact | None:
        if self._estimate is None:
            return None
        segment, local_n = self._estimate
        force = segment_rotations(self.mechanism, command_rad)[segment - 1] @ local_n
        angle = float(np.rad2deg(np.arctan2(local_n[1], local_n[2])) % 360.0)
        return Contact(segment, angle, float(np.linalg.norm(local_n)), force)

    def _status(self, estimate: Contact | None, now_s: float) -> Status:
        """With the estimator's warnings as notes; where there are none, its first status."""
        if self._tensions_n is None:
            return Status(Level.STALE, "Waiting for cable_tensions", ("nothing has come yet",))
        if (age_s := now_s - self._tensions_s) > STALE_S:
            return Status(Level.STALE, f"Tensions are stale, {age_s:.1f} s old")
        if not np.isfinite(self._estimate_s):
            return Status(Level.STALE, "Waiting for the estimator", ("no estimate has come yet",))
        present = [h for h in self._health.values() if now_s - h[0] <= DIAGNOSTICS_STALE_S]
        present.sort(key=lambda status: -status[1])
        warnings = tuple(text for _, level, text in present if level is not Level.OK)
        notes = warnings[:3] or tuple(text for _, _, text in present[:1])
        if (age_s := now_s - self._estimate_s) > STALE_S:
            return Status(Level.STALE, f"No estimate for {age_s:.1f} s", notes)
        headline = "No contact" if estimate is None else f"Contact on segment {estimate.segment}"
        return Status(present[0][1] if present else Level.OK, headline, notes)
