"""What is known of a running arm, put together from the contract's messages as they come.

Messages are duck-typed: no ROS is needed here.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_msgs_py.joint_states import NamedOrder, joint_command_rad
from cablesense_msgs_py.topics import Frames
from cablesense_msgs_py.wrenches import Load, read_load
from cablesense_online.page.snapshot import Contact, Level, Snapshot, Status
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import contact_angle_deg, normal_force_n

STALE_S = 0.5
"""Tensions and estimates older than this are not shown as the present."""
DIAGNOSTICS_STALE_S = 4.0
_LEVELS = (Level.OK, Level.WARNING, Level.ERROR, Level.STALE)


@dataclass
class _Heard:
    """The newest of everything, with the time it came."""

    tensions_s: float = -np.inf
    tensions_n: Array | None = None
    joint_angles_rad: Array | None = None
    loads: dict[int, Array] = field(default_factory=dict)
    estimate_s: float = -np.inf
    estimate: tuple[int, Array] | None = None
    probabilities: Array | None = None
    health: dict[str, tuple[float, int, str]] = field(default_factory=dict)


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
        self._heard = _Heard()
        self._lock = threading.Lock()

    def on_tensions(self, message: Any, now_s: float) -> None:
        """Takes a `cable_tensions` message."""
        tensions = self._cables.arrange(message.name, message.effort, "effort")
        with self._lock:
            self._heard.tensions_n, self._heard.tensions_s = tensions, now_s

    def on_joint_states(self, message: Any) -> None:
        """Takes a `joint_states` message."""
        angles = self._joints.arrange(message.name, message.position, "position")
        with self._lock:
            self._heard.joint_angles_rad = angles

    def on_joint_commands(self, message: Any) -> None:
        """Takes a `joint_commands` message: contact angles are counted at the commanded pose."""
        command = joint_command_rad(message, self._joints)
        with self._lock:
            self._motion.go_to(command)

    def on_load(self, message: Any) -> None:
        """Takes an `applied_wrench` message; it replaces the load on its segment."""
        load = read_load(message, self.frames)
        with self._lock:
            self._heard.loads[load.segment] = load.force_base_n

    def on_wrench(self, message: Any, now_s: float) -> None:
        """Takes the estimator's `wrench`: a force in the axes of its segment, or zero."""
        force = message.wrench.force
        local_n = np.array([force.x, force.y, force.z])
        estimate = None
        if local_n.any():
            estimate = (self.frames.segment_number(message.header.frame_id), local_n)
        with self._lock:
            self._heard.estimate, self._heard.estimate_s = estimate, now_s

    def on_probabilities(self, message: Any) -> None:
        """Takes the estimator's `contact_probabilities`; another length is not this arm's."""
        probabilities = np.asarray(message.data, dtype=float)
        if probabilities.shape == (self.mechanism.segment_count + 1,):
            with self._lock:
                self._heard.probabilities = probabilities

    def on_diagnostics(self, message: Any, now_s: float) -> None:
        """Takes a `/diagnostics` message and keeps what the estimator says of itself."""
        with self._lock:
            for status in message.status:
                node, _, part = status.name.partition(": ")
                if node.strip("/") == self._estimator and part:
                    level = min(int.from_bytes(status.level, "little"), len(_LEVELS) - 1)
                    self._heard.health[part] = (now_s, level, status.message)

    def content_with(self, part: str) -> bool:
        """Whether the estimator's last word on a part of itself, such as `tare`, was OK."""
        with self._lock:
            heard = self._heard.health.get(part)
        return heard is not None and heard[1] == 0

    def loads_of(self, segment: int, angle_deg: float, magnitude_n: float) -> list[Load]:
        """The loads that make this push, and no other, the only one on the arm.

        Raises:
            LoadError: no such segment, or figures that are not finite.
        """
        with self._lock:
            command = self._command_rad()
            pushed = {number for number, force in self._heard.loads.items() if force.any()}
        forces = normal_force_n(self.mechanism, command, segment, angle_deg, magnitude_n)
        released = [Load(number, np.zeros(3)) for number in sorted(pushed - {segment})]
        return [*released, Load(segment, forces[segment - 1])] if segment else released

    def snapshot(self, now_s: float) -> Snapshot:
        """The present, as far as it is known."""
        with self._lock:
            self._advance(now_s)
            heard, command = self._heard, self._command_rad()
            rotations = segment_rotations(self.mechanism, command)
            fresh = now_s - heard.estimate_s <= STALE_S
            estimate = self._estimated(heard.estimate, command, rotations) if fresh else None
            tensions_age_s = now_s - heard.tensions_s
            return Snapshot(
                time_s=heard.tensions_s if heard.tensions_n is not None else now_s,
                joint_angles_rad=(
                    command if heard.joint_angles_rad is None else heard.joint_angles_rad
                ),
                tensions_n=heard.tensions_n,
                true=self._true(heard.loads, command),
                estimate=estimate,
                probabilities=heard.probabilities if fresh else None,
                status=_status(heard, estimate, tensions_age_s, now_s),
            )

    def _advance(self, now_s: float) -> None:
        if self._motion_s is not None:
            self._motion.advance(now_s - self._motion_s)
        self._motion_s = now_s

    def _command_rad(self) -> Array:
        return self._motion.advance(0.0)

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


def _status(
    heard: _Heard, estimate: Contact | None, tensions_age_s: float, now_s: float
) -> Status:
    if heard.tensions_n is None:
        return Status(Level.STALE, "Waiting for cable_tensions", ("nothing has come yet",))
    if tensions_age_s > STALE_S:
        return Status(Level.STALE, f"Tensions are stale, {tensions_age_s:.1f} s old")
    if not np.isfinite(heard.estimate_s):
        return Status(Level.STALE, "Waiting for the estimator", ("no estimate has come yet",))
    if now_s - heard.estimate_s > STALE_S:
        age = now_s - heard.estimate_s
        return Status(Level.STALE, f"No estimate for {age:.1f} s", _notes(heard, now_s))
    level = _LEVELS[max((h[1] for h in _present(heard, now_s)), default=0)]
    headline = "No contact" if estimate is None else f"Contact on segment {estimate.segment}"
    return Status(level, headline, _notes(heard, now_s))


def _present(heard: _Heard, now_s: float) -> Iterable[tuple[float, int, str]]:
    return [h for h in heard.health.values() if now_s - h[0] <= DIAGNOSTICS_STALE_S]


def _notes(heard: _Heard, now_s: float) -> tuple[str, ...]:
    """What the estimator complains of; when it is content, what it says first."""
    lines = sorted(_present(heard, now_s), key=lambda h: -h[1])
    complaints = tuple(message for _, level, message in lines if level > 0)
    return complaints[:3] or tuple(message for _, _, message in lines[:1])
