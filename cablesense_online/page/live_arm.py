"""The state of a running arm as the page shows it, from the contract's messages, duck-typed."""

from __future__ import annotations

import math
import threading
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Contact,
    ForceState,
    Level,
    Load,
    NamedOrder,
    breath_turn,
    joint_command_rad,
    read_force_state,
    read_load,
    read_region,
)
from cablesense_msgs_py.topics import Frames
from cablesense_online.page.snapshot import (
    ANSWERED,
    IN_CONTACT,
    ForceBounds,
    PlaceInterval,
    ShownStatus,
    Snapshot,
    headline,
)
from cablesense_online.samples import FollowedPublisher
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import touched_at
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import chain, segment_rotations
from cablesense_sim.loads import LoadError, contact_of_wrench, normal_force_n

STALE_S = 0.5
"""Tensions and estimates older than this are not shown as the present."""
DIAGNOSTICS_STALE_S = 4.0
_NOTHING_ESTIMATED = (ForceState.MOVING, ForceState.UNTARED)
"""These are shown in grey; every other state is as severe as it says."""
_LEAST_FELT_N = 1e-3
_HARMLESS = ("cables", "cable_tensions")
"""Parts whose warnings lessen no trust: statics holds with slack cables, a lost sample is lost."""
_MOST_NOTES = 3


class _Wrench(NamedTuple):
    """In the frame of a segment; 0 is none, where force and torque are zero or not a number."""

    segment: int
    force_n: Array
    torque_n_m: Array


