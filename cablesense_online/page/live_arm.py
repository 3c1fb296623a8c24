"""The state of a running arm as the page shows it, from the contract's messages, duck-typed."""

from __future__ import annotations

import math
import threading
from itertools import pairwise
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
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.page.snapshot import (
    IN_CONTACT,
    CommissioningProgress,
    ForceBounds,
    PlaceInterval,
    ShownStatus,
    Snapshot,
    headline,
)
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import chain, segment_rotations
from cablesense_sim.loads import LoadError, contact_of_wrench, normal_force_n
from cablesense_sim.touch import touched_places

STALE_S = 0.5
"""Tensions and estimates older than this are not shown as the present."""
DIAGNOSTICS_STALE_S = 4.0
"""Age of a status at which it is not shown any more: nodes publish one a second."""
_NOTHING_ESTIMATED = (ForceState.MOVING, ForceState.UNTARED)
"""These are shown in grey; every other state is as severe as it says."""
_BOUNDED = (*IN_CONTACT, ForceState.HIDDEN)
"""The interval of an untouched arm is of a force that nobody claims, on a segment that changes."""
_LEAST_FELT_N = 1e-3
"""Force that counts as zero: it is not drawn."""
_HARMLESS = ("cables", "cable_tensions")
"""Parts whose warnings lessen no trust: statics holds with slack cables, a lost sample is lost."""
_MOST_NOTES = 3
"""Warnings that are shown at once: more do not fit a phone."""
_LAST_REFUSAL = "last refusal"
_HOLDS = "holds"
_LEFT = "left (s)"
"""Figures of the commissioner's status: all of them while it is at work."""


