"""Contacts that are stated of an arm at rest, and what its readings say of them.

The lengths of the taut cables determine the pose. The joint torques there determine which forces
at the contact points of the arm file explain the readings best. Near stated contacts the readings
respond linearly: that tells which other contacts would have these readings if one or two of them
were wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.contact_location import AXIAL_STD_N, contact_response
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.point_force_fit import Resting, fit_point_forces, point_arm
from cablesense_sim.replay import difference_variance_n2

FORCE_OFF_N: Final = 5.0
"""Largest distance of an estimate from the force that fits best, and largest effect of one wrong
reading on it."""

_ALONG_SHARE, _ALONG_LEAST_N = 0.5, 5.0
"""Standard deviation of the force along a segment over that across it, and at least: friction at a
contact, or a hung weight on a bent arm."""

POINT_NUMBERS: Final = 2
"""Readings determine the two components across a segment of a force at its contact point."""
ANYWHERE_NUMBERS: Final = 4
"""They determine three components of a force anywhere, and its place."""

_PLACE_STD_M = 1e-6
"""The place of a contact at the contact point of the arm file is known."""

_ACROSS_N = 1.0
"""Added across a contact, it turns a joint whose cables hardly pull over to the other side."""

_NEAR = (2.0, 2.0, 0.2, 0.2, 0.2)
"""The response of the tensions counts as the same over these changes of a normal force, N, and of
its moment, N·m."""

LEAST_SPREAD_N: Final = 0.01
"""Assumed of a sensor without noise and step."""
TAUT_SPREADS = 4.0
"""Standard deviations of a reading above which a cable is read as taut."""

AVERAGED_EVERY_NS = 100_000_000
"""How often the average of a contact's readings is judged."""
_JUDGED_EVERY_NS, _SOONEST_NS = 2_000_000_000, 20_000_000
"""How often a contact is judged, which takes a millisecond, and how soon again if its tensions
respond differently."""
_SHARPER = 0.8
"""An unconfirmed contact is judged again when the limit has fallen below this share."""
_STEADY_N = 1.0
"""The average restarts when a force has changed by more."""
_LONGEST_GAP_NS = 500_000_000


class RestingArm:
    """An arm at rest, commanded as if its effects were unknown; its readings are compared.

    Attributes:
        arm, mechanism: as described, and as amended by its effects.
        incomplete: why unloaded tensions may not be those of the arm at rest; empty where they
            are.
        spread_n: expected standard deviation of a reading minus the unloaded one.
        command_rad: (2N,) the last `command`.
        unloaded_n: (M,) its unloaded tensions.
        held_m: (M,) the cable lengths that are held there.
    """

    def __init__(self, arm: Arm, tare_samples: int) -> None:
        self.arm, self.tare_samples = arm, tare_samples
        self._nominal, entries = mechanism_of(arm), entries_of(arm)
        self.mechanism = mechanism = amended(self._nominal, entries)
        causes = [[entry for entry in entries if not entry.effect.tolerance]]
        past = actuations(causes) or transmissions(causes) or sensings(causes)
        listed = "the arm file lists effects of actuators, friction or sensors"
        self.incomplete = listed if past else ""
        spread_n = difference_variance_n2(arm.sensors, tare_samples) ** 0.5
        self.spread_n = max(spread_n, LEAST_SPREAD_N)
        self.command_rad = self.unloaded_n = self.held_m = np.zeros(0)
        straight = kinematics.spans(mechanism, np.zeros(mechanism.joint_count))
        loose_m = mechanism.pretension_n / mechanism.stiffness_n_m
        self._loose_m = straight.length_m.sum(axis=-1) - loose_m
        self._points = point_arm(mechanism)

    def predict_n(self, command_rad: Array) -> Array:
        """Unloaded tensions (..., M) at rest at commands (..., 2N).

        Raises:
            EquilibriumError: the arm has no rest at a command.
        """
        held_m = held_lengths_m(self._nominal, command_rad)
        return solve_equilibrium(self.mechanism, command_rad, held_m=held_m).tensions_n

    def command(self, command_rad: Array) -> None:
        """The arm rests at a command (2N,); another array is another command."""
        if command_rad is not self.command_rad:
            self.command_rad = command_rad
            self.unloaded_n = self.predict_n(command_rad)
            self.held_m = held_lengths_m(self._nominal, command_rad)
            axes = kinematics.segment_rotations(self.mechanism, command_rad)
            self._resting = Resting(np.array(command_rad), axes, self._loose_m + self.held_m)

    def prepare(self, command_rad: Array, *, anywhere: bool) -> None:
        """Compile or load, at a command, what the first contact would wait for.

        Contacts `anywhere` are explained by their model.
        """
        self.command(command_rad)
        nothing_n = np.zeros(len(self.unloaded_n))
        contacts = [Contact(1, contact_m=float(self.mechanism.contact_m[0]))]
        if not anywhere:
            self.explained(nothing_n, contacts)
        StatedContacts(self, nothing_n, contacts, 0.0).misfit_of(nothing_n)

    def misfit(self, difference_n: Array) -> float:
        """The misfit to no contact of readings less unloaded tensions, of all cables or some.

        It is the root mean square of the residuals in their expected standard deviations, 1 for a
        healthy arm.
        """
        free = difference_n / self.spread_n
        return math.sqrt(float(free.dot(free)) / max(len(free), 1))

    def explained(
        self, difference_n: Array, contacts: Sequence[Contact]
    ) -> tuple[list[Contact], float]:
        """The contacts on the same segments that fit readings less unloaded tensions (M,) best.

        They act at the contact points of the arm file. The sizes of the given `contacts` state how
        large axial forces by friction may be. Gives their misfit too.
        """
        segments = np.array([contact.segment - 1 for contact in contacts])
        along = np.array([(self.spread_n / along_std_n(contact)) ** 2 for contact in contacts])
        reading_n, taut_above_n = self.unloaded_n + difference_n, TAUT_SPREADS * self.spread_n
        force_n, squared_n2 = fit_point_forces(
            self._points, self._resting, reading_n, taut_above_n, segments, along
        )
        free = max(len(reading_n) - POINT_NUMBERS * len(contacts), 1)
        best = [
            Contact.of_force(contact.segment, each_n, contact.contact_m)
            for contact, each_n in zip(contacts, force_n.tolist(), strict=True)
        ]
        return best, math.sqrt(squared_n2 / free) / self.spread_n


