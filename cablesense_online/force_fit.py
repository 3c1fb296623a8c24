"""How well readings fit a force on a segment, and which force fits them best.

The tensions of an arm at rest follow from the force by the static equilibrium. It is solved on a
grid of forces, once for a command, and taken as linear around a point of the grid with each set of
taut cables. So a sample costs one small product.

A fit has the set of taut cables that its own force makes: where a cable reads slack that would be
taut under it, the readings do not fit. Where many cables are slack a compliant arm has two
positions of rest under one force; the one of the taut readings counts too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_online.tare import UnloadedTensions
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import (
    EquilibriumError,
    held_lengths_m,
    potential_gradient_n_m,
    stiffness_matrix_n_m,
)

ALONG_SHARE: Final = 0.5
"""Standard deviation of the force along a segment over the estimated force: friction at a contact,
or a hung weight on a bent arm."""

_GRIDS_N = (20.0, 1.0)
"""Apart are the forces for which the equilibrium is solved: the tensions of the arm `cdsm_lab` are
linear within 0.02 N over the first; where many cables are slack and it bends, over the second."""

_MOST_POSES = 1024
_MOST_SETS, _MOST_REFINED = 8, 8
_REFINED_FROM = 20.0
"""Misfits of up to so many times the largest that passes may come from taking as linear."""
_TAUT_SPREADS, _BARELY_SPREADS = 4.0, 3.5
"""A reading of so many times its spread is that of a taut cable; one of so many less may be."""


class _Response(NamedTuple):
    """Tensions near one force, with one set of taut cables.

    Attributes:
        change_n: (M,) tensions at that force less the unloaded ones.
        elastic_n: (M,) tensions, negative where a slack cable lacks length.
        gain: (M, 2) their derivative by the force.
        taut: (M,) which cables are.
        slack: positions of the others.
        unseen_n: (M,) how far the force is off by an error of one reading that leaves over 1.
        to_rest_rad: (2 N,) how the joints turn from the pose to rest at that force; none where
            they are at rest with this set.
        to_fit: (2 M + 2 N + 3, M) takes readings less `change_n` to what is left over of them, in
            its expected spread; to the force to be added, y, z and x, N; to what that adds to
            `elastic_n`; and to how far it turns the joints.
    """

    change_n: Array
    elastic_n: Array
    gain: Array
    taut: NDArray[np.bool_]
    slack: list[int]
    unseen_n: Array
    to_rest_rad: Array | None
    to_fit: Array


class Fit:
    """Readings beside the tensions under the force that fits them best.

    Attributes:
        misfit: root mean square of what is left over, in its expected spread.
        fitted: (2 M + 2 N + 3,) what `to_fit` of the response makes of the readings.
        response: the tensions near a force.
        pose: the arm that the response is of.
        holds: whether the misfit is at most the largest that passes, under a force that makes this
            set of cables slack.
    """

    __slots__ = ("fitted", "holds", "misfit", "pose", "response")

    def __init__(self, fitted: Array, response: _Response, pose: _Pose, largest: float) -> None:
        """`largest` is the misfit that passes."""
        self.fitted, self.response, self.pose = fitted, response, pose
        over = fitted[: len(response.elastic_n)]
        self.misfit = math.sqrt(float(over.dot(over)) / max(len(over) - 2, 1))
        self.holds = self.misfit <= largest and self.consistent and self.near

    @property
    def force_n(self) -> tuple[float, float]:
        """The force that fits best, y and z in the segment's frame."""
        (y, z), count = self.pose.force_n, len(self.response.elastic_n)
        return y + self.fitted.item(count), z + self.fitted.item(count + 1)

    @property
    def elastic_n(self) -> Array:
        """(M,) tensions under that force, negative where a slack cable lacks length."""
        elastic, begin = self.response.elastic_n, len(self.response.elastic_n) + 3
        return np.asarray(elastic + self.fitted[begin : begin + len(elastic)])

    @property
    def consistent(self) -> bool:
        """Whether no cable that was taken as slack would be taut."""
        response, begin = self.response, len(self.response.elastic_n) + 3
        for cable in response.slack:
            if response.elastic_n.item(cable) + self.fitted.item(begin + cable) > 0.0:
                return False
        return True

    @property
    def near(self) -> bool:
        """Whether tensions are linear, within their spread, from its pose to this one."""
        return self.response.to_rest_rad is None or self.pose.linear_over(self.turn_rad)

    @property
    def turn_rad(self) -> Array:
        """(2N,) how the joints turn from its pose, where that is not at rest with this set."""
        assert self.response.to_rest_rad is not None
        to_rest = self.response.to_rest_rad
        return np.asarray(to_rest + self.fitted[-len(to_rest) :])

    def without(self, cables: Sequence[int]) -> float:
        """The misfit without the readings of some cables."""
        count = len(self.response.elastic_n)
        over, of = self.fitted[:count], self.response.to_fit[:count, cables]
        left = over - of @ np.linalg.lstsq(of, over, rcond=1e-9)[0]
        return math.sqrt(float(left @ left) / max(count - 2 - len(cables), 1))

    def hidden_n(self, difference_n: Array, largest: float) -> Array:
        """(M,) how far the force may be wrong by one reading, and a misfit of `largest` pass.

        Where a cable reads slack, it may be taut and its reading zero.
        """
        count = len(difference_n)
        passes = largest * math.sqrt(max(count - 2, 1))
        hidden_n = passes * self.response.unseen_n
        for cable in self.response.slack:
            taut = self.response.taut.copy()
            taut[cable] = True
            other = self.pose.beside(difference_n, taut, largest)
            if other is None:
                continue
            of, over = other.response.to_fit[:, cable], other.fitted[:count]
            size = max(float(of[:count] @ of[:count]), 1e-18)
            fitted = other.fitted - of * (float(of[:count] @ over) / size)
            tension_n = other.response.elastic_n[cable] + fitted[count + 3 + cable]
            if np.linalg.norm(fitted[:count]) <= passes and tension_n > 0.0:
                hidden_n[cable] = math.hypot(*(fitted - self.fitted)[count : count + 2])
        return np.asarray(hidden_n)


