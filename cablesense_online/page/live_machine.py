"""The state of a running machine as the page shows it, from the messages, duck-typed."""

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
    read_region,
)
from cablesense_msgs_py.topics import ContractError
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.page.headline import headline
from cablesense_online.page.shown import ShownMachine
from cablesense_online.page.snapshot import (
    IN_CONTACT,
    CommissioningProgress,
    ForceBounds,
    PlaceInterval,
    ShownStatus,
    Snapshot,
)
from cablesense_online.placed_links import PlacedLinks, contact_frames
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import LoadError

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


class LiveMachine:
    """Takes messages and gives a Snapshot of the present; safe to call from several threads.

    Times are of one monotonic clock, s. Tensions of others than the `tension_publisher` are an
    error.

    Attributes:
        shown: the machine.
        frames: of the messages.
    """

    def __init__(
        self,
        shown: ShownMachine,
        *,
        joint_speed_rad_s: float,
        frame_prefix: str = "",
        estimator: str = "estimator",
        commissioner: str = "commissioner",
    ) -> None:
        felt = shown.felt
        self.shown = shown
        self.frames = contact_frames(felt, frame_prefix)
        self.tension_publisher = FollowedPublisher()
        self._placed = PlacedLinks(felt.link_frames)
        self._estimator = estimator
        self._commissioner = commissioner
        among_others = felt.reads_joints
        self._channels = NamedOrder(felt.channels.names, "cables", among_others=among_others)
        self._joints = NamedOrder(felt.torque_names, "joints", among_others=among_others)
        self._commands = NamedOrder(felt.command_names, "joints")
        self._motion = JointMotion.at_rest(felt.first_command, joint_speed_rad_s)
        self._motion_s: float | None = None
        self._came_s: dict[str, float] = {}  # time of the last message by topic
        self._readings: Array | None = None
        self._measured: Array | None = None
        self._probabilities: Array | None = None
        self._state = ForceState.SILENT
        self._loads: dict[int, Load] = {}
        numbers = range(1, self.frames.segment_count + 1)
        self._of_links = [topics.SEGMENT_WRENCHES.format(number) for number in numbers]
        self._wrench_topics = frozenset(
            [topics.WRENCH, topics.WRENCH_LOWER, topics.WRENCH_UPPER, *self._of_links]
        )
        self._wrenches: dict[str, _Wrench] = {}  # by topic
        self._region: tuple[PlaceInterval, ...] = ()
        self._health: dict[str, _Health] = {}
        self._commissioning: _Health | None = None
        self._lock = threading.Lock()

    def take(self, topic: str, message: Any, now_s: float) -> None:
        """Take a message of a topic as `cablesense_msgs_py.topics` names it.

        Raises:
            CableSenseError: it breaks the contract, or commands what the machine cannot do; or
                the topic is not shown.
        """
        with self._lock:
            match topic:
                case topics.CABLE_TENSIONS:
                    self._readings = self._channels.arrange(message.name, message.effort, "effort")
                case topics.JOINT_STATES:
                    self._measured = self._joints.arrange(
                        message.name, message.position, "position"
                    )
                case topics.JOINT_COMMANDS:
                    self._take_command(message)
                case topics.APPLIED_WRENCH:
                    load = self.shown.read_load(message, self.frames, self._pose)
                    self._loads[load.segment] = load
                case topics.STATUS:
                    self._state, _ = read_force_state(message)
                case topics.CONTACT_PROBABILITIES:
                    probabilities = np.asarray(message.data, dtype=float)
                    if len(probabilities) == self.frames.segment_count + 1:
                        self._probabilities = probabilities
                case topics.CONTACT_REGION:
                    self._region = self._covered(*read_region(message, self.frames))
                case topics.DIAGNOSTICS:
                    self._take_diagnostics(message, now_s)
                case _ if topic in self._wrench_topics:
                    self._wrenches[topic] = self._local_wrench(message)
                case _:
                    raise ContractError(
                        f"{topic} is none of the topics that are shown, which are those of "
                        "readings, commands, loads, estimates and diagnostics"
                    )
            self._came_s[topic] = now_s

    def _take_command(self, message: Any) -> None:
        """A breath's are passed over: contact angles are counted at the pose before it."""
        if breath_turn(message) is not None:
            return
        largest = self.shown.felt.largest_command
        target = self._motion.target_rad
        command = joint_command_rad(message, self._commands, target, largest)
        self._motion = self._motion.towards(self.shown.checked_command(command))

    def _local_wrench(self, message: Any) -> _Wrench:
        vectors = (message.wrench.force, message.wrench.torque)
        force, torque = (np.array([vector.x, vector.y, vector.z]) for vector in vectors)
        acts = np.abs([force, torque]).max() > 0.0
        segment = self.frames.segment_number(message.header.frame_id) if acts else 0
        return _Wrench(segment, *self._placed.wrench_on_axis(segment, force, torque))

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

    def _covered(self, segment: int, ends_m: Array) -> tuple[PlaceInterval, ...]:
        """What an interval of places between two points (2, 3) of a link's frame covers."""
        low_m, high_m = sorted(self._placed.place_m(segment, end_m) for end_m in ends_m)
        return self.shown.covered(segment, low_m, high_m)

    @property
    def _pose(self) -> Array:
        """(T,) where the machine is measured to be, else where its command leaves it."""
        if self._measured is not None:
            return self._measured
        return self.shown.pose_of(self._motion.angle_rad)

    @property
    def _frame_pose(self) -> Array:
        """(T,) the pose in whose axes contacts are."""
        felt = self.shown.felt
        pose = self._pose
        return felt.frame_pose(pose if felt.reads_joints else self._motion.angle_rad, pose)

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
        """The loads that make this push the only one on the machine, or one more of several.

        Segment 0 is no push.

        Raises:
            LoadError: no such segment or place, or numbers that are not finite.
        """
        with self._lock:
            frame_pose = self._frame_pose
            others = {} if beside else self._loads
            pushed = {number for number, load in others.items() if load.force_base_n.any()}
        segment, _, magnitude_n, place_m, along_n, _ = contact
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        if not segment:
            return released
        words = self.shown.words
        count = len(words.links)
        if not 1 <= segment <= count:
            raise LoadError(f"{words.link} {segment}; it must be a number from 1 to {count}")
        local_n = np.array(contact.wrench[:3])
        if not (np.isfinite(local_n).all() and magnitude_n >= 0.0):
            raise LoadError(
                f"a push of {magnitude_n} N, and {along_n} N along {words.of_link(segment)}; both "
                "must be finite, and the first from 0 up"
            )
        first_m, last_m = self.shown.touched_m[segment - 1].tolist()
        if not first_m <= place_m <= last_m:
            raise LoadError(
                f"a push on {words.of_link(segment)}, at {place_m} m; it is touched from "
                f"{first_m:g} to {last_m:g} m"
            )
        axes = self.shown.links_at(frame_pose).axes[segment - 1]
        return [*released, Load(segment, axes @ local_n, place_m)]

    def load_frame(self, load: Load) -> tuple[str, Array]:
        """The frame of the message of a load, and the torque (3,) that states its place."""
        with self._lock:
            pose = self._pose
        return self.shown.load_frame(load, self.frames, pose)

    def snapshot(self, now_s: float) -> Snapshot:
        """The present state, as far as it is known."""
        with self._lock:
            elapsed_s = 0.0 if self._motion_s is None else now_s - self._motion_s
            self._motion_s = now_s
            self._motion = self._motion.after(elapsed_s)
            frame_pose = self._frame_pose
            state = self._state if self._fresh(topics.STATUS, now_s) else ForceState.SILENT
            estimated = self._estimated(now_s) if state in IN_CONTACT else ()
            moment = self._moment(now_s) if state in IN_CONTACT else None
            bounds = self._bounds(now_s) if state in _BOUNDED else None
            located = state in IN_CONTACT and self._fresh(topics.CONTACT_REGION, now_s)
            sentence = headline(state, estimated, bounds, moment, self.shown.words)
            return Snapshot(
                time_s=self._came_s.get(topics.CABLE_TENSIONS, now_s),
                pose=self._pose,
                frame_pose=frame_pose,
                readings=self._readings,
                true=self._true(frame_pose),
                state=state,
                estimated=estimated,
                bounds=bounds,
                probabilities=self._probabilities if state.known else None,
                status=self._status(state, sentence, now_s),
                known_by_moment=moment,
                region=self._region if located else (),
                machine_known=self._known(now_s),
                commissioning=self._commissioning_progress(now_s),
            )

    def _known(self, now_s: float) -> str:
        """How well the estimator says that it knows its machine."""
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

    def _true(self, frame_pose: Array) -> tuple[Contact, ...]:
        loads = {
            number: load
            for number, load in self._loads.items()
            if _norm(load.force_base_n) >= _LEAST_FELT_N
        }
        if not loads:
            return ()
        axes = self.shown.links_at(frame_pose).axes
        contacts = []
        for number, load in loads.items():
            usual_m = float(self.shown.usual_m[number - 1])
            place_m = usual_m if load.contact_m is None else load.contact_m
            force_n = (load.force_base_n @ axes[number - 1]).tolist()
            contacts.append(Contact.of_force(number, force_n, place_m))
        return _strongest_first(contacts)

    def _estimated(self, now_s: float) -> tuple[Contact, ...]:
        """Contacts of all links, from a model of several contacts; else the one contact."""
        return self._pushing(self._of_links, now_s) or self._pushing([topics.WRENCH], now_s)

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

    def _status(self, state: ForceState, sentence: str, now_s: float) -> ShownStatus:
        """The headline `sentence`, with the warnings of estimator and commissioner."""
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
            status = ShownStatus(level, sentence, notes)
        if now_s - self.tension_publisher.refused_s <= DIAGNOSTICS_STALE_S:
            note = f"{topics.CABLE_TENSIONS} has two publishers; those of one are shown"
            status = ShownStatus(Level.ERROR, status.headline, (note, *status.notes))
        return status

    def _waiting(self, now_s: float) -> ShownStatus | None:
        """The status until readings and estimates come."""
        if self._readings is None:
            return ShownStatus(Level.STALE, "Waiting for cable_tensions")
        if (age_s := now_s - self._came_s[topics.CABLE_TENSIONS]) > STALE_S:
            return ShownStatus(Level.STALE, f"Readings are stale, {age_s:.1f} s old")
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
