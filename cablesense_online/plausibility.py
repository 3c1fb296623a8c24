"""Whether readings can come from the contact that was estimated from them.

M readings answer to the two components of one force, so M - 2 combinations of them are left over.
They must vanish within noise, slack cables included:

    r = (reading - unloaded) - (T(c, f) - T(c, 0))

with T the static equilibrium at the command c under a force f on the touched segment, and f fitted
too. The misfit is the root mean square of r over its expected spread, so 1 for a healthy arm. Its
spread has the sensors' noise and step, those of the tare, and a force along the segment, which
friction at the contact may add and no estimate has.

The equilibrium is solved on a grid of forces, once for a command, and taken as linear around a
point of the grid, with each set of taut cables. So a sample costs one small product, and its
verdict depends on nothing before it, apart from the time that forces are withheld after a misfit.

What fits is not proven right: a fault whose pattern is that of a force looks like that force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.tare import UnloadedTensions
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, stiffness_matrix_n_m

ALONG_SHARE: Final = 0.5
"""Standard deviation of the force along a segment over the estimated force: friction at a contact,
or a hung weight on a bent arm."""

FORCE_OFF_N: Final = 5.0
"""An estimate so far from the force that fits best is not vouched for."""

BEYOND_TRAINING: Final = 1.25
"""Forces up to this multiple of the model's training range are vouched for."""

WITHHELD_S, _RENEWED_S = 0.2, 0.1
"""How long no force is given after a misfit; the time is renewed when so much of it is left."""

_GRIDS_N = (20.0, 1.0)
"""Apart are the forces for which the equilibrium is solved: the tensions of the arm `cdsm_lab` are
linear within 0.02 N over the first; where many cables are slack and it bends, over the second."""

_MOST_SOLVED = 1024
_MOST_SETS = 8
_LEAST_SPREAD_N = 0.01
"""Of a sensor without noise and step."""


class _Response(NamedTuple):
    """Tensions near one force, with one set of taut cables.

    Attributes:
        change_n: (M,) tensions at that force less the unloaded ones.
        elastic_n: (M,) tensions, negative where a slack cable lacks length.
        gain: (M, 2) their derivative by the force.
        left_over: (M + 2, M) takes readings less `change_n` to what is left over of them, in its
            expected spread, and to the force that fits better by so much, N.
    """

    change_n: Array
    elastic_n: Array
    gain: Array
    left_over: Array


class _Fit(NamedTuple):
    """Readings beside a response.

    Attributes:
        misfit: root mean square of what is left over, in its expected spread.
        left: (M + 2,) what `left_over` of the response makes of the readings.
        response: that response.
        about_n: (2,) the force that it is about, y and z in the segment's frame.
    """

    misfit: float
    left: Array
    response: _Response
    about_n: Array

    def off_n(self, y_n: float, z_n: float) -> float:
        """How far the force that fits best is from another."""
        y, z = (self.about_n + self.left[-2:]).tolist()
        return math.hypot(y - y_n, z - z_n)

    def without_each(self) -> Array:
        """(M,) sums of squares that would be left over without each one of the readings."""
        over, by_cable = self.left[:-2], self.response.left_over[:-2]
        sizes = np.maximum((by_cable**2).sum(axis=0), 1e-12)
        return np.asarray(over @ over - (over @ by_cable) ** 2 / sizes)