class _Pose:
    """The arm at one command in one pose under one force, and its response to others nearby."""

    def __init__(
        self,
        fits: ForceFits,
        segment: int,
        force_n: tuple[float, float],
        angles_rad: Array,
        *,
        at_rest: bool,
    ) -> None:
        """A force, y and z, on a segment from 1 on, and joint angles (2N,)."""
        statics, command = fits.statics, fits.command_rad
        mechanism = statics.mechanism
        axes = kinematics.segment_rotations(mechanism, command)[segment - 1]
        forces = np.zeros((mechanism.segment_count, 3))
        forces[segment - 1] = axes[:, 1:] @ np.array(force_n)
        self.segment, self.force_n, self.angles_rad = segment, force_n, angles_rad
        self._fits, self._at_rest = fits, at_rest
        self._stiffness_n_m = mechanism.stiffness_n_m
        span = kinematics.spans(mechanism, angles_rad)
        self._jacobian_m = kinematics.interleave(span)
        curvature_m = (0.5 * span.by_pitch_pitch, span.by_pitch_yaw, 0.5 * span.by_yaw_yaw)
        self._curvature = (mechanism.stiffness_n_m / fits.spread_n)[:, None] * np.hstack(
            curvature_m
        )
        self._most_curved = 1.5 * float(np.abs(self._curvature).max())
        stretch_m = held_lengths_m(mechanism, angles_rad) - statics.held_m(command)
        self._elastic_n = mechanism.stiffness_n_m * stretch_m + mechanism.pretension_n
        self._taut = self._elastic_n > 0.0
        tensions = self._taut * self._elastic_n
        self._hessian = stiffness_matrix_n_m(mechanism, angles_rad, tensions, forces)
        self._gradient = potential_gradient_n_m(mechanism, angles_rad, tensions, forces)
        pushes = kinematics.contact_jacobians_m(mechanism, angles_rad)[segment - 1]
        self._torques_m = pushes.T @ np.roll(axes, -1, axis=1)  # by y, z and x
        self._along_n = ALONG_SHARE * max(math.hypot(*force_n), 0.5 * _GRIDS_N[0])
        self._responses: dict[bytes, _Response | None] = {}

    def fit(self, difference_n: Array, y_n: float, z_n: float, largest: float) -> Fit | None:
        """What readings less unloaded tensions (M,) leave over; none where nothing holds the arm.

        Which cables are taut is read first, beyond noise, then whatever reads more than nothing;
        else it follows from this pose, then by Newton's method from the estimated force, and where
        that leads nowhere from the force that fits. It ends where the misfit is `largest` at most
        and the set is that of its force, or where no set is new.
        """
        read = difference_n > self._fits.taut_from_n
        best = self.beside(difference_n, read, largest)
        if best is not None and best.holds:
            return best
        barely = difference_n > self._fits.taut_from_n - _BARELY_SPREADS * self._fits.spread_n
        tried, candidates = {read.tobytes()}, [barely, self._taut]
        if best is not None:
            candidates += self._estimated(best, y_n, z_n)
        while candidates and len(tried) < _MOST_SETS:
            taut = candidates.pop(0)
            new = taut.tobytes() not in tried
            fit = self.beside(difference_n, taut, largest) if new else None
            tried.add(taut.tobytes())
            if fit is None:
                continue
            if fit.holds:
                return fit
            if best is None or fit.misfit < best.misfit:
                best = fit
            candidates += self._estimated(fit, y_n, z_n)
        return best

    def _estimated(self, fit: Fit, y_n: float, z_n: float) -> tuple[NDArray[np.bool_], ...]:
        """(M,) which cables are taut under an estimated force, and under the one that fits."""
        away_n = (y_n - self.force_n[0], z_n - self.force_n[1])
        estimated_n = fit.response.elastic_n + fit.response.gain @ away_n
        return estimated_n > 0.0, fit.elastic_n > 0.0

    def beside(self, difference_n: Array, taut: NDArray[np.bool_], largest: float) -> Fit | None:
        """What readings (M,) leave over with a set of taut cables; none where it holds no arm."""
        response = self._response(taut)
        if response is None:
            return None
        # `dot` takes a third of the time of `@` for arrays so small
        fitted = response.to_fit.dot(difference_n - response.change_n)
        return Fit(fitted, response, self, largest)

    def linear_over(self, turn_rad: Array) -> bool:
        """Whether the tensions of taut cables are, within their spread, over a turn (2N,)."""
        size = float(turn_rad.dot(turn_rad))
        if size * self._most_curved <= 1.0:
            return True
        pitch, yaw = turn_rad[0::2], turn_rad[1::2]
        off = self._curvature @ np.concatenate((pitch * pitch, pitch * yaw, yaw * yaw))
        return float(np.abs(off).max()) <= 1.0

    def _response(self, taut: NDArray[np.bool_]) -> _Response | None:
        key = taut.tobytes()
        if key not in self._responses:
            try:
                self._responses[key] = self._linearised(taut)
            except np.linalg.LinAlgError:
                self._responses[key] = None
        return self._responses[key]

    def _linearised(self, taut: NDArray[np.bool_]) -> _Response:
        """One Newton step from the pose to rest with these taut cables, and its derivative.

        Raises:
            LinAlgError: so few cables are taut that nothing holds the arm.
        """
        spread_n, jacobian = self._fits.spread_n, self._jacobian_m
        other = (taut.astype(float) - self._taut)[:, None] * jacobian
        hessian = self._hessian + jacobian.T @ (self._stiffness_n_m[:, None] * other)
        unbalanced = self._gradient + self._elastic_n @ other
        turned = np.linalg.solve(hessian, np.column_stack([self._torques_m, -unbalanced]))
        by_y, by_z, by_x, moved = (self._stiffness_n_m[:, None] * (jacobian @ turned)).T
        elastic, gain = self._elastic_n + moved, np.column_stack([by_y, by_z])
        along = taut * by_x * (self._along_n / spread_n)
        size = float(along @ along)
        shrunk = (1.0 - 1.0 / math.sqrt(1.0 + size)) / size if size > 0.0 else 0.0
        whiten = (np.eye(len(taut)) - shrunk * np.outer(along, along)) / spread_n
        by_force = whiten @ (taut[:, None] * gain)
        to_force = np.linalg.pinv(by_force) @ whiten
        left = np.eye(len(taut)) - taut[:, None] * gain @ to_force
        to_along = self._along_n / (spread_n * (1.0 + size)) * (along @ left)
        to_force = np.vstack([to_force, to_along])
        to_elastic = np.column_stack([gain, by_x]) @ to_force
        over = whiten @ left
        sizes = np.maximum(np.linalg.norm(over, axis=0), 1e-9)
        return _Response(
            taut * elastic - self._fits.unloaded_n,
            elastic,
            gain,
            taut,
            np.flatnonzero(~taut).tolist(),
            np.linalg.norm(to_force[:2], axis=0) / sizes,
            None if self._at_rest and not other.any() else turned[:, 3],
            np.vstack([over, to_force, to_elastic, turned[:, :3] @ to_force]),
        )


