"""How well readings fit forces on some segments, and which forces fit them best.

The tensions of an arm at rest follow from the forces by the static equilibrium. It is solved on a
grid of forces, once for a command, and taken as linear around a point of the grid with each set of
taut cables. So a sample costs one small product.

A fit has the set of taut cables that its own forces make: where a cable reads slack that would be
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
_REFINED_UP_TO = 20.0
"""Misfits of up to so many times the largest that passes may come from taking as linear."""
_TAUT_SPREADS, _BARELY_SPREADS = 4.0, 3.5
"""A reading of so many times its spread is that of a taut cable; one of so many less may be."""


class _Response(NamedTuple):
    """Tensions near forces on K segments, with one set of taut cables.

    Attributes:
        change_n: (M,) tensions at those forces less the unloaded ones.
        elastic_n: (M,) tensions, negative where a slack cable lacks length.
        gain: (M, 2 K) their derivative by the forces.
        taut: (M,) which cables are.
        slack: positions of the others.
        unseen_n: (M,) how far a force is off by an error of one reading that leaves over 1.
        to_rest_rad: (2 N,) how the joints turn from the pose to rest at those forces; none where
            they are at rest with this set.
        to_fit: (2 M + 2 N + 3 K, M) takes readings less `change_n` to what is left over of them,
            in its expected spread; to the forces to be added, y and z of each, then x of each, N;
            to what that adds to `elastic_n`; and to how far it turns the joints.
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
    """Readings beside the tensions under the forces that fit them best.

    Attributes:
        misfit: root mean square of what is left over, in its expected spread.
        fitted: (2 M + 2 N + 3 K,) what `to_fit` of the response makes of the readings.
        response: the tensions near those forces.
        pose: the arm that the response is of.
        force_n: (2 K,) the forces that fit best, y and z of each in its segment's frame.
        holds: whether the misfit is at most the largest that passes, under forces that make this
            set of cables slack.
    """

    __slots__ = ("fitted", "force_n", "holds", "misfit", "pose", "response")

    def __init__(self, fitted: Array, response: _Response, pose: _Pose, largest: float) -> None:
        """`largest` is the misfit that passes."""
        self.fitted, self.response, self.pose = fitted, response, pose
        count, item = len(response.elastic_n), fitted.item
        over = fitted[:count]
        self.misfit = math.sqrt(float(over.dot(over)) / pose.free)
        self.force_n = tuple([at_n + item(k) for k, at_n in enumerate(pose.force_n, count)])
        self.holds = self.misfit <= largest and self.consistent and self.near

    @property
    def elastic_n(self) -> Array:
        """(M,) tensions under those forces, negative where a slack cable lacks length."""
        elastic, begin = self.response.elastic_n, self.pose.elastic_from
        return np.asarray(elastic + self.fitted[begin : begin + len(elastic)])

    @property
    def consistent(self) -> bool:
        """Whether no cable that was taken as slack would be taut."""
        response, begin = self.response, self.pose.elastic_from
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
        return math.sqrt(float(left @ left) / max(self.pose.free - len(cables), 1))

    def hidden_n(self, difference_n: Array, largest: float) -> Array:
        """(M,) how far a force may be wrong by one reading, and a misfit of `largest` pass.

        Where a cable reads slack, it may be taut and its reading zero.
        """
        count, begin = len(difference_n), self.pose.elastic_from
        passes = largest * math.sqrt(self.pose.free)
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
            tension_n = other.response.elastic_n[cable] + fitted[begin + cable]
            if np.linalg.norm(fitted[:count]) <= passes and tension_n > 0.0:
                off_n = (fitted - self.fitted)[count : count + len(self.pose.force_n)]
                hidden_n[cable] = np.linalg.norm(off_n.reshape(-1, 2), axis=1).max()
        return np.asarray(hidden_n)


