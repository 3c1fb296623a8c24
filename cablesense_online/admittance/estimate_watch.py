"""The contact state as far as the estimator can be trusted: stopped, unknown, free or contact.

A wrench of zero stands for three things: nothing touches, no estimate while the arm moves, and no
usable samples. They differ:

- a wrench in a segment's frame is an estimate of a contact;
- probabilities come with estimates only, so that a zero wrench beside them is an estimate that
  nothing touches, and one without them is no estimate;
- after a new command the estimator may give no estimate for as long as the arm moves and settles;
  when it gives none for longer, something is wrong.

Messages of the estimator are read here as well; one that breaks the contract is refused.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import MAX_LOAD_N, Level
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.admittance.law import AdmittanceSettings
from cablesense_online.motion_gate import MotionGate

PROBABILITIES_KEPT = 8


class ContactState(Enum):
    """What is known of contacts at this moment."""

    STOPPED = "stopped"
    UNKNOWN = "unknown"
    FREE = "free"
    CONTACT = "contact"


class EstimateWatch:
    """Follows all that the estimator publishes; times are monotonic, s.

    Attributes:
        reason: why the state is `STOPPED`; empty when it is not.
    """

    def __init__(self, command_rad: Array, settings: AdmittanceSettings, now_s: float) -> None:
        """The arm holds `command_rad` (2N,); nothing was received from the estimator yet."""
        self._settings = settings
        self._gate = MotionGate(command_rad, settings.joint_speed_rad_s, settings.settle_s)
        self._contact_s = self._fresh_s = self._stale_report_s = float("-inf")
        self._probabilities_s: deque[float] = deque(maxlen=PROBABILITIES_KEPT)
        self._moved_until_s = now_s
        self._estimating_since_s: float | None = None
        self._fault, self._last_fault = "", "none had come"
        self.state = ContactState.STOPPED
        self.reason = "no estimate yet"

    def commanded(self, command_rad: Array, now_s: float) -> None:
        """A command (2N,) is in force; estimates from before it count no more."""
        if self._gate.command(command_rad):
            self._moving(now_s)
            self._contact_s = float("-inf")
            self._probabilities_s.clear()

    def received_wrench(self, contact: bool, age_s: float, now_s: float) -> bool:
        """A wrench came, `contact` where it is in a segment's frame; gives whether it is fresh."""
        if abs(age_s) > self._settings.stale_after_s:
            return False
        self._fresh_s = now_s
        if contact:
            self._contact_s = now_s
        return True

    def received_probabilities(self, now_s: float) -> None:
        """Probabilities came, so an estimate was made."""
        self._probabilities_s.append(now_s)

    def received_input_state(self, stale: bool, now_s: float) -> None:
        """The estimator reported on its samples; it has none where `stale`."""
        self._stale_report_s = now_s if stale else float("-inf")

    def refused(self, why: str) -> None:
        """A message broke the contract: stop."""
        self._fault = why

    def probabilities_since(self, since_s: float) -> int:
        """How many probabilities came after a moment, up to `PROBABILITIES_KEPT`."""
        return sum(1 for time_s in self._probabilities_s if time_s > since_s)

    def publishing(self, now_s: float) -> bool:
        """Whether wrenches with fresh stamps come, whatever is in them."""
        return now_s - self._fresh_s <= self._settings.stale_after_s

    def update(self, now_s: float) -> ContactState:
        """Decide what can be known now; to be called at least every 20 ms."""
        fault, self._fault = self._fault or self._silence(now_s), ""
        estimating = now_s - self._estimate_s <= self._settings.stale_after_s
        if fault or not estimating:
            self._estimating_since_s = None
        elif self._estimating_since_s is None:
            self._estimating_since_s = now_s
        since_s, resume_after_s = self._estimating_since_s, self._settings.resume_after_s
        if fault:
            self.state, self.reason, self._last_fault = ContactState.STOPPED, fault, fault
        elif self.state is ContactState.STOPPED:
            if since_s is None:
                self.reason = "waiting for estimates"
            elif now_s - since_s < resume_after_s:
                back = f"estimates are back; trusted after {resume_after_s:g} s"
                self.reason = f"{self._last_fault}; {back}"
            else:
                self.state, self.reason = ContactState.UNKNOWN, ""
        if self.state is not ContactState.STOPPED:
            touched = now_s - self._contact_s <= self._settings.stale_after_s
            known = ContactState.CONTACT if touched else ContactState.FREE
            self.state = known if estimating else ContactState.UNKNOWN
        return self.state

    @property
    def _estimate_s(self) -> float:
        return max((self._contact_s, *self._probabilities_s))

    def _moving(self, now_s: float) -> bool:
        now_ns = round(now_s * 1e9)
        return self._gate.moving(now_ns, now_ns, now_s)

    def _silence(self, now_s: float) -> str:
        silent_s = now_s - self._fresh_s
        if silent_s > self._settings.stale_after_s:
            return (
                f"no wrench with a fresh stamp for {silent_s:.1f} s"
                if np.isfinite(silent_s)
                else "no wrench has come yet"
            )
        if self._stale_report_s > self._estimate_s:
            return "the estimator reports that its samples are stale"
        if self._moving(now_s):
            self._moved_until_s = now_s
            return ""
        mute_s = now_s - max(self._estimate_s, self._moved_until_s)
        if mute_s > self._settings.stale_after_s:
            return f"the estimator gives no estimate, though the arm has rested for {mute_s:.1f} s"
        return ""


def read_wrench(message: Any, frames: Frames) -> tuple[int, Array, int]:
    """Segment, force (3,) in its axes, N, and stamp, ns, of the estimate in a `WrenchStamped`.

    The segment is 0, and the force zero, where nothing touches, or nothing is known.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, or a force in
            the base frame, where there is none.
    """
    force = message.wrench.force
    components = (force.x, force.y, force.z)
    if not math.hypot(*components) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {components} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    frame = message.header.frame_id
    segment = 0 if frame == frames.base else frames.segment_number(frame)
    if segment == 0 and any(components):
        raise ContractError(
            f"wrench.force is {components} N in {frame}; a contact comes in its segment's frame"
        )
    stamp = message.header.stamp
    return segment, np.array(components), stamp.sec * 1_000_000_000 + stamp.nanosec


def check_probabilities(message: Any, segment_count: int) -> None:
    """Make sure that a `Float64MultiArray` holds this arm's probabilities.

    Raises:
        ContractError: another number of them, or one that is none.
    """
    if len(message.data) != segment_count + 1 or not all(0.0 <= p <= 1.0 for p in message.data):
        raise ContractError(
            f"data holds {list(message.data)[:8]}; it must hold {segment_count + 1} probabilities"
        )


def input_is_stale(message: Any, estimator: str) -> bool | None:
    """Whether a `DiagnosticArray` reports that a node of this name has no samples.

    None where it reports nothing of them.
    """
    for status in message.status:
        node, _, part = status.name.partition(": ")
        if part == "cable_tensions" and node.strip("/") == estimator.strip("/"):
            return int.from_bytes(status.level, "little") == Level.STALE
    return None