class ForceFits:
    """The fits of one arm at one command.

    Attributes:
        statics: the arm.
        spread_n: standard deviation of a reading less the unloaded one, N.
        command_rad: (2N,) the command in force.
        unloaded_n: (M,) its unloaded tensions.
        taut_from_n: (M,) changes of readings from which on a cable is read as taut.
    """

    def __init__(self, statics: UnloadedTensions, spread_n: float) -> None:
        self.statics, self.spread_n = statics, spread_n
        self.command_rad = self.unloaded_n = self.taut_from_n = np.zeros(0)
        self._poses: dict[tuple[int, tuple[float, float]], _Pose | None] = {}

    def command(self, command_rad: Array) -> None:
        """The arm rests at another command (2N,)."""
        self.command_rad = command_rad
        self.unloaded_n = self.statics.predict_n(command_rad)
        self.taut_from_n = _TAUT_SPREADS * self.spread_n - self.unloaded_n
        self._poses.clear()

    def best(
        self, difference_n: Array, segment: int, y_n: float, z_n: float, largest: float
    ) -> Fit | None:
        """Readings less unloaded tensions (M,) beside a force on a segment from 1 on.

        The first fit that `holds` with a misfit of `largest`, else that of the least misfit; none
        where the arm has no rest there.
        """
        best = None
        for grid_n in _GRIDS_N:
            at_n = (grid_n * round(y_n / grid_n), grid_n * round(z_n / grid_n))
            pose = self._at_rest(segment, at_n)
            fit = None if pose is None else pose.fit(difference_n, y_n, z_n, largest)
            if fit is not None and fit.holds:
                return fit
            if best is None or (fit is not None and fit.misfit < best.misfit):
                best = fit
        return None if best is None else self._refined(difference_n, best, largest)

    def _refined(self, difference_n: Array, best: Fit, largest: float) -> Fit:
        """The fit about its own pose, by Gauss and Newton's method."""
        for _ in range(_MOST_REFINED):
            if best.near or best.misfit > _REFINED_FROM * largest:
                break
            angles = best.pose.angles_rad + best.turn_rad
            pose = _Pose(self, best.pose.segment, best.force_n, angles, at_rest=False)
            fit = pose.fit(difference_n, *best.force_n, largest)
            if fit is None:
                break
            best = fit
        return best

    def _at_rest(self, segment: int, force_n: tuple[float, float]) -> _Pose | None:
        """The arm at rest under a force; none where it has none there."""
        key = (segment, force_n)
        if key not in self._poses:
            if len(self._poses) >= _MOST_POSES:
                self._poses.clear()
            axes = kinematics.segment_rotations(self.statics.mechanism, self.command_rad)
            forces = np.zeros((len(axes), 3))
            forces[segment - 1] = axes[segment - 1, :, 1:] @ np.array(force_n)
            try:
                angles = self.statics.at_rest(self.command_rad, forces).joint_angles_rad
                self._poses[key] = _Pose(self, segment, force_n, angles, at_rest=True)
            except EquilibriumError:
                self._poses[key] = None
        return self._poses[key]