class _Pose:
    """The arm at one command in one pose under some forces, and its response to others nearby.

    Attributes:
        segments, force_n, angles_rad: of the arguments.
        free: how many combinations of readings are left over.
        elastic_from: where in `Fit.fitted` tensions begin.
    """

    def __init__(
        self,
        fits: ForceFits,
        segments: tuple[int, ...],
        force_n: tuple[float, ...],
        angles_rad: Array,
        *,
        at_rest: bool,
    ) -> None:
        """Forces (2 K,), y and z, on K segments from 1 on, and joint angles (2 N,)."""
        statics, command = fits.statics, fits.command_rad
        mechanism = statics.mechanism
        forces = fits.forces_n(segments, force_n)
        self.segments, self.force_n, self.angles_rad = segments, force_n, angles_rad
        self.free = max(mechanism.cable_count - len(force_n), 1)
        self.elastic_from = mechanism.cable_count + 3 * len(segments)
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
        touched = np.array(segments) - 1
        axes = kinematics.segment_rotations(mechanism, command)[touched]
        pushes = kinematics.contact_jacobians_m(mechanism, angles_rad)[touched]
        by_axis = np.swapaxes(pushes, 1, 2) @ axes
        self._torques_m = np.hstack([*by_axis[..., 1:], *by_axis[..., :1]])  # by y and z, then x
        sizes_n = np.linalg.norm(np.array(force_n).reshape(-1, 2), axis=1)
        self._along_n = ALONG_SHARE * np.maximum(sizes_n, 0.5 * _GRIDS_N[0])
        self._responses: dict[bytes, _Response | None] = {}

    def fit(self, difference_n: Array, force_n: Sequence[float], largest: float) -> Fit | None:
        """What readings less unloaded tensions (M,) leave over; none where nothing holds the arm.

        Which cables are taut is read first, beyond noise, then whatever reads more than nothing;
        else it follows from this pose, then by Newton's method from the estimated forces, and
        where that leads nowhere from those that fit. It ends where the misfit is `largest` at most
        and the set is that of its forces, or where no set is new.
        """
        read = difference_n > self._fits.taut_from_n
        best = self.beside(difference_n, read, largest)
        if best is not None and best.holds:
            return best
        barely = difference_n > self._fits.taut_from_n - _BARELY_SPREADS * self._fits.spread_n
        tried, candidates = {read.tobytes()}, [barely, self._taut]
        if best is not None:
            candidates += self._estimated(best, force_n)
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
            candidates += self._estimated(fit, force_n)
        return best

    def _estimated(self, fit: Fit, force_n: Sequence[float]) -> tuple[NDArray[np.bool_], ...]:
        """(M,) which cables are taut under estimated forces, and under those that fit."""
        away_n = np.subtract(force_n, self.force_n)
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
        *by, moved = (self._stiffness_n_m[:, None] * (jacobian @ turned)).T
        count = len(self.force_n)
        elastic, gain, by_x = self._elastic_n + moved, np.stack(by[:count], 1), by[count:]
        along = (taut * by_x).T * (self._along_n / spread_n)
        sides, sizes, turn = np.linalg.svd(along, full_matrices=False)
        whiten = np.eye(len(taut)) - (sides * (1.0 - 1.0 / np.hypot(1.0, sizes))) @ sides.T
        whiten /= spread_n
        by_force = whiten @ (taut[:, None] * gain)
        to_force = np.linalg.pinv(by_force) @ whiten
        left = np.eye(len(taut)) - taut[:, None] * gain @ to_force
        to_along = (turn.T * (sizes / (1.0 + sizes * sizes))) @ (sides.T @ left)
        to_force = np.vstack([to_force, self._along_n[:, None] / spread_n * to_along])
        to_elastic = np.stack(by, 1) @ to_force
        over = whiten @ left
        off_n = np.linalg.norm(to_force[:count].reshape(-1, 2, len(taut)), axis=1).max(axis=0)
        return _Response(
            taut * elastic - self._fits.unloaded_n,
            elastic,
            gain,
            taut,
            np.flatnonzero(~taut).tolist(),
            off_n / np.maximum(np.linalg.norm(over, axis=0), 1e-9),
            None if self._at_rest and not other.any() else turned[:, -1],
            # by columns, as products with a vector so small are faster
            np.asfortranarray(np.vstack([over, to_force, to_elastic, turned[:, :-1] @ to_force])),
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
        self._poses: dict[tuple[tuple[int, ...], tuple[float, ...]], _Pose | None] = {}

    def command(self, command_rad: Array) -> None:
        """The arm rests at another command (2N,)."""
        self.command_rad = command_rad
        self.unloaded_n = self.statics.predict_n(command_rad)
        self.taut_from_n = _TAUT_SPREADS * self.spread_n - self.unloaded_n
        self._poses.clear()

    def forces_n(self, segments: Sequence[int], force_n: Sequence[float]) -> Array:
        """(N, 3) forces (2 K,), y and z, on K segments from 1 on, in base axes."""
        axes = kinematics.segment_rotations(self.statics.mechanism, self.command_rad)
        forces = np.zeros((len(axes), 3))
        for number, pair_n in zip(segments, np.reshape(force_n, (-1, 2)), strict=True):
            forces[number - 1] = axes[number - 1, :, 1:] @ pair_n
        return forces

    def best(
        self,
        difference_n: Array,
        segments: tuple[int, ...],
        force_n: Sequence[float],
        largest: float,
    ) -> Fit | None:
        """Readings less unloaded tensions (M,) beside forces (2 K,), y and z, on K segments.

        The first fit that `holds` with a misfit of `largest`, else that of the least misfit; none
        where the arm has no rest there.
        """
        best = None
        for grid_n in _GRIDS_N:
            at_n = tuple([grid_n * round(part_n / grid_n) for part_n in force_n])
            pose = self._at_rest(segments, at_n)
            fit = None if pose is None else pose.fit(difference_n, force_n, largest)
            if fit is not None and fit.holds:
                return fit
            if best is None or (fit is not None and fit.misfit < best.misfit):
                best = fit
        return None if best is None else self._refined(difference_n, best, largest)

    def _refined(self, difference_n: Array, best: Fit, largest: float) -> Fit:
        """The fit about its own pose, by Gauss and Newton's method."""
        for _ in range(_MOST_REFINED):
            if best.near or best.misfit > _REFINED_UP_TO * largest:
                break
            angles = best.pose.angles_rad + best.turn_rad
            pose = _Pose(self, best.pose.segments, best.force_n, angles, at_rest=False)
            fit = pose.fit(difference_n, best.force_n, largest)
            if fit is None:
                break
            best = fit
        return best

    def _at_rest(self, segments: tuple[int, ...], force_n: tuple[float, ...]) -> _Pose | None:
        """The arm at rest under forces; none where it has none there."""
        key = (segments, force_n)
        if key not in self._poses:
            if len(self._poses) >= _MOST_POSES:
                self._poses.clear()
            forces = self.forces_n(segments, force_n)
            try:
                angles = self.statics.at_rest(self.command_rad, forces).joint_angles_rad
                self._poses[key] = _Pose(self, segments, force_n, angles, at_rest=True)
            except EquilibriumError:
                self._poses[key] = None
        return self._poses[key]
