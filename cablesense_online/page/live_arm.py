"""The state of a running arm as the page shows it.

`LiveArm` collects the contract's messages (duck-typed: no ROS is needed here) and gives a
`Snapshot` of the present.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import (
    ForceState,
    Level,
    Load,
    NamedOrder,
    breath_turn,
    joint_command_rad,
    read_force_state,
    read_load,
)
from cablesense_msgs_py.topics import CABLE_TENSIONS, Frames
from cablesense_online.samples import FollowedPublisher
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import contact_points_m, segment_rotations
from cablesense_sim.loads import normal_components_n, normal_force_n


def _force_n(message: Any) -> Array:
    force = message.wrench.force
    return np.array([force.x, force.y, force.z])


def _angle_deg(local_n: Array) -> float:
    return float(np.rad2deg(np.arctan2(local_n[1], local_n[2])) % 360.0)


@dataclass(frozen=True)
class ShownContact:
    """A single force on the arm, normal to its segment; true or estimated.

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
class ShownStatus:
    """The estimator's state: level, headline, and notes for a person."""

    level: Level
    headline: str
    notes: tuple[str, ...] = ()


class ForceBounds(NamedTuple):
    """Ends of the stated 95 % intervals of force and contact angle.

    The angle is between the two, from the first on with a growing angle; None where any may be.
    """

    low_n: float
    high_n: float
    angles_deg: tuple[float, float] | None = None


@dataclass(frozen=True)
class Snapshot:
    """One moment of the arm; None is not known.

    Attributes:
        time_s: of the newest tensions, any steady clock.
        joint_angles_rad: (2N,) measured or commanded.
        tensions_n: (M,).
        true: of the load that is really applied the part that can be felt, normal to its segment.
        state: what is known of the force.
        estimate: the estimated contact; None when nothing touches and when the force is unknown.
        bounds: of the estimated force.
        probabilities: (N + 1,) of no contact and of each segment.
        status: of the estimator.
        more_true, more_estimated: contacts beside these, on other segments, the strongest first.
    """

    time_s: float
    joint_angles_rad: Array
    tensions_n: Array | None
    true: ShownContact | None
    state: ForceState
    estimate: ShownContact | None
    bounds: ForceBounds | None
    probabilities: Array | None
    status: ShownStatus
    more_true: tuple[ShownContact, ...] = ()
    more_estimated: tuple[ShownContact, ...] = ()

    @property
    def all_true(self) -> tuple[ShownContact, ...]:
        """Every true contact, the strongest first."""
        return () if self.true is None else (self.true, *self.more_true)

    @property
    def all_estimated(self) -> tuple[ShownContact, ...]:
        """Every estimated contact, the strongest first."""
        return () if self.estimate is None else (self.estimate, *self.more_estimated)

    @property
    def answered(self) -> bool:
        """Whether the estimator gave a contact, or that none can be seen."""
        return self.state in _ANSWERED


