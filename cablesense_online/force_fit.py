"""The force that explains readings, by statics, and how well it does: one law for all who ask.

The tensions of an arm at rest follow from the forces on it by the static equilibrium. This is
solved on a grid of forces, once for each command, and linearised around a grid point for each set
of taut cables. A sample then costs one small product.

A fit has the set of taut cables that its own forces make: if a cable reads slack that would be
taut under them, the readings do not fit. A compliant arm with many slack cables has
two positions of rest under one force; the one of the taut readings is valid too.

The exported closed form (`cablesense_training.networks.closed_form`) is the second statement of
this law, as a graph; a test holds the two together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_online.tare import UnloadedTensions
from cablesense_sim import kinematics, rest_pose
from cablesense_sim.equilibrium import EquilibriumError, balance_at, held_lengths_m
from cablesense_sim.mechanism import Mechanism

LARGEST_MISFIT: Final = 2.3
"""Unless a model file states another: by noise alone one sample of twelve cables in ten million
exceeds it."""

ALONG_SHARE: Final = 0.5
"""Standard deviation of the force along a segment over the estimated force: friction at a contact,
or a hung weight on a bent arm."""

_GRIDS_N = (20.0, 1.0)
"""Spacings of the forces at which the equilibrium is solved. Tensions of the arm `cdsm_lab` are
linear within 0.02 N over the first; where many cables are slack and it bends, over the second."""

_MOST_POSES = 1024
_MOST_SETS, _MOST_REFINED = 8, 8
_REFINED_UP_TO = 20.0
"""Misfits up to this multiple of the largest that passes may be due to the linearisation."""
_TAUT_SPREADS, _BARELY_SPREADS = 4.0, 3.5
"""Standard deviations of a reading above which a cable is read as taut, and by which this bound is
lowered for cables that may be taut."""


def _torques_by_force_m(mechanism: Mechanism, angles_rad: Array, axes: Array) -> Array:
    """(N, 2N, A) joint torques of unit forces along axes (N, 3, A) at the contact points."""
    moves = kinematics.contact_jacobians_m(mechanism, angles_rad)
    return np.asarray(np.swapaxes(moves, -1, -2) @ axes)


class _Response(NamedTuple):
    """Tensions near forces on K segments, with one set of taut cables.

    Attributes:
        change_n: (M,) tensions at those forces minus the unloaded ones.
        elastic_n: (M,) tensions, negative where a slack cable lacks length.
        gain: (M, 2 K) their derivative by the forces.
        taut: (M,) which cables are.
        slack: positions of the others.
        unseen_n: (M,) error of a force due to an error of one reading whose residual is 1.
        to_rest_rad: (2 N,) turn of the joints from the pose to rest at those forces; None where
            they are at rest with this set.
        to_fit: (2 M + 2 N + 3 K, M) maps readings less `change_n` to their residuals, in expected
            standard deviations; to the forces to add, y and z of each, then x of each, N; and to
            the resulting change of `elastic_n` and turn of the joints.
    """

    change_n: Array
    elastic_n: Array
    gain: Array
    taut: NDArray[np.bool_]
    slack: list[int]
    unseen_n: Array
    to_rest_rad: Array | None
    to_fit: Array


class ForceFit:
    """The forces that explain readings best, and how well they do.

    Attributes:
        misfit: RMS of the residuals, in expected standard deviations.
        fitted: (2 M + 2 N + 3 K,) the response's `to_fit` applied to the readings.
        response: the tensions near those forces.
        pose: the arm at which the response is linearised.
        force_n: (2 K,) the forces that fit best, y and z of each in its segment's frame.
        holds: whether the misfit is at most the largest that passes, under forces that make this
            set of cables slack.
    """

    __slots__ = ("fitted", "force_n", "holds", "misfit", "pose", "response")

    def __init__(
        self, fitted: Array, response: _Response, pose: _LoadedPose, largest: float
    ) -> None:
        """`largest` is the misfit that passes."""
        self.fitted, self.response, self.pose = fitted, response, pose
        count, item = len(response.elastic_n), fitted.item
        residual = fitted[:count]
        self.misfit = math.sqrt(float(residual.dot(residual)) / pose.free)
        self.force_n = tuple([at_n + item(k) for k, at_n in enumerate(pose.force_n, count)])
        self.holds = self.misfit <= largest and self.consistent and self.near

    @property
    def segments(self) -> tuple[int, ...]:
        """The touched segments, from 1 on."""
        return self.pose.segments

    @property
    def size_n(self) -> float:
        """The size of the forces together."""
        return math.hypot(*self.force_n)

    @property
    def elastic_n(self) -> Array:
        """(M,) tensions under those forces, negative where a slack cable lacks length."""
        elastic_n, begin = self.response.elastic_n, self.pose.elastic_from
        return np.asarray(elastic_n + self.fitted[begin : begin + len(elastic_n)])

    @property
    def consistent(self) -> bool:
        """Whether no cable that was assumed slack would be taut."""
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
        """(2N,) rotation of the joints from its pose, if that is not at rest with this set."""
        assert self.response.to_rest_rad is not None
        to_rest = self.response.to_rest_rad
        return np.asarray(to_rest + self.fitted[-len(to_rest) :])

    def without(self, cables: Sequence[int]) -> float:
        """The misfit without the readings of some cables."""
        count = len(self.response.elastic_n)
        residual, of = self.fitted[:count], self.response.to_fit[:count, cables]
        residual = residual - of @ np.linalg.lstsq(of, residual, rcond=1e-9)[0]
        return math.sqrt(float(residual @ residual) / max(self.pose.free - len(cables), 1))

    def hidden_n(self, difference_n: Array, largest: float) -> Array:
        """(M,) largest error of a force due to one wrong reading, at a misfit of `largest`.

        A cable that reads slack may be taut, and its reading of zero wrong.
        """
        count, begin = len(difference_n), self.pose.elastic_from
        passes = largest * math.sqrt(self.pose.free)
        hidden_n = passes * self.response.unseen_n
        for cable in self.response.slack:
            taut = self.response.taut.copy()
            taut[cable] = True
            other = self.pose.with_taut(difference_n, taut, largest)
            if other is None:
                continue
            of, residual = other.response.to_fit[:, cable], other.fitted[:count]
            size = max(float(of[:count] @ of[:count]), 1e-18)
            fitted = other.fitted - of * (float(of[:count] @ residual) / size)
            tension_n = other.response.elastic_n[cable] + fitted[begin + cable]
            if np.linalg.norm(fitted[:count]) <= passes and tension_n > 0.0:
                off_n = (fitted - self.fitted)[count : count + len(self.pose.force_n)]
                hidden_n[cable] = np.linalg.norm(off_n.reshape(-1, 2), axis=1).max()
        return np.asarray(hidden_n)


class _LoadedPose:
    """The arm at one command in one pose under some forces, and its response to others nearby.

    Attributes:
        segments, force_n, angles_rad: of the arguments.
        free: degrees of freedom of the residuals.
        elastic_from: where in `ForceFit.fitted` tensions begin.
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
        shape = rest_pose.posed(rest_pose.plates_of(mechanism, 1), angles_rad[None])
        self._jacobian_m = shape.by_turn_m[0].reshape(mechanism.cable_count, -1)
        pitch_m, both_m, yaw_m = np.moveaxis(shape.by_turns_m[0], -1, 0)
        curvature_m = (0.5 * pitch_m, both_m, 0.5 * yaw_m)
        stiffness = mechanism.stiffness_n_m / fits.spread_n
        self._curvature = stiffness[:, None] * np.hstack(curvature_m)
        self._most_curved = 1.5 * float(np.abs(self._curvature).max())
        stretch_m = held_lengths_m(mechanism, angles_rad) - statics.held_m(command)
        self._elastic_n = mechanism.stiffness_n_m * stretch_m + mechanism.pretension_n
        self._taut = self._elastic_n > 0.0
        tensions_n = self._taut * self._elastic_n
        self._balance = balance_at(mechanism, angles_rad, tensions_n, forces)
        touched = np.array(segments) - 1
        axes = kinematics.segment_rotations(mechanism, command)
        by_axis = _torques_by_force_m(mechanism, angles_rad, axes)[touched]
        self._torques_m = np.hstack([*by_axis[..., 1:], *by_axis[..., :1]])  # by y and z, then x
        sizes_n = np.linalg.norm(np.array(force_n).reshape(-1, 2), axis=1)
        self._along_n = ALONG_SHARE * np.maximum(sizes_n, 0.5 * _GRIDS_N[0])
        self._responses: dict[bytes, _Response | None] = {}

    def fit(
        self, difference_n: Array, force_n: Sequence[float], largest: float
    ) -> ForceFit | None:
        """Fit readings less unloaded tensions (M,); None where nothing holds the arm.

        The set of taut cables is first read beyond noise, then from whatever reads more than zero.
        Next are the sets of this pose, of the estimated forces and of the forces that fit. The
        search ends when the misfit is at most `largest` and the set is that of its forces, or when
        no set is new.
        """
        best: ForceFit | None = None
        tried, from_n = set[bytes](), self._fits.taut_from_n
        barely_n = from_n - _BARELY_SPREADS * self._fits.spread_n
        candidates = [difference_n > from_n, difference_n > barely_n, self._taut]
        while candidates and len(tried) < _MOST_SETS:
            taut = candidates.pop(0)
            if taut.tobytes() in tried:
                continue
            tried.add(taut.tobytes())
            fit = self.with_taut(difference_n, taut, largest)
            if fit is None:
                continue
            if fit.holds:
                return fit
            if best is None or fit.misfit < best.misfit:
                best = fit
            candidates += self._estimated(fit, force_n)
        return best

    def _estimated(self, fit: ForceFit, force_n: Sequence[float]) -> tuple[NDArray[np.bool_], ...]:
        """Sets of taut cables (M,) under the estimated forces, and under those that fit."""
        away_n = np.subtract(force_n, self.force_n)
        estimated_n = fit.response.elastic_n + fit.response.gain @ away_n
        return estimated_n > 0.0, fit.elastic_n > 0.0

    def with_taut(
        self, difference_n: Array, taut: NDArray[np.bool_], largest: float
    ) -> ForceFit | None:
        """Fit readings (M,) with a set of taut cables; None where that holds no arm."""
        response = self._response(taut)
        if response is None:
            return None
        # `dot` takes a third of the time of `@` for such small arrays
        fitted = response.to_fit.dot(difference_n - response.change_n)
        return ForceFit(fitted, response, self, largest)

    def linear_over(self, turn_rad: Array) -> bool:
        """Whether taut cables' tensions are linear, within their spread, over a turn (2N,)."""
        size = float(turn_rad.dot(turn_rad))
        if size * self._most_curved <= 1.0:
            return True
        pitch, yaw = turn_rad[0::2], turn_rad[1::2]
        off = self._curvature @ np.concatenate((pitch * pitch, pitch * yaw, yaw * yaw))
        return float(np.abs(off).max()) <= 1.0

    def _response(self, taut: NDArray[np.bool_]) -> _Response | None:
        key = taut.tobytes()
        if key not in self._responses:
            self._responses[key] = None
            with suppress(np.linalg.LinAlgError):
                self._responses[key] = self._linearised(taut)
        return self._responses[key]

    def _linearised(self, taut: NDArray[np.bool_]) -> _Response:
        """One Newton step from the pose to rest with these taut cables, and its derivative.

        Raises:
            LinAlgError: so few cables are taut that nothing holds the arm.
        """
        spread_n, jacobian = self._fits.spread_n, self._jacobian_m
        other = (taut.astype(float) - self._taut)[:, None] * jacobian
        hessian = self._balance.slope_n_m + jacobian.T @ (self._stiffness_n_m[:, None] * other)
        unbalanced = self._balance.torque_n_m + self._elastic_n @ other
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
        to_residual = np.eye(len(taut)) - taut[:, None] * gain @ to_force
        to_along = (turn.T * (sizes / (1.0 + sizes * sizes))) @ (sides.T @ to_residual)
        to_force = np.vstack([to_force, self._along_n[:, None] / spread_n * to_along])
        to_elastic = np.stack(by, 1) @ to_force
        to_residual = whiten @ to_residual
        off_n = np.linalg.norm(to_force[:count].reshape(-1, 2, len(taut)), axis=1).max(axis=0)
        return _Response(
            taut * elastic - self._fits.unloaded_n,
            elastic,
            gain,
            taut,
            np.flatnonzero(~taut).tolist(),
            off_n / np.maximum(np.linalg.norm(to_residual, axis=0), 1e-9),
            None if self._at_rest and not other.any() else turned[:, -1],
            # stored by columns: products with so small a vector are faster
            np.asfortranarray(
                np.vstack([to_residual, to_force, to_elastic, turned[:, :-1] @ to_force])
            ),
        )


