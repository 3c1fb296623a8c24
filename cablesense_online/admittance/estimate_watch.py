"""The contact state as far as the estimator can be trusted: stopped, unknown, free or contact.

What each wrench stands for the estimator states itself, on `~/status`. Kept here is whether it
goes on doing so, with fresh stamps, and for how long the force has been unknown for another reason
than that the arm moves or that friction hides it.

Messages of the estimator are read here as well; one that breaks the contract is refused.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from enum import Enum
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import MAX_LOAD_N, ForceState
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.admittance.law import AdmittanceSettings

_PAIRS_KEPT = 64

_EXPECTED = (ForceState.MOVING, ForceState.HIDDEN)
"""States without a force that are no fault, however long they last."""


class ContactState(Enum):
    """What is known of contacts at this moment."""

    STOPPED = "stopped"
    UNKNOWN = "unknown"
    FREE = "free"
    CONTACT = "contact"


_KNOWN = {ForceState.FREE: ContactState.FREE, ForceState.CONTACT: ContactState.CONTACT}


class EstimateWatch:
    """Follows the estimator's states; times are monotonic, s.

    Attributes:
        reason: why the state is `STOPPED`; empty when it is not.
    """

    def __init__(self, settings: AdmittanceSettings, now_s: float) -> None:
        """Nothing was received from the estimator yet."""
        self._settings = settings
        self._force = ForceState.SILENT
        self._fresh_s = float("-inf")
        self._sound_s = now_s
        self._trusted_from_s: float | None = None
        self._fault, self._last_fault = "", "none had come"
        self.state = ContactState.STOPPED
        self.reason = "no estimate yet"

    def received(self, force: ForceState, age_s: float, now_s: float) -> bool:
        """A state came whose sample is `age_s` old; gives whether it is fresh."""
        if abs(age_s) > self._settings.stale_after_s:
            return False
        self._force, self._fresh_s = force, now_s
        if force.known or force in _EXPECTED:
            self._sound_s = now_s
        return True

    def refused(self, why: str) -> None:
        """A message broke the contract: stop."""
        self._fault = why

    def publishing(self, now_s: float) -> bool:
        """Whether states with fresh stamps come, whatever they are."""
        return now_s - self._fresh_s <= self._settings.stale_after_s

    def update(self, now_s: float) -> ContactState:
        """Decide what can be known now; to be called at least every 20 ms."""
        fault, self._fault = self._fault or self._silence(now_s), ""
        if fault or not (self._force.known or self._force is ForceState.HIDDEN):
            self._trusted_from_s = None
        elif self._trusted_from_s is None:
            self._trusted_from_s = now_s + self._settings.resume_after_s
        if fault:
            self.state, self.reason, self._last_fault = ContactState.STOPPED, fault, fault
        elif self.state is ContactState.STOPPED:
            if self._trusted_from_s is None:
                self.reason = f"waiting for estimates: the force is {self._force.value}"
            elif now_s < self._trusted_from_s:
                back = f"estimates are back; trusted after {self._settings.resume_after_s:g} s"
                self.reason = f"{self._last_fault}; {back}"
            else:
                self.state, self.reason = ContactState.UNKNOWN, ""
        if self.state is not ContactState.STOPPED:
            self.state = _KNOWN.get(self._force, ContactState.UNKNOWN)
        return self.state

    def _silence(self, now_s: float) -> str:
        silent_s = now_s - self._fresh_s
        if silent_s > self._settings.stale_after_s:
            return (
                f"no state of the force with a fresh stamp for {silent_s:.1f} s"
                if np.isfinite(silent_s)
                else "no state of the force has come yet"
            )
        unsound_s = now_s - self._sound_s
        if unsound_s > self._settings.stale_after_s:
            return f"the force has been unknown for {unsound_s:.1f} s: {self._force.value}"
        return ""


class ForcePairs:
    """Brings each force together with its state, whichever of the two messages comes first."""

    def __init__(self) -> None:
        self._forces: OrderedDict[int, tuple[int, Array]] = OrderedDict()
        self._awaited: OrderedDict[int, None] = OrderedDict()

    def force(self, stamp_ns: int, segment: int, force_n: Array) -> bool:
        """A wrench came; gives whether a contact was stated for it before."""
        self._forces[stamp_ns] = segment, force_n
        if len(self._forces) > _PAIRS_KEPT:
            self._forces.popitem(last=False)
        return stamp_ns in self._awaited

    def take(self, stamp_ns: int) -> tuple[int, Array] | None:
        """Segment and force (3,) of a contact; none while its wrench has not come."""
        self._awaited.pop(stamp_ns, None)
        found = self._forces.pop(stamp_ns, None)
        if found is None:
            self._awaited[stamp_ns] = None
            if len(self._awaited) > _PAIRS_KEPT:
                self._awaited.popitem(last=False)
        return found


def read_wrench(message: Any, frames: Frames) -> tuple[int, Array, int]:
    """Segment, force (3,) in its axes, N, and stamp, ns, of the estimate in a `WrenchStamped`.

    The segment is 0, and the force zero, where nothing touches; where nothing is known either,
    which may be published as not a number.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, or a force in
            the base frame, where there is none.
    """
    force, frame = message.wrench.force, message.header.frame_id
    components = (force.x, force.y, force.z)
    if frame == frames.base and all(map(math.isnan, components)):
        components = (0.0, 0.0, 0.0)
    if not math.hypot(*components) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {components} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    segment = 0 if frame == frames.base else frames.segment_number(frame)
    if segment == 0 and any(components):
        raise ContractError(
            f"wrench.force is {components} N in {frame}; a contact comes in its segment's frame"
        )
    stamp = message.header.stamp
    return segment, np.array(components), stamp.sec * 1_000_000_000 + stamp.nanosec