class _SolvedForce:
    """The arm at one command under one force, and its response to forces near it."""

    def __init__(
        self, check: PlausibilityCheck, segment: int, force_n: Array, unloaded_n: Array
    ) -> None:
        """A force (2,), y and z, on a segment from 1 on; `unloaded_n` (M,) at this command.

        Raises:
            EquilibriumError: the arm has no rest under it.
        """
        statics, command = check.statics, check.command_rad
        mechanism = statics.mechanism
        axes = kinematics.segment_rotations(mechanism, command)[segment - 1]
        forces = np.zeros((mechanism.segment_count, 3))
        forces[segment - 1] = axes[:, 1:] @ force_n
        rest = statics.at_rest(command, forces)
        angles = rest.joint_angles_rad
        pushes = kinematics.contact_jacobians_m(mechanism, angles)[segment - 1]
        self._spread_n, self._unloaded_n, self.force_n = check.spread_n, unloaded_n, force_n
        self._stiffness_n_m = mechanism.stiffness_n_m
        self._jacobian_m = kinematics.cable_jacobian_m(mechanism, angles)
        stretch_m = held_lengths_m(mechanism, angles) - statics.held_m(command)
        self._elastic_n = mechanism.stiffness_n_m * stretch_m + mechanism.pretension_n
        self.taut = self._elastic_n > 0.0
        self._hessian = stiffness_matrix_n_m(mechanism, angles, rest.tensions_n, forces)
        self._torques_m = pushes.T @ np.roll(axes, -1, axis=1)  # by y, z and x
        self._along_n = ALONG_SHARE * max(float(np.linalg.norm(force_n)), 0.5 * _GRIDS_N[0])
        self._responses: dict[bytes, _Response | None] = {}

    def fit(self, difference_n: Array, y_n: float, z_n: float, largest: float) -> _Fit | None:
        """What is left over of readings less unloaded tensions (M,); none where nothing holds.

        Which cables are taut follows from the estimated force by Newton's method; it ends where
        the misfit is `largest` at most, or the set stays.
        """
        taut, count, fit = self.taut, len(difference_n), None
        for _ in range(_MOST_SETS):
            response = self._response(taut)
            if response is None:
                return None
            left = response.left_over @ (difference_n - response.change_n)
            over = left[:count]
            misfit = math.sqrt(float(over @ over) / max(count - 2, 1))
            fit = _Fit(misfit, left, response, self.force_n)
            if misfit <= largest:
                break
            away_n = (y_n - self.force_n[0], z_n - self.force_n[1])
            before, taut = taut, response.elastic_n + response.gain @ away_n > 0.0
            if np.array_equal(taut, before):
                break
        return fit

    def _response(self, taut: NDArray[np.bool_]) -> _Response | None:
        key = taut.tobytes()
        if key not in self._responses:
            try:
                self._responses[key] = self._linearised(taut)
            except np.linalg.LinAlgError:
                self._responses[key] = None
        return self._responses[key]

    def _linearised(self, taut: NDArray[np.bool_]) -> _Response:
        """One Newton step from the solved pose to that of other taut cables, and its derivative.

        Raises:
            LinAlgError: so few cables are taut that nothing holds the arm.
        """
        jacobian, stiffness = self._jacobian_m, self._stiffness_n_m
        other = taut.astype(float) - self.taut
        hessian = self._hessian + jacobian.T @ ((stiffness * other)[:, None] * jacobian)
        unbalanced = jacobian.T @ (self._elastic_n * other)
        turned = np.linalg.solve(hessian, np.column_stack([self._torques_m, -unbalanced]))
        by_y, by_z, by_x, moved = (stiffness[:, None] * (jacobian @ turned)).T
        elastic, gain = self._elastic_n + moved, np.column_stack([by_y, by_z])
        along = taut * by_x * (self._along_n / self._spread_n)
        size = float(along @ along)
        shrunk = (1.0 - 1.0 / math.sqrt(1.0 + size)) / size if size > 0.0 else 0.0
        whiten = (np.eye(len(taut)) - shrunk * np.outer(along, along)) / self._spread_n
        by_force = whiten @ (taut[:, None] * gain)
        to_force = np.linalg.pinv(by_force)
        left_over = np.vstack([whiten - by_force @ (to_force @ whiten), to_force @ whiten])
        return _Response(taut * elastic - self._unloaded_n, elastic, gain, left_over)


