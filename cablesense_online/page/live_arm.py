"""The state of a running arm as the page shows it, and the estimator's errors so far.

`LiveArm` collects the contract's messages (duck-typed: no ROS is needed here) and gives a
`Snapshot` of the present; `Score` compares true and estimated contacts while the arm stands still.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_msgs_py.messages import Level, Load, NamedOrder, joint_command_rad, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
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
    """Mean errors over the moments compared so far.

    Attributes:
        count: moments compared.
        segment_right: share of them, 0 … 1, with the right segment (or rightly none).
        angle_mae_deg: over those with the right segment; None before the first.
        magnitude_mae_n: likewise.
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
        still, true = self._still, snapshot.true
        if still is not None and (still.true is None) == (true is None):
            force_moved = 0.0
            if still.true is not None and true is not None:
                force_moved = float(np.abs(still.true.force_base_n - true.force_base_n).max())
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


@dataclass
class _Latest:
    """The latest of each message, with the time it came."""

    tensions_s: float = -np.inf
    tensions_n: Array | None = None
    joint_angles_rad: Array | None = None
    loads: dict[int, Array] = field(default_factory=dict)
    estimate_s: float = -np.inf
    estimate: tuple[int, Array] | None = None
    probabilities: Array | None = None
    health: dict[str, tuple[float, Level, str]] = field(default_factory=dict)


class LiveArm:
    """Collects messages and gives a Snapshot of the present; safe to call from several threads.

    Methods named `on_…` take a message and raise ContractError when it breaks the contract. Times
    are of one monotonic clock, s.
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
        self._estimator = estimator
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._motion = JointMotion(np.zeros(arm.joint_count), joint_speed_rad_s)
        self._motion_s: float | None = None
        self._latest = _Latest()
        self._lock = threading.Lock()

    def on_tensions(self, message: Any, now_s: float) -> None:
        """Takes a `cable_tensions` message."""
        tensions = self._cables.arrange(message.name, message.effort, "effort")
        with self._lock:
            self._latest.tensions_n, self._latest.tensions_s = tensions, now_s

    def on_joint_states(self, message: Any) -> None:
        """Takes a `joint_states` message."""
        angles = self._joints.arrange(message.name, message.position, "position")
        with self._lock:
            self._latest.joint_angles_rad = angles

    def on_joint_commands(self, message: Any) -> None:
        """Takes a `joint_commands` message: contact angles are counted at the commanded pose."""
        command = joint_command_rad(message, self._joints)
        with self._lock:
            self._motion.go_to(command)

    def on_load(self, message: Any) -> None:
        """Takes an `applied_wrench` message; it replaces the load on its segment."""
        load = read_load(message, self.frames)
        with self._lock:
            self._latest.loads[load.segment] = load.force_base_n

    def on_wrench(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench`: a force in the axes of its segment, or zero."""
        force = message.wrench.force
        local_n = np.array([force.x, force.y, force.z])
        estimate = None
        if local_n.any():
            estimate = (self.frames.segment_number(message.header.frame_id), local_n)
        with self._lock:
            self._latest.estimate, self._latest.estimate_s = estimate, now_s

    def on_probabilities(self, message: Any) -> None:
        """Takes the estimator's `contact_probabilities`; another length is not this arm's."""
        probabilities = np.asarray(message.data, dtype=float)
        if probabilities.shape == (self.mechanism.segment_count + 1,):
            with self._lock:
                self._latest.probabilities = probabilities

    def on_diagnostics(self, message: Any, now_s: float) -> None:
        """Takes a `/diagnostics` message and keeps the estimator's own statuses."""
        with self._lock:
            for status in message.status:
                node, _, part = status.name.partition(": ")
                if node.strip("/") == self._estimator and part:
                    level = Level(min(int.from_bytes(status.level, "little"), Level.STALE))
                    self._latest.health[part] = (now_s, level, status.message)

    def content_with(self, part: str) -> bool:
        """Whether the estimator's latest status of a part, such as `tare`, is OK."""
        with self._lock:
            latest = self._latest.health.get(part)
        return latest is not None and latest[1] is Level.OK

    def loads_of(self, segment: int, angle_deg: float, magnitude_n: float) -> list[Load]:
        """The loads that make this push, and no other, the only one on the arm.

        Raises:
            LoadError: no such segment, or numbers that are not finite.
        """
        with self._lock:
            command = self._motion.advance(0.0)
            pushed = {number for number, force in self._latest.loads.items() if force.any()}
        forces = normal_force_n(self.mechanism, command, segment, angle_deg, magnitude_n)
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        return [*released, Load(segment, forces[segment - 1])] if segment else released

    def snapshot(self, now_s: float) -> Snapshot:
        """The present state, as far as it is known."""
        with self._lock:
            elapsed_s = 0.0 if self._motion_s is None else now_s - self._motion_s
            self._motion_s = now_s
            latest, command = self._latest, self._motion.advance(elapsed_s)
            rotations = segment_rotations(self.mechanism, command)
            fresh = now_s - latest.estimate_s <= STALE_S
            estimate = self._estimated(latest.estimate, command, rotations) if fresh else None
            return Snapshot(
                time_s=latest.tensions_s if latest.tensions_n is not None else now_s,
                joint_angles_rad=(
                    command if latest.joint_angles_rad is None else latest.joint_angles_rad
                ),
                tensions_n=latest.tensions_n,
                true=self._true(latest.loads, command),
                estimate=estimate,
                probabilities=latest.probabilities if fresh else None,
                status=_status(latest, estimate, now_s),
            )

    def _true(self, loads: Mapping[int, Array], command_rad: Array) -> Contact | None:
        """The largest load, which is the only one as long as the page alone pushes."""
        pushes = [(float(np.linalg.norm(f)), n, f) for n, f in loads.items() if f.any()]
        if not pushes:
            return None
        magnitude, segment, force = max(pushes, key=lambda push: push[0])
        angle = float(contact_angle_deg(self.mechanism, command_rad, segment, force))
        return Contact(segment, angle, magnitude, force)

    def _estimated(
        self, estimate: tuple[int, Array] | None, command_rad: Array, rotations: Array
    ) -> Contact | None:
        if estimate is None:
            return None
        segment, local_n = estimate
        force = rotations[segment - 1] @ local_n
        angle = float(np.rad2deg(np.arctan2(local_n[1], local_n[2])) % 360.0)
        return Contact(segment, angle, float(np.linalg.norm(local_n)), force)


def _status(latest: _Latest, estimate: Contact | None, now_s: float) -> Status:
    """With the estimator's warnings as notes; where there are none, its first status."""
    if latest.tensions_n is None:
        return Status(Level.STALE, "Waiting for cable_tensions", ("nothing has come yet",))
    if now_s - latest.tensions_s > STALE_S:
        age_s = now_s - latest.tensions_s
        return Status(Level.STALE, f"Tensions are stale, {age_s:.1f} s old")
    if not np.isfinite(latest.estimate_s):
        return Status(Level.STALE, "Waiting for the estimator", ("no estimate has come yet",))
    present = [h for h in latest.health.values() if now_s - h[0] <= DIAGNOSTICS_STALE_S]
    present.sort(key=lambda status: -status[1])
    warnings = tuple(text for _, level, text in present if level is not Level.OK)
    notes = warnings[:3] or tuple(text for _, _, text in present[:1])
    age_s = now_s - latest.estimate_s
    if age_s > STALE_S:
        return Status(Level.STALE, f"No estimate for {age_s:.1f} s", notes)
    headline = "No contact" if estimate is None else f"Contact on segment {estimate.segment}"
    return Status(present[0][1] if present else Level.OK, headline, notes)
