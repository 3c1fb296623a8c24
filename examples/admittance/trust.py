"""Whether the estimates, and a contact that they state, can be relied on."""

from __future__ import annotations

from enum import Enum

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from examples.admittance.law import AdmittanceSettings, ContactForce

FORCE_KNOWN = (ForceState.FREE, ForceState.CONTACT)
NO_FAULT = (ForceState.MOVING, ForceState.HIDDEN, ForceState.MOMENT)  # no force, but as expected
SAME_CONTACT_N = 5.0  # a force that changes by more, and by more than itself, is a new contact


class ContactState(Enum):
    """The knowledge of contacts at this moment."""

    STOPPED = "stopped"
    UNKNOWN = "unknown"
    FREE = "free"
    CONTACT = "contact"


class EstimateWatch:
    """Follows the states that the estimator publishes; times are monotonic, s.

    Attributes:
        state: the knowledge of contacts.
        reason: why `state` is `STOPPED`.
    """

    def __init__(self, settings: AdmittanceSettings, now_s: float) -> None:
        self._stale_after_s = settings.stale_after_s
        self._resume_after_s = settings.resume_after_s
        self._force = ForceState.SILENT
        self._fresh_s = float("-inf")
        self._sound_s = now_s
        self._back_since_s: float | None = None
        self._refusal = ""
        self.state = ContactState.STOPPED
        self.reason = "no estimate yet"

    def received(self, force: ForceState, age_s: float, now_s: float) -> bool:
        """A state came, of a sample that is `age_s` old; returns whether it is fresh."""
        if abs(age_s) > self._stale_after_s:
            return False
        self._force = force
        self._fresh_s = now_s
        if force in FORCE_KNOWN or force in NO_FAULT:
            self._sound_s = now_s
        return True

    def refused(self, why: str) -> None:
        """Stop at the next update: a message broke the contract."""
        self._refusal = why

    def publishing(self, now_s: float) -> bool:
        """Whether states with fresh stamps come, whatever they are."""
        return now_s - self._fresh_s <= self._stale_after_s

    def update(self, now_s: float) -> ContactState:
        """Decide the state now; call it at least every 20 ms."""
        fault = self._refusal or self._fault(now_s)
        self._refusal = ""
        if fault:
            self.state = ContactState.STOPPED
            self.reason = fault
            self._back_since_s = None
        elif self.state is ContactState.STOPPED:
            if self._force not in (*FORCE_KNOWN, ForceState.HIDDEN, ForceState.MOMENT):
                self._back_since_s = None
            elif self._back_since_s is None:
                self._back_since_s = now_s
            elif now_s - self._back_since_s >= self._resume_after_s:
                self.state = ContactState.UNKNOWN
                self.reason = ""
        if self.state is not ContactState.STOPPED:
            known = self._force in FORCE_KNOWN
            self.state = ContactState(self._force.value) if known else ContactState.UNKNOWN
        return self.state

    def _fault(self, now_s: float) -> str:
        if not self.publishing(now_s):
            return f"no state of the force with a fresh stamp for {now_s - self._fresh_s:.1f} s"
        unsound_s = now_s - self._sound_s
        if unsound_s > self._stale_after_s:
            return f"the force has been unknown for {unsound_s:.1f} s: {self._force.value}"
        return ""


class Confirmation:
    """Whether the present contact was seen in two poses, and how far it is yielded to until then.

    Readings of a faulty channel may fit a contact in one pose; in a second pose most do not.

    Attributes:
        confirmed: whether the present contact is confirmed; true without a contact.
    """

    def __init__(self, settings: AdmittanceSettings) -> None:
        self._turn_rad = float(np.deg2rad(settings.confirm_deg))
        self._measure_s = settings.measure_s
        self._confirm_s = max(settings.confirm_s, settings.measure_s)
        self._contact: ContactForce | None = None
        self._from_rad: Array = np.zeros(0)
        self.confirmed = True

    def seen(self, contact: ContactForce | None, command_rad: Array) -> None:
        """A contact, or none, was measured at a command (2N,)."""
        if contact is None:
            self._contact = None
            self.confirmed = True
        elif not self._is_same(contact):
            if self.confirmed:
                self._from_rad = command_rad
            self._contact = contact
            self.confirmed = False
        elif not self.confirmed:
            self.confirmed = self._has_turned(command_rad)

    def span_s(self, command_rad: Array) -> float:
        """For how long to measure at a command (2N,)."""
        decides = not self.confirmed and self._has_turned(command_rad)
        return self._confirm_s if decides else self._measure_s

    def shortened(self, command_rad: Array, target_rad: Array) -> Array:
        """The part of the way to a target (2N,) that is allowed before the confirmation."""
        step = target_rad - command_rad
        if self.confirmed or not step.any():
            return target_rad
        allowed = self._turn_rad - np.sign(step) * (command_rad - self._from_rad)
        share = np.min(allowed[step != 0.0] / np.abs(step[step != 0.0]))
        return np.asarray(command_rad + step * float(np.clip(share, 0.0, 1.0)))

    def _is_same(self, contact: ContactForce) -> bool:
        before = self._contact
        if before is None or before.segment != contact.segment:
            return False
        changed_n = float(np.linalg.norm(contact.force_base_n - before.force_base_n))
        return changed_n <= max(SAME_CONTACT_N, float(np.linalg.norm(before.force_base_n)))

    def _has_turned(self, command_rad: Array) -> bool:
        return bool(np.abs(command_rad - self._from_rad).max() >= (1.0 - 1e-6) * self._turn_rad)