def along_std_n(contact: Contact) -> float:
    """Standard deviation of the axial force at a contact point before the tensions."""
    return max(_ALONG_SHARE * contact.magnitude_n, _ALONG_LEAST_N)


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
        arm: RestingArm,
        difference_n: Array,
        contacts: Sequence[Contact],
        misfit: float,
        reach_m: Array | None = None,
    ) -> None:
        """Readings less unloaded tensions (M,); contacts in the order of their segments.

        Contacts act within the reach (N, 2) of the segments; without it at the points of the arm
        file.
        """
        self.segments = tuple([contact.segment for contact in contacts])
        self._wrenches = [contact.wrench for contact in contacts]
        self.force_n = [part for wrench in self._wrenches for part in wrench[1:3]]
        self.misfit, self.response = misfit, object()
        self._arm, self._difference_n, self._contacts = arm, difference_n, contacts
        self._reach_m = reach_m
        numbers = POINT_NUMBERS if reach_m is None else ANYWHERE_NUMBERS
        self._free = max(len(difference_n) - numbers * len(contacts), 1)

    @property
    def size_n(self) -> float:
        """Of the normal forces together; of a known moment that at its place."""
        return float(np.linalg.norm(self._forces[:, 1:]))

    def is_near(self, other: StatedContacts) -> bool:
        """Whether other contacts are on the same segments, with normal forces and moments near."""
        if self.segments != other.segments:
            return False
        return all(
            abs(one - another) <= most
            for ours, theirs in zip(self._wrenches, other._wrenches, strict=True)
            for one, another, most in zip(ours[1:], theirs[1:], _NEAR, strict=True)
        )

    def without(self, cables: Sequence[int]) -> float:
        """The misfit without the readings of some cables."""
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

    def refitted(self) -> StatedContacts | None:
        """The contacts nearby that explain the readings better, by one Gauss-Newton step.

        None where the arm cannot rest under these contacts.
        """
        if self._linear is None:
            return None
        return self._changed(self._linear[2] @ self._residual(self._difference_n))

    def beside(self) -> Iterator[StatedContacts]:
        """The contacts with a small force more across each, to either side.

        A joint may be free between two cables that hardly pull; either may be the taut one.
        """
        across = np.zeros((len(self._contacts), 4))
        for row, contact in zip(across, self._contacts, strict=True):
            y, z = contact.direction
            row[1:3] = -_ACROSS_N * z, _ACROSS_N * y
        yield self._changed(across)
        yield self._changed(-across)

    def _changed(self, change: Array) -> StatedContacts:
        """The contacts after changes (4 K,) of their numbers, within the reach."""
        contacts = []
        changes = change.reshape(-1, 4)
        for contact, force, part in zip(self._contacts, self._forces, changes, strict=True):
            at_m = contact.contact_m
            if self._reach_m is not None:
                at_m = float(np.clip(at_m + part[3], *self._reach_m[contact.segment - 1]))
            known = contact.magnitude_n > 0.0  # else its moment is
            force_n = (force + part[:3]).tolist()
            contacts.append(Contact.of_force(contact.segment, force_n, at_m, known=known))
        return StatedContacts(self._arm, self._difference_n, contacts, self.misfit, self._reach_m)

    def hidden_n(self, difference_n: Array, largest: float) -> Array:
        """(M,) largest error of a force due to one wrong reading, at a misfit of `largest`.

        The error of a moment counts at the lever of its contact.

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
            gain = self._gain[cable] / self._arm.spread_n
            lacks = -elastic_n[cable] / self._arm.spread_n
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
        reading_n = difference_n + self._arm.unloaded_n
        for i, j in combinations(range(len(reading_n)), 2):
            swap = (reading_n[j] - reading_n[i]) / self._arm.spread_n
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
        expected_n = np.maximum(self._linear[0], 0.0) - self._arm.unloaded_n
        return (difference_n - expected_n) / self._arm.spread_n

    @cached_property
    def _forces(self) -> Array:
        """(K, 3) along the axes of the segments; of a known moment the one at its place."""
        rows = []
        for contact in self._contacts:
            size_n = contact.magnitude_n or (contact.moment_n_m or 0.0) / contact.contact_m
            y, z = contact.direction
            rows.append([contact.along_n, size_n * y, size_n * z])
        return np.array(rows)

    @property
    def _prior(self) -> Array:
        """(4 K,) information of the contacts' numbers before the tensions."""
        information = np.zeros((len(self._contacts), 4))
        for row, contact in zip(information, self._contacts, strict=True):
            if self._reach_m is None:
                row[0], row[3] = along_std_n(contact) ** -2, _PLACE_STD_M**-2
            else:
                low_m, high_m = self._reach_m[contact.segment - 1]
                row[0], row[3] = AXIAL_STD_N**-2, 12.0 / (high_m - low_m) ** 2
        return information.ravel()

    @cached_property
    def _linear(self) -> tuple[Array, Array, Array, Array] | None:
        """The static equilibrium near these contacts; None where the arm cannot rest under them.

        Elastic tensions (M,), negative of slack cables; maps of readings to residuals (M, M) and
        to the contacts' numbers (4 K, M); covariance of the numbers (4 K, 4 K).
        """
        arm, command = self._arm, self._arm.command_rad
        try:
            elastic_n, gain = contact_response(
                arm.mechanism,
                command[None],
                np.array([self.segments]),
                np.array([[contact.contact_m for contact in self._contacts]]),
                self._forces[None],
                arm.held_m[None],
            )
        except EquilibriumError:
            return None
        self._gain = gain[0]
        seen = self._gain * (elastic_n[0] > 0.0)[:, None] / self._arm.spread_n
        covariance = np.linalg.inv(seen.T @ seen + np.diag(self._prior))
        to_numbers = covariance @ seen.T
        return elastic_n[0], np.eye(len(seen)) - seen @ to_numbers, to_numbers, covariance