class LiveArm:
    """Takes messages and gives a Snapshot of the present; safe to call from several threads.

    Times are of one monotonic clock, s. Tensions of others than the `tension_publisher` are an
    error.
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
        self._reach_m, _ = touched_at(arm)
        self.frames = Frames(arm.segment_count, frame_prefix)
        self.tension_publisher = FollowedPublisher()
        self._estimator = estimator
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._motion = JointMotion(np.zeros(arm.joint_count), joint_speed_rad_s)
        self._motion_s: float | None = None
        self._came_s: dict[str, float] = {}  # time of the last message by topic
        self._tensions_n: Array | None = None
        self._joint_angles_rad: Array | None = None
        self._probabilities: Array | None = None
        self._state = ForceState.SILENT
        self._loads: dict[int, Load] = {}
        self._wrenches: dict[str, _Wrench] = {}  # by topic
        self._region: PlaceInterval | None = None
        self._health: dict[str, tuple[float, Level, str]] = {}
        self._lock = threading.Lock()

    def take(self, topic: str, message: Any, now_s: float) -> None:
        """Take a message of a topic as `cablesense_msgs_py.topics` names it.

        Raises:
            CableSenseError: it breaks the contract, or commands what the arm cannot do.
        """
        with self._lock:
            match topic:
                case topics.CABLE_TENSIONS:
                    self._tensions_n = self._cables.arrange(message.name, message.effort, "effort")
                case topics.JOINT_STATES:
                    self._joint_angles_rad = self._joints.arrange(
                        message.name, message.position, "position"
                    )
                case topics.JOINT_COMMANDS if breath_turn(message) is None:
                    # a breath leaves the pose at which contact angles are counted
                    command = joint_command_rad(message, self._joints, self._motion.target_rad)
                    self._motion.go_to(checked_command(self.mechanism, command))
                case topics.APPLIED_WRENCH:
                    load = read_load(message, self.frames, self._contact_of)
                    self._loads[load.segment] = load
                case topics.STATUS:
                    self._state, _ = read_force_state(message)
                case topics.CONTACT_PROBABILITIES:
                    probabilities = np.asarray(message.data, dtype=float)
                    if len(probabilities) == self.mechanism.segment_count + 1:
                        self._probabilities = probabilities
                case topics.CONTACT_REGION:
                    self._region = PlaceInterval(*read_region(message, self.frames))
                case topics.DIAGNOSTICS:
                    self._take_diagnostics(message, now_s)
                case _:
                    self._wrenches[topic] = self._local_wrench(message)
            self._came_s[topic] = now_s

    def _local_wrench(self, message: Any) -> _Wrench:
        vectors = (message.wrench.force, message.wrench.torque)
        force, torque = (np.array([each.x, each.y, each.z]) for each in vectors)
        acts = np.abs([force, torque]).max() > 0.0
        segment = self.frames.segment_number(message.header.frame_id) if acts else 0
        return _Wrench(segment, force, torque)

    def _take_diagnostics(self, message: Any, now_s: float) -> None:
        for status in message.status:
            node, _, part = status.name.partition(": ")
            if node.strip("/") == self._estimator and part:
                level = Level(min(int.from_bytes(status.level, "little"), Level.STALE))
                self._health[part] = now_s, level, status.message

    def _contact_of(self, force_n: Array, torque_n_m: Array) -> tuple[int, float]:
        pose = self._pose_rad
        return contact_of_wrench(self.mechanism, pose, self._reach_m, force_n, torque_n_m)

    @property
    def _pose_rad(self) -> Array:
        """(2N,) where the arm is measured to be, else where it is commanded."""
        measured = self._joint_angles_rad
        return self._motion.advance(0.0) if measured is None else measured

    def reports_ok(self, part: str) -> bool:
        """Whether the estimator's latest status of a part, such as `tare`, is OK."""
        latest = self._health.get(part)
        return latest is not None and latest[1] is Level.OK

    def loads_of(self, contact: Contact, *, beside: bool = False) -> list[Load]:
        """The loads that make this push the only one on the arm, or one more of several.

        Segment 0 is no push.

        Raises:
            LoadError: no such segment or place, or numbers that are not finite.
        """
        with self._lock:
            command = self._motion.advance(0.0)
            others = {} if beside else self._loads
            pushed = {number for number, load in others.items() if load.force_base_n.any()}
        segment, angle_deg, magnitude_n, place_m, along_n, _ = contact
        forces = normal_force_n(self.mechanism, command, segment, angle_deg, magnitude_n)
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        if not segment:
            return released
        length_m = self.mechanism.segment_length_m[segment - 1]
        if not (0.0 <= place_m <= length_m and math.isfinite(along_n)):
            raise LoadError(
                f"a push of {along_n} N along segment {segment}, at {place_m} m; both must be "
                f"finite, and the place from 0 to {length_m:g} m"
            )
        axis = segment_rotations(self.mechanism, command)[segment - 1, :, 0]
        return [*released, Load(segment, forces[segment - 1] + along_n * axis, place_m)]

    def torque_n_m(self, load: Load) -> Array | None:
        """(3,) of a load about the base frame's origin, by which it states its place.

        None for a load that acts at the contact point of its segment, or has no place: an axial
        one and one of zero.
        """
        n = load.segment - 1
        with self._lock:
            pose = chain(self.mechanism, self._pose_rad)
        axis = pose.rotation[n, :, 0]
        lateral_n = _norm(np.cross(axis, load.force_base_n))
        usual_m = self.mechanism.contact_m[n]
        if load.contact_m is None or load.contact_m == usual_m or lateral_n < _LEAST_FELT_N:
            return None
        return np.cross(pose.joint_m[n] + load.contact_m * axis, load.force_base_n)

    def snapshot(self, now_s: float) -> Snapshot:
        """The present state, as far as it is known."""
        with self._lock:
            elapsed_s = 0.0 if self._motion_s is None else now_s - self._motion_s
            self._motion_s = now_s
            command = self._motion.advance(elapsed_s)
            state = self._state if self._fresh(topics.STATUS, now_s) else ForceState.SILENT
            estimated = self._estimated(now_s) if state in IN_CONTACT else ()
            moment = self._moment(now_s) if state in IN_CONTACT else None
            bounds = self._bounds(now_s) if state in ANSWERED else None
            located = state in IN_CONTACT and self._fresh(topics.CONTACT_REGION, now_s)
            said = headline(state, estimated, bounds, moment)
            return Snapshot(
                time_s=self._came_s.get(topics.CABLE_TENSIONS, now_s),
                joint_angles_rad=self._pose_rad,
                command_rad=command,
                tensions_n=self._tensions_n,
                true=self._true(command),
                state=state,
                estimated=estimated,
                bounds=bounds,
                probabilities=self._probabilities if state.known else None,
                status=self._status(state, said, now_s),
                moment=moment,
                region=self._region if located else None,
            )

    def _fresh(self, topic: str, now_s: float) -> bool:
        return now_s - self._came_s.get(topic, -math.inf) <= STALE_S

    def _true(self, command_rad: Array) -> tuple[Contact, ...]:
        rotations = segment_rotations(self.mechanism, command_rad)
        felt = []
        for n, load in self._loads.items():
            usual_m = float(self.mechanism.contact_m[n - 1])
            place_m = usual_m if load.contact_m is None else load.contact_m
            if _norm(load.force_base_n) >= _LEAST_FELT_N:
                force_n = (load.force_base_n @ rotations[n - 1]).tolist()
                felt.append(Contact.of_force(n, force_n, place_m))
        return _strongest_first(felt)

    def _estimated(self, now_s: float) -> tuple[Contact, ...]:
        """Contacts of all segments, from a model of several contacts; else the one contact."""
        numbers = range(1, self.mechanism.segment_count + 1)
        several = [topics.SEGMENT_WRENCHES.format(number) for number in numbers]
        return self._pushing(several, now_s) or self._pushing([topics.WRENCH], now_s)

    def _pushing(self, wrenches: list[str], now_s: float) -> tuple[Contact, ...]:
        """The contacts of those wrenches that are fresh and push."""
        present = [self._wrenches[topic] for topic in wrenches if self._fresh(topic, now_s)]
        pushing = [each for each in present if each.segment and each.force_n[1:].any()]
        return _strongest_first(
            [Contact.of_force(n, f.tolist(), _place_m(f, t)) for n, f, t in pushing]
        )

    def _moment(self, now_s: float) -> Contact | None:
        if not self._fresh(topics.WRENCH, now_s):
            return None
        segment, force_n, (_, y, z) = self._wrenches[topics.WRENCH]
        if not segment or force_n[1:].any():
            return None
        angle_deg = _angle_deg(np.array([0.0, z, -y]))
        return Contact(segment, angle_deg, moment_n_m=math.hypot(y, z))

    def _bounds(self, now_s: float) -> ForceBounds | None:
        ends = (topics.WRENCH_LOWER, topics.WRENCH_UPPER)
        if not all(self._fresh(topic, now_s) for topic in ends):
            return None
        low, high = (self._wrenches[topic].force_n for topic in ends)
        angles = (_angle_deg(low), _angle_deg(high)) if low.any() else None
        return ForceBounds(_norm(low[1:]), _norm(high[1:]), angles)

    def _status(self, state: ForceState, said: str, now_s: float) -> ShownStatus:
        """The headline `said`, with the estimator's warnings, or else its first status."""
        status = self._waiting(now_s)
        if status is None:
            present = sorted(
                (
                    (level, part, text)
                    for part, (since_s, level, text) in self._health.items()
                    if now_s - since_s <= DIAGNOSTICS_STALE_S
                ),
                key=lambda one: -one[0],
            )
            warnings = [text for level, _, text in present if level is not Level.OK]
            notes = warnings[:_MOST_NOTES] or [text for _, _, text in present[:1]]
            doubts = [
                level
                for level, part, _ in present
                if level is Level.ERROR or (level is Level.WARN and part not in _HARMLESS)
            ]
            grey = state in _NOTHING_ESTIMATED
            level = Level.STALE if grey else max([state.level, *doubts])
            status = ShownStatus(level, said, tuple(notes))
        if now_s - self.tension_publisher.refused_s <= DIAGNOSTICS_STALE_S:
            note = f"{topics.CABLE_TENSIONS} has two publishers; those of one are shown"
            status = ShownStatus(Level.ERROR, status.headline, (note, *status.notes))
        return status

    def _waiting(self, now_s: float) -> ShownStatus | None:
        """The status until tensions and estimates come."""
        if self._tensions_n is None:
            return ShownStatus(Level.STALE, "Waiting for cable_tensions")
        if (age_s := now_s - self._came_s[topics.CABLE_TENSIONS]) > STALE_S:
            return ShownStatus(Level.STALE, f"Tensions are stale, {age_s:.1f} s old")
        if topics.STATUS not in self._came_s:
            return ShownStatus(Level.STALE, "Waiting for the estimator")
        return None


def _strongest_first(contacts: list[Contact]) -> tuple[Contact, ...]:
    return tuple(sorted(contacts, key=lambda contact: -contact.magnitude_n))


def _place_m(force_n: Array, torque_n_m: Array) -> float:
    """Where on the axis a force acts, by its torque about the segment's origin."""
    (_, y, z), (_, torque_y, torque_z) = force_n, torque_n_m
    return float((y * torque_z - z * torque_y) / (y * y + z * z))


def _angle_deg(local_n: Array) -> float:
    return float(np.rad2deg(np.arctan2(local_n[1], local_n[2])) % 360.0)


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))
