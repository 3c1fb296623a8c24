"""Whether readings can come from contacts anywhere that were estimated from them.

The model states the misfit of every sample: of M readings, K contacts leave M - 4 K residuals. A
fit proves nothing, as a fault may have the pattern of a contact. When it changes, and every two
seconds, a contact is therefore judged against the static equilibrium: could one of the readings be
wrong unnoticed, and does the average of its readings fit too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
from typing import Any, ClassVar

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_online.plausibility import FORCE_OFF_N, PlausibilityCheck, on_segments
from cablesense_sim.contact_location import AXIAL_STD_N, contact_response, touched_at
from cablesense_sim.equilibrium import EquilibriumError

NEAR_N, LEVERS_M = 2.0, (1.0, 1.0, 0.1, 0.1, 0.1)
"""The response of the tensions counts as the same over this change of a normal force, or of a
moment at a lever of 0.1 m."""


class AnywhereCheck(PlausibilityCheck):
    """See the base class; contacts may be anywhere, and the model states their misfit."""

    numbers: ClassVar[int] = 4
    judged_every_ns: ClassVar[int] = 2_000_000_000  # unchanged; it takes a millisecond
    _judged: StatedContacts | None = None

    @cached_property
    def prior(self) -> Array:
        """(N, 4) information of a contact's numbers before the tensions, on each segment."""
        low, high = touched_at(self.fits.statics.arm)[0].T
        information = np.zeros((len(low), self.numbers))
        information[:, 0], information[:, 3] = AXIAL_STD_N**-2, 12.0 / (high - low) ** 2
        return information

    def _hidden(self, fit: Any, difference_n: Array, largest: float) -> str:
        self._judged = fit
        return super()._hidden(fit, difference_n, largest)

    def _explained(
        self, difference_n: Array, contacts: Sequence[Contact], stated_misfit: float | None
    ) -> str:
        assert stated_misfit is not None
        self._fit = fit = StatedContacts(self, difference_n, contacts, stated_misfit)
        if self._judged is not None and self._judged.is_near(fit):
            fit.response = self._judged.response
        largest = self._limits[len(contacts)]
        self.misfit = stated_misfit * self._largest / largest
        return "" if stated_misfit <= largest else self._described(on_segments(self._fit.segments))

    def _paired(self, fit: StatedContacts, difference_n: Array) -> str:
        """See the base class."""
        if len(fit.segments) == 1:
            return super()._paired(fit, difference_n)
        found = fit.exchanged(difference_n, self._limits[len(fit.segments)])
        if found is None:
            return ""
        names = " and ".join(self._cable_names[cable] for cable in found)
        return f"several contacts can hide exchanged plugs of {names}"

    def _misfit_of_average(self, mean_n: Array, steady: object, largest: float) -> float:
        # contacts whose forces are steady within a newton are near those that were judged
        return 0.0 if self._judged is None else self._judged.misfit_of(mean_n)