@dataclass
class SteadyContact:
    """The readings of one or several contacts, averaged while their forces are steady.

    Attributes:
        sum_n, count: sum of the readings (M,) less unloaded tensions, and their number.
        began_ns, last_ns: stamps of the first and the last of them.
        force_n: y and z of each force at the first of them.
        averaged_ns: stamp at which the average was last judged.
        passed: the last average (M,) of these forces, if it fitted, and the limit that it met.
        hidden, off_average: findings, as text; empty where there are none.
    """

    segments: tuple[int, ...]
    sum_n: Array
    count: int = 0
    began_ns: int = 0
    last_ns: int = 0
    force_n: tuple[float, ...] = ()
    averaged_ns: int = -AVERAGED_EVERY_NS
    passed: tuple[Array, float] | None = None
    hidden: str = ""
    off_average: str = ""
    _judged: tuple[object, int] = (None, -_JUDGED_EVERY_NS)
    _judged_by: float = math.inf

    def continues(self, segments: tuple[int, ...], stamp_ns: int) -> bool:
        """Whether a sample is of the same contact."""
        return segments == self.segments and 0 < stamp_ns - self.last_ns <= _LONGEST_GAP_NS

    def add(self, difference_n: Array, force_n: tuple[float, ...], stamp_ns: int) -> None:
        """Add readings less unloaded tensions (M,), and the forces that fit them, y and z each."""
        if not self.force_n or math.dist(force_n, self.force_n) > _STEADY_N:
            self.off_average, self.force_n, self.passed = "", force_n, None
            self.begin(stamp_ns)
        self.last_ns = stamp_ns
        self.sum_n += difference_n
        self.count += 1

    def begin(self, stamp_ns: int) -> None:
        """Begin a new average."""
        self.sum_n[:] = 0.0
        self.count, self.began_ns = 0, stamp_ns

    def to_be_judged(self, response: object, stamp_ns: int, largest: float) -> bool:
        """Whether readings with this response of the tensions are due, by a limit of misfits."""
        last, at_ns = self._judged
        if self.hidden and largest < _SHARPER * self._judged_by:
            return True
        return stamp_ns - at_ns >= (_JUDGED_EVERY_NS if response is last else _SOONEST_NS)

    def judge(self, response: object, stamp_ns: int, hidden: str, largest: float) -> None:
        """Take a finding."""
        self._judged, self._judged_by, self.hidden = (response, stamp_ns), largest, hidden