class ForceFits:
    """The fits of one arm at one command.

    Attributes:
        statics: the arm.
        spread_n: expected standard deviation of a reading minus the unloaded one, N.
        command_rad: (2N,) the command in force.
        unloaded_n: (M,) its unloaded tensions.
        taut_from_n: (M,) differences above which a cable is read as taut.
    """

    def __init__(self, statics: UnloadedTensions, spread_n: float) -> None:
        self.statics, self.spread_n = statics, spread_n
        self.command_rad = self.unloaded_n = self.taut_from_n = np.zeros(0)
        self._poses: dict[tuple[tuple[int, ...], tuple[float, ...]], _LoadedPose | None] = {}

    def command(self, command_rad: Array) -> None:
        """The arm rests at a command (2N,); another array is another command."""
        if command_rad is self.command_rad:
            return
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
    ) -> ForceFit | None:
        """Fit readings less unloaded tensions (M,) near forces (2 K,), y and z, on K segments.

        Gives the first fit that `holds` with a misfit of `largest`, or else the one of least
        misfit; None where the arm has no rest there.
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

    def angles_deg(self, difference_n: Array, segments: tuple[int, ...]) -> list[float]:
        """Contact angles of the forces on segments, from 1 on, that fit differences (M,) best."""
        near = self.best(difference_n, segments, (0.0,) * (2 * len(segments)), LARGEST_MISFIT)
        assert near is not None  # an arm that rests without forces is linearised there
        fit = self.best(difference_n, segments, near.force_n, LARGEST_MISFIT) or near
        y, z = np.reshape(fit.force_n, (-1, 2)).T
        return (np.rad2deg(np.arctan2(y, z)) % 360.0).tolist()

    def _refined(self, difference_n: Array, best: ForceFit, largest: float) -> ForceFit:
        """The fit linearised about its own pose, by Gauss-Newton steps."""
        for _ in range(_MOST_REFINED):
            if best.near or best.misfit > _REFINED_UP_TO * largest:
                break
            angles = best.pose.angles_rad + best.turn_rad
            pose = _LoadedPose(self, best.pose.segments, best.force_n, angles, at_rest=False)
            fit = pose.fit(difference_n, best.force_n, largest)
            if fit is None:
                break
            best = fit
        return best

    def _at_rest(
        self, segments: tuple[int, ...], force_n: tuple[float, ...]
    ) -> _LoadedPose | None:
        """The arm at rest under forces; None where it cannot rest."""
        key = (segments, force_n)
        if key not in self._poses:
            if len(self._poses) >= _MOST_POSES:
                self._poses.clear()
            forces = self.forces_n(segments, force_n)
            try:
                angles = self.statics.at_rest(self.command_rad, forces).joint_angles_rad
                self._poses[key] = _LoadedPose(self, segments, force_n, angles, at_rest=True)
            except EquilibriumError:
                self._poses[key] = None
        return self._poses[key]