class StatedContacts:
    """Contacts that a model states, and the linear response of the readings to other ones.

    Attributes:
        segments: the touched ones, from 1 on, ascending.
        force_n: y and z of each normal force.
        misfit: that the model states.
        response: an object that contacts near one another share.
    """

    def __init__(
        self,
        check: AnywhereCheck,
        difference_n: Array,
        contacts: Sequence[Contact],
        misfit: float,
    ) -> None:
        self.segments = tuple([contact.segment for contact in contacts])
        self.force_n = [c.magnitude_n * part for c in contacts for part in c.direction]
        self.misfit, self.response = misfit, object()
        self._difference_n, self._contacts, self._fits = difference_n, contacts, check.fits
        self._unloaded_n, self._prior = check.fits.unloaded_n, check.prior
        self._free = max(len(difference_n) - check.numbers * len(contacts), 1)

    @property
    def size_n(self) -> float:
        """The size of the normal forces together; of a known moment that at its place."""
        return float(np.linalg.norm(self._forces[:, 1:]))

    def is_near(self, other: StatedContacts) -> bool:
        """Whether other contacts are on the same segments, with normal forces and moments near."""
        if self.segments != other.segments:
            return False
        for ours, theirs in zip(self._contacts, other._contacts, strict=True):
            _, *our_parts = ours.wrench
            _, *their_parts = theirs.wrench
            for ours_n, theirs_n, lever in zip(our_parts, their_parts, LEVERS_M, strict=True):
                if abs(ours_n - theirs_n) > NEAR_N * lever:
                    return False
        return True

    def without(self, cables: Sequence[int]) -> float:
        """See `Explanation`."""
        if self._linear is None:
            return math.inf
        _, left, _, _ = self._linear
        residual, of = left @ self._residual(self._difference_n), left[:, cables]
        residual = residual - of @ np.linalg.lstsq(of, residual, rcond=1e-9)[0]
        return self._rms(residual, len(cables))

    def misfit_of(self, difference_n: Array) -> float:
        """The misfit of other readings less unloaded tensions (M,), near these contacts."""
        if self._linear is None:
            return math.inf
        return self._rms(self._linear[1] @ self._residual(difference_n))

    def hidden_n(self, difference_n: Array, largest: float) -> Array:
        """See `Explanation`; the error of a moment counts at the lever of its contact.

        A cable that reads slack may be taut, and its reading of zero wrong: that is the contact
        nearest by, in which it would be taut.
        """
        if self._linear is None:
            return np.full(len(difference_n), np.inf)
        elastic_n, left, to_numbers, covariance = self._linear
        passes = largest * math.sqrt(self._free)
        seen = np.sqrt(np.maximum(np.diagonal(left), 1e-12))
        hidden_n = passes * self._off_n(to_numbers) / seen
        residual = left @ self._residual(difference_n)
        for cable in np.flatnonzero(elastic_n <= 0.0):
            gain = self._gain[cable] / self._fits.spread_n
            lacks = -elastic_n[cable] / self._fits.spread_n
            variance = float(gain @ covariance @ gain)
            raised = residual @ residual + lacks**2 / max(variance, 1e-18)
            moved = covariance @ gain * (lacks / max(variance, 1e-18))
            hidden_n[cable] = self._off_n(moved[:, None])[0] if raised <= passes**2 else 0.0
        return hidden_n

    def exchanged(self, difference_n: Array, largest: float) -> tuple[int, int] | None:
        """Two cables whose exchanged readings would fit other contacts on these segments."""
        if self._linear is None:
            return None
        _, left, to_numbers, _ = self._linear
        residual = left @ self._residual(difference_n)
        reading_n = difference_n + self._unloaded_n
        for i, j in combinations(range(len(reading_n)), 2):
            swap = (reading_n[j] - reading_n[i]) / self._fits.spread_n
            off_n = self._off_n((to_numbers[:, i] - to_numbers[:, j])[:, None] * swap)[0]
            if off_n > FORCE_OFF_N and self._rms(residual + swap * (left[:, i] - left[:, j])) <= (
                2.0 * largest
            ):
                return i, j
        return None

    def _off_n(self, numbers: Array) -> Array:
        """The largest change of a normal force by changes (4 K, R) of the contacts' numbers."""
        off_n = np.zeros(numbers.shape[1])
        for k, contact in enumerate(self._contacts):
            _, y, z, place = numbers[4 * k : 4 * k + 4]
            if not contact.magnitude_n:  # its moment is known
                (of_y, of_z), at_m = self._forces[k, 1:], contact.contact_m
                y, z = y + of_y / at_m * place, z + of_z / at_m * place
            off_n = np.maximum(off_n, np.hypot(y, z))
        return off_n

    def _rms(self, residual: Array, left_out: int = 0) -> float:
        return math.sqrt(float(residual @ residual) / max(self._free - left_out, 1))

    def _residual(self, difference_n: Array) -> Array:
        """(M,) readings less those under these contacts, in standard deviations."""
        assert self._linear is not None
        expected_n = np.maximum(self._linear[0], 0.0) - self._unloaded_n
        return (difference_n - expected_n) / self._fits.spread_n

    @cached_property
    def _forces(self) -> Array:
        """(K, 3) along the axes of the segments; of a known moment the one at its place."""
        rows = []
        for contact in self._contacts:
            size_n = contact.magnitude_n or (contact.moment_n_m or 0.0) / contact.contact_m
            y, z = contact.direction
            rows.append([contact.along_n, size_n * y, size_n * z])
        return np.array(rows)

    @cached_property
    def _linear(self) -> tuple[Array, Array, Array, Array] | None:
        """The static equilibrium near these contacts; None where the arm cannot rest under them.

        Elastic tensions (M,), negative of slack cables; maps of readings to residuals (M, M) and
        to the contacts' numbers (4 K, M); covariance of the numbers (4 K, 4 K).
        """
        statics, command = self._fits.statics, self._fits.command_rad
        try:
            elastic_n, gain = contact_response(
                statics.mechanism,
                command[None],
                np.array([self.segments]),
                np.array([[contact.contact_m for contact in self._contacts]]),
                self._forces[None],
                statics.held_m(command)[None],
            )
        except EquilibriumError:
            return None
        self._gain = gain[0]
        seen = self._gain * (elastic_n[0] > 0.0)[:, None] / self._fits.spread_n
        prior = np.ravel(self._prior[np.array(self.segments) - 1])
        covariance = np.linalg.inv(seen.T @ seen + np.diag(prior))
        to_numbers = covariance @ seen.T
        return elastic_n[0], np.eye(len(seen)) - seen @ to_numbers, to_numbers, covariance