STALE_S = 0.5
"""Tensions and estimates older than this are not shown as the present."""
DIAGNOSTICS_STALE_S = 4.0
_IN_CONTACT = (ForceState.CONTACT, ForceState.UNCONFIRMED)
_ANSWERED = (*_IN_CONTACT, ForceState.FREE, ForceState.HIDDEN)
_LEAST_FELT_N = 1e-3
_HARMLESS = frozenset({"cables", "cable_tensions"})
"""Parts whose warnings lessen no trust: statics holds with slack cables, a lost sample is lost."""
_HEADLINES = {
    ForceState.FREE: "No contact",
    ForceState.CONTACT: "Contact",
    ForceState.UNCONFIRMED: "Unconfirmed contact",
    ForceState.HIDDEN: "No contact seen",
    ForceState.MOVING: "Moving: no estimate",
    ForceState.UNTARED: "No tare: no estimate",
    ForceState.REFUSED: "Readings refused: no estimate",
    ForceState.IMPLAUSIBLE: "Readings fit no contact: no estimate",
    ForceState.STALE: "Readings are out of date: no estimate",
    ForceState.SILENT: "The estimator is silent",
}
_LEVELS = {ForceState.MOVING: Level.STALE, ForceState.UNTARED: Level.STALE}
"""Grey, as nothing is estimated; every other state as severe as it says."""


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
        self._of_segments: dict[int, tuple[float, Array]] = {}
        self._state, self._state_s = ForceState.SILENT, -np.inf
        self._bounds_n = np.zeros((2, 3))
        self._bounds_s = np.full(2, -np.inf)
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
        command = joint_command_rad(message, self._joints, self._motion.target_rad)
        with self._lock:
            self._motion.go_to(checked_command(self.mechanism, command))

    def on_load(self, message: Any) -> None:
        """Takes an `applied_wrench` message; it replaces the load on its segment."""
        with self._lock:
            command = self._motion.advance(0.0)
        load = read_load(message, self.frames, lambda: contact_points_m(self.mechanism, command))
        with self._lock:
            self._loads[load.segment] = load.force_base_n

    def on_wrench(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench`: a force in the axes of its segment, else none."""
        local_n = _force_n(message)
        estimate = None
        if np.abs(local_n).max() > 0.0:  # not a number is no force
            estimate = (self.frames.segment_number(message.header.frame_id), local_n)
        with self._lock:
            self._estimate, self._estimate_s = estimate, now_s

    def on_segment_wrench(self, message: Any, now_s: float) -> None:
        """Takes one of the estimator's `wrenches`, of a model of several contacts."""
        segment = self.frames.segment_number(message.header.frame_id)
        with self._lock:
            self._of_segments[segment] = now_s, _force_n(message)

    def on_status(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `status`: what its wrench stands for."""
        state, _ = read_force_state(message)
        with self._lock:
            self._state, self._state_s = state, now_s

    def on_lower(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench_lower`."""
        self._bound(0, message, now_s)

    def on_upper(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench_upper`."""
        self._bound(1, message, now_s)

    def _bound(self, end: int, message: Any, now_s: float) -> None:
        with self._lock:
            self._bounds_n[end] = _force_n(message)
            self._bounds_s[end] = now_s

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

    def reports_ok(self, part: str) -> bool:
        """Whether the estimator's latest status of a part, such as `tare`, is OK."""
        latest = self._health.get(part)
        return latest is not None and latest[1] is Level.OK

    def loads_of(
        self, segment: int, angle_deg: float, magnitude_n: float, *, beside: bool = False
    ) -> list[Load]:
        """The loads that make this push the only one on the arm, or one `beside` the others.

        Raises:
            LoadError: no such segment, or numbers that are not finite.
        """
        with self._lock:
            command = self._motion.advance(0.0)
            others = {} if beside else self._loads
            pushed = {number for number, force in others.items() if force.any()}
        forces = normal_force_n(self.mechanism, command, segment, angle_deg, magnitude_n)
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        return [*released, Load(segment, forces[segment - 1])] if segment else released

    def snapshot(self, now_s: float) -> Snapshot:
        """The present state, as far as it is known."""
        with self._lock:
            elapsed_s = 0.0 if self._motion_s is None else now_s - self._motion_s
            self._motion_s = now_s
            command = self._motion.advance(elapsed_s)
            fresh = now_s - self._state_s <= STALE_S
            state = self._state if fresh else ForceState.SILENT
            touched = state in _IN_CONTACT and now_s - self._estimate_s <= STALE_S
            estimates = self._estimated(command, now_s) if touched else ()
            true = self._true(command)
            bounds = None
            if state in _ANSWERED and (now_s - self._bounds_s <= STALE_S).all():
                low, high = self._bounds_n
                angles = (_angle_deg(low), _angle_deg(high)) if low.any() else None
                low_n, high_n = np.linalg.norm(self._bounds_n, axis=1).tolist()
                bounds = ForceBounds(low_n, high_n, angles)
            status = self._status(state, estimates, bounds, now_s)
            if now_s - self.tension_publisher.refused_s <= DIAGNOSTICS_STALE_S:
                note = f"{CABLE_TENSIONS} has two publishers; those of one are shown"
                status = ShownStatus(Level.ERROR, status.headline, (note, *status.notes))
            measured = self._joint_angles_rad
            return Snapshot(
                time_s=self._tensions_s if self._tensions_n is not None else now_s,
                joint_angles_rad=command if measured is None else measured,
                tensions_n=self._tensions_n,
                true=next(iter(true), None),
                state=state,
                estimate=next(iter(estimates), None),
                bounds=bounds,
                probabilities=self._probabilities if state.known else None,
                status=status,
                more_true=true[1:],
                more_estimated=estimates[1:],
            )

    def _true(self, command_rad: Array) -> tuple[ShownContact, ...]:
        """Of the loads what can be felt of them."""
        felt = [
            (n, np.array([0.0, float(y), float(z)]))
            for n, force in self._loads.items()
            for y, z in [normal_components_n(self.mechanism, command_rad, n, force)]
            if math.hypot(y, z) >= _LEAST_FELT_N
        ]
        return self._contacts(command_rad, felt)

    def _estimated(self, command_rad: Array, now_s: float) -> tuple[ShownContact, ...]:
        """Of each segment, from a model of several contacts; else the one contact."""
        several = [
            (n, local_n)
            for n, (since_s, local_n) in self._of_segments.items()
            if now_s - since_s <= STALE_S and np.abs(local_n).max() > 0.0
        ]
        one = [] if self._estimate is None else [self._estimate]
        return self._contacts(command_rad, several or one)

    def _contacts(
        self, command_rad: Array, forces: list[tuple[int, Array]]
    ) -> tuple[ShownContact, ...]:
        found = (self._contact(command_rad, *each) for each in forces)
        return tuple(sorted(found, key=lambda contact: -contact.magnitude_n))

    def _contact(self, command_rad: Array, segment: int, local_n: Array) -> ShownContact:
        force = segment_rotations(self.mechanism, command_rad)[segment - 1] @ local_n
        return ShownContact(segment, _angle_deg(local_n), float(np.linalg.norm(local_n)), force)

    def _status(
        self,
        state: ForceState,
        estimates: tuple[ShownContact, ...],
        bounds: ForceBounds | None,
        now_s: float,
    ) -> ShownStatus:
        """With the estimator's warnings as notes; where there are none, its first status."""
        if self._tensions_n is None:
            return ShownStatus(
                Level.STALE, "Waiting for cable_tensions", ("nothing has come yet",)
            )
        if (age_s := now_s - self._tensions_s) > STALE_S:
            return ShownStatus(Level.STALE, f"Tensions are stale, {age_s:.1f} s old")
        if not np.isfinite(self._state_s):
            return ShownStatus(Level.STALE, "Waiting for the estimator", ("nothing has come yet",))
        present = [
            (level, part, text)
            for part, (since_s, level, text) in self._health.items()
            if now_s - since_s <= DIAGNOSTICS_STALE_S
        ]
        present.sort(key=lambda status: -status[0])
        warnings = tuple(text for level, _, text in present if level is not Level.OK)
        notes = warnings[:3] or tuple(text for _, _, text in present[:1])
        headline = _HEADLINES[state]
        if estimates:
            numbers = " and ".join(str(n) for n in sorted(each.segment for each in estimates))
            headline = f"{headline} on segment{'s' if len(estimates) > 1 else ''} {numbers}"
        if state is ForceState.HIDDEN and bounds is not None:
            headline = f"{headline}; up to {bounds.high_n:.1f} N may act"
        level = _LEVELS.get(state, state.level)
        if level is not Level.STALE:
            doubts = (
                each
                for each, part, _ in present
                if each is Level.ERROR or (each is Level.WARN and part not in _HARMLESS)
            )
            level = max([level, *doubts])
        return ShownStatus(level, headline, notes)