class _Health(NamedTuple):
    """The latest status of a part of a node, and when it came."""

    came_s: float
    level: Level
    message: str
    values: dict[str, str]

    @property
    def sentence(self) -> str:
        """What is wrong, as exactly as it is known."""
        refusal = self.values.get(_LAST_REFUSAL, "")
        return refusal if self.level is Level.ERROR and refusal else self.message


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
        commissioner: str = "commissioner",
    ) -> None:
        self.mechanism = mechanism_of(arm)
        self._reach_m = touched_places(arm).touched_m
        self.frames = Frames(arm.segment_count, frame_prefix)
        self.tension_publisher = FollowedPublisher()
        self._estimator = estimator
        self._commissioner = commissioner
        length_m = self.mechanism.segment_length_m
        self._ends_m = np.concatenate([[0.0], np.cumsum(length_m)])
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._motion = JointMotion.at_rest(np.zeros(arm.joint_count), joint_speed_rad_s)
        self._motion_s: float | None = None
        self._came_s: dict[str, float] = {}  # time of the last message by topic
        self._tensions_n: Array | None = None
        self._joint_angles_rad: Array | None = None
        self._probabilities: Array | None = None
        self._state = ForceState.SILENT
        self._loads: dict[int, Load] = {}
        self._wrenches: dict[str, _Wrench] = {}  # by topic
        self._region: tuple[PlaceInterval, ...] = ()
        self._health: dict[str, _Health] = {}
        self._commissioning: _Health | None = None
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
                    checked = checked_command(self.mechanism, command)
                    self._motion = self._motion.towards(checked)
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
                    self._region = self._covered(*read_region(message, self.frames))
                case topics.DIAGNOSTICS:
                    self._take_diagnostics(message, now_s)
                case _:
                    self._wrenches[topic] = self._local_wrench(message)
            self._came_s[topic] = now_s

    def _local_wrench(self, message: Any) -> _Wrench:
        vectors = (message.wrench.force, message.wrench.torque)
        force, torque = (np.array([vector.x, vector.y, vector.z]) for vector in vectors)
        acts = np.abs([force, torque]).max() > 0.0
        segment = self.frames.segment_number(message.header.frame_id) if acts else 0
        return _Wrench(segment, force, torque)

    def _take_diagnostics(self, message: Any, now_s: float) -> None:
        for status in message.status:
            node, _, part = status.name.partition(": ")
            level = Level(min(int.from_bytes(status.level, "little"), Level.STALE))
            values = {pair.key: pair.value for pair in status.values}
            health = _Health(now_s, level, status.message, values)
            if node.strip("/") == self._estimator and part:
                self._health[part] = health
            elif node.strip("/") == self._commissioner and part:
                self._commissioning = health

    def _covered(self, segment: int, low_m: float, high_m: float) -> tuple[PlaceInterval, ...]:
        """What an interval of places covers of each segment, straight on beyond its ends."""
        from_base_m = float(self._ends_m[segment - 1])
        covered = []
        for n, (begin_m, end_m) in enumerate(pairwise(self._ends_m.tolist()), start=1):
            # the ends of the arm are as good as what lies beyond them
            first_m = min(max(from_base_m + low_m, begin_m), end_m)
            last_m = min(max(from_base_m + high_m, begin_m), end_m)
            if last_m > first_m or n == segment:
                covered.append(PlaceInterval(n, first_m - begin_m, last_m - begin_m))
        return tuple(covered)

    def _contact_of(self, force_n: Array, torque_n_m: Array) -> tuple[int, float]:
        pose = self._pose_rad
        return contact_of_wrench(self.mechanism, pose, self._reach_m, force_n, torque_n_m)

    @property
    def _pose_rad(self) -> Array:
        """(2N,) where the arm is measured to be, else where it is commanded."""
        measured = self._joint_angles_rad
        return self._motion.angle_rad if measured is None else measured

    def reports_ok(self, part: str) -> bool:
        """Whether the estimator's latest status of a part, such as `tare`, is OK."""
        latest = self._health.get(part)
        return latest is not None and latest.level is Level.OK

    @property
    def commissioned(self) -> str | None:
        """How the last commissioning ended, as a sentence.

        None while one is under way, and before the first.
        """
        latest = self._commissioning
        if latest is None or _HOLDS not in latest.values or _LEFT in latest.values:
            return None
        return latest.message

    def loads_of(self, contact: Contact, *, beside: bool = False) -> list[Load]:
        """The loads that make this push the only one on the arm, or one more of several.

        Segment 0 is no push.

        Raises:
            LoadError: no such segment or place, or numbers that are not finite.
        """
        with self._lock:
            command = self._motion.angle_rad
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
            self._motion = self._motion.after(elapsed_s)
            command = self._motion.angle_rad
            state = self._state if self._fresh(topics.STATUS, now_s) else ForceState.SILENT
            estimated = self._estimated(now_s) if state in IN_CONTACT else ()
            moment = self._moment(now_s) if state in IN_CONTACT else None
            bounds = self._bounds(now_s) if state in _BOUNDED else None
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
                region=self._region if located else (),
                arm_known=self._known(now_s),
                commissioning=self._commissioning_progress(now_s),
            )

    def _known(self, now_s: float) -> str:
        """How well the estimator says that it knows its arm."""
        latest = self._health.get("tare")
        if latest is None or latest.level is not Level.OK or not _is_recent(latest, now_s):
            return ""
        return latest.message

    def _commissioning_progress(self, now_s: float) -> CommissioningProgress | None:
        latest = self._commissioning
        if latest is None or _LEFT not in latest.values or not _is_recent(latest, now_s):
            return None
        done, _, holds = latest.values.get(_HOLDS, "").partition(" of ")
        if not (done.isdecimal() and holds.isdecimal()):
            return None
        return CommissioningProgress(int(done), int(holds))

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
        pushing = [wrench for wrench in present if wrench.segment and wrench.force_n[1:].any()]
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
        """The headline `said`, with the warnings of estimator and commissioner."""
        status = self._waiting(now_s)
        if status is None:
            present = {
                part: latest for part, latest in self._health.items() if _is_recent(latest, now_s)
            }
            doubts = [
                latest.level
                for part, latest in present.items()
                if latest.level is Level.ERROR
                or (latest.level is Level.WARN and part not in _HARMLESS)
            ]
            warned = list(present.values())
            if self._commissioning is not None and _is_recent(self._commissioning, now_s):
                warned.append(self._commissioning)
            warned = [latest for latest in warned if latest.level is not Level.OK]
            warned.sort(key=lambda latest: -latest.level)
            notes = tuple(latest.sentence for latest in warned[:_MOST_NOTES])
            grey = state in _NOTHING_ESTIMATED
            level = Level.STALE if grey else max([state.level, *doubts])
            status = ShownStatus(level, said, notes)
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


def _is_recent(latest: _Health, now_s: float) -> bool:
    return now_s - latest.came_s <= DIAGNOSTICS_STALE_S


def _strongest_first(contacts: list[Contact]) -> tuple[Contact, ...]:
    return tuple(sorted(contacts, key=lambda contact: -contact.magnitude_n))


def _place_m(force_n: Array, torque_n_m: Array) -> float:
    """Where on the axis a force acts, by its torque about the segment's origin."""
    (_, y, z) = force_n
    (_, torque_y, torque_z) = torque_n_m
    return float((y * torque_z - z * torque_y) / (y * y + z * z))


def _angle_deg(local_n: Array) -> float:
    return float(np.rad2deg(np.arctan2(local_n[1], local_n[2])) % 360.0)


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))