class PlausibilityCheck:
    """Gives no force whose readings do not fit it, nor one soon after such a sample.

    Attributes:
        unchecked: why nothing is checked; empty where all is.
        withheld_until_ns: samples with earlier stamps give no force.
        misfit: of the last sample; infinite where no equilibrium was compared with.
        statics, command_rad, spread_n: the arm, its command (2N,) in force, and the standard
            deviation of a reading less the unloaded one, N.
    """

    def __init__(
        self,
        statics: UnloadedTensions,
        spread_n: float,
        largest_misfit: float,
        force_range_n: float,
        cable_names: Sequence[str],
        unchecked: str = "",
        limit_from: str = "",
    ) -> None:
        """`force_range_n` is that of the model's training; `largest_misfit` 0 checks nothing.

        `limit_from` states where that limit comes from.
        """
        self._limit_from = limit_from
        self.statics, self.spread_n = statics, max(spread_n, _LEAST_SPREAD_N)
        self.unchecked = unchecked if largest_misfit else "switched off (largest_misfit is 0)"
        self._largest, self._largest_force_n = largest_misfit, BEYOND_TRAINING * force_range_n
        self._cable_names = cable_names
        self.command_rad = self._unloaded_n = np.zeros(0)
        self._solved: dict[tuple[int, float, float], _SolvedForce | None] = {}
        self.withheld_until_ns = 0
        self._since_ns: int | None = None
        self.misfit = self._worst = 0.0
        self._withheld, self._last_problem = 0, ""

    def check(
        self, difference_n: Array, command_rad: Array, contact: Contact, stamp_ns: int
    ) -> None:
        """Check readings less unloaded tensions (M,) at a command (2N,) with the arm at rest.

        Raises:
            SampleError: they do not fit the contact that was estimated, or did not a moment ago.
        """
        if command_rad is not self.command_rad:
            self.command_rad = command_rad
            self._unloaded_n = self.statics.predict_n(command_rad)
            self._solved.clear()
        misfit = self._misfit_text(difference_n, contact)
        self._worst = max(self._worst, self.misfit)
        renewed_ns = stamp_ns + round(WITHHELD_S * 1e9)
        until_ns = min(self.withheld_until_ns, renewed_ns)  # of stamps that stepped back
        if misfit:
            if until_ns - stamp_ns < _RENEWED_S * 1e9:
                until_ns = renewed_ns
        elif stamp_ns < until_ns:
            misfit = "the readings fit again, and not yet for long enough"
        self.withheld_until_ns = until_ns
        if not misfit:
            self._since_ns = None
            return
        self._withheld += 1
        if self._since_ns is None:
            self._since_ns = stamp_ns
        lasted_s = (stamp_ns - self._since_ns) * 1e-9
        self._last_problem = f"{misfit} (no force for {lasted_s:.1f} s)"
        raise SampleError(ProblemKind.MISFIT, self._last_problem)

    def status(self) -> Status:
        """Whether readings have fitted since the last report."""
        if self.unchecked:
            return Status("plausibility", Level.OK, f"not checked: {self.unchecked}")
        values = {
            "largest misfit": f"{self._worst:.2f}",
            "largest misfit that passes": f"{self._largest:g}",
            "this limit is": self._limit_from,
            "withheld": str(self._withheld),
        }
        level, message = Level.OK, "readings fit the estimates"
        if self._withheld:
            level, message = Level.ERROR, self._last_problem
        self._worst, self._withheld = 0.0, 0
        return Status("plausibility", level, message, values)

    def _misfit_text(self, difference_n: Array, contact: Contact) -> str:
        """What does not fit, as text; empty where all does."""
        if not contact.segment:
            free = difference_n / self.spread_n
            self.misfit = math.sqrt(float(free @ free) / len(free))
            if self.misfit <= self._largest:
                return ""
            return self._described("no contact", difference_n)
        self.misfit = math.inf
        segment, force = contact.segment, contact.magnitude_n
        where = f"a force on segment {segment}"
        if force > self._largest_force_n:
            return (
                f"an estimate of {force:.0f} N is beyond the {self._largest_force_n:.0f} N that "
                f"are vouched for{self._suspects(difference_n)}"
            )
        y, z = (force * part for part in contact.direction)
        for grid_n in _GRIDS_N:
            solved = self._solved_near(segment, y, z, grid_n)
            fit = None if solved is None else solved.fit(difference_n, y, z, self._largest)
            if fit is not None and fit.misfit <= self._largest:
                break
        if fit is None:
            return f"the arm cannot rest under the {force:.0f} N estimated on segment {segment}"
        self.misfit = fit.misfit
        if fit.misfit > self._largest:
            return self._described(where, difference_n, fit)
        off_n = fit.off_n(y, z)
        if off_n > FORCE_OFF_N:
            return f"{where} that fits lies {off_n:.1f} N from the estimate"
        return ""

    def _solved_near(
        self, segment: int, y_n: float, z_n: float, grid_n: float
    ) -> _SolvedForce | None:
        """The point of a grid next to a force; none where the arm has no rest there."""
        key = (segment, grid_n * round(y_n / grid_n), grid_n * round(z_n / grid_n))
        if key not in self._solved:
            if len(self._solved) >= _MOST_SOLVED:
                self._solved.clear()
            try:
                self._solved[key] = _SolvedForce(
                    self, segment, np.array(key[1:]), self._unloaded_n
                )
            except EquilibriumError:
                self._solved[key] = None
        return self._solved[key]

    def _described(self, contact: str, difference_n: Array, fit: _Fit | None = None) -> str:
        return (
            f"readings lie {self.misfit:.1f} times as far from {contact} as by their noise (at "
            f"most {self._largest:g}){self._suspects(difference_n, fit)}"
        )

    def _suspects(self, difference_n: Array, fit: _Fit | None = None) -> str:
        """Cables without whose reading all others fit: no contact, or the one estimated."""
        free = difference_n / self.spread_n
        left = [(free @ free - free**2, len(free) - 1)]
        if fit is not None:
            left.append((fit.without_each(), len(free) - 3))
        fits = np.any([chi <= max(n, 1) * self._largest**2 for chi, n in left], axis=0)
        names = [name for name, fit_it in zip(self._cable_names, fits, strict=True) if fit_it]
        if not names:
            return "; no one cable explains it"
        return f"; all but the reading of {' or '.join(names)} would fit"
