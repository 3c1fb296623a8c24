"""Cables through guide holes and segments on joints, with all derivatives that the law needs.

A cable passes a hole at b in the plate before a joint and one at a in the plate behind it, each in
the frame of its own plate. With R = Ry(pitch) Rz(yaw) the turn of the joint, the span between them
is

    d² = |b|² + |a|² - 2 b · R a = Σ_f t_f Q_f,

t being nine trigonometric terms of the joint's two angles: 1, and cosine and sine of pitch, yaw,
their sum and their difference. Q is bilinear in the two holes. So derivatives by the angles are
those of t, a constant matrix, and derivatives by a hole are those of Q.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import plate_holes_of

Matrix = NDArray[np.float64]

LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI_CIVITA[_i, _j, _k] = 1.0
    LEVI_CIVITA[_k, _j, _i] = -1.0

_ANGLES = np.array([[0, 1, 1, 0, 0, 1, 1, 1, 1], [0, 0, 0, 1, 1, 1, 1, -1, -1]], dtype=float)
"""Pitch and yaw in the angles of the nine terms."""
_PHASES = np.array([0, 0, 1, 0, 1, 0, 1, 0, 1]) * (-0.5 * np.pi)
"""Sines are cosines a quarter of a turn behind."""


def constant(value: NDArray[np.generic]) -> nn.Buffer:
    """Numbers of an arm that go with a module and are not trained."""
    return nn.Buffer(torch.as_tensor(np.ascontiguousarray(value)))


def error_function(value: Tensor) -> Tensor:
    """erf, to 1e-7: ONNX Runtime has it in single precision only."""
    return torch.erf(value.float()).double()


def _term_derivatives() -> Matrix:
    """(9, 6, 9): terms to themselves and their derivatives by p, y, pp, py and yy."""
    by_angle = np.zeros((2, 9, 9))
    for cosine in (1, 3, 5, 7):
        sine = cosine + 1
        by_angle[:, sine, cosine] = -_ANGLES[:, cosine]
        by_angle[:, cosine, sine] = _ANGLES[:, cosine]
    by_pitch, by_yaw = by_angle
    orders = [np.eye(9), by_pitch, by_yaw, by_pitch @ by_pitch, by_pitch @ by_yaw, by_yaw @ by_yaw]
    return np.stack(orders, axis=1)


def _rotation_about(axis: int) -> Matrix:
    """(3, 3, 3): rotation about an axis as coefficients of (1, cos, sin), by Rodrigues."""
    along = np.diag(np.eye(3)[axis])
    return np.stack([along, np.eye(3) - along, LEVI_CIVITA[:, axis]], axis=-1)


def _rotation_terms() -> Matrix:
    """(9, 3, 3): R as coefficients of the nine terms."""
    # (1, cos p, sin p) x (1, cos y, sin y) by the terms: cos p cos y = (cos(p+y) + cos(p-y)) / 2
    products = np.zeros((3, 3, 9))
    products[0, 0, 0] = 1.0
    products[1, 0, 1] = 1.0
    products[2, 0, 2] = 1.0
    products[0, 1, 3] = 1.0
    products[0, 2, 4] = 1.0
    products[1, 1, [5, 7]] = 0.5
    products[2, 2, [5, 7]] = -0.5, 0.5
    products[2, 1, [6, 8]] = 0.5
    products[1, 2, [6, 8]] = 0.5, -0.5
    turn = np.einsum("kmi,mlj->ijkl", _rotation_about(1), _rotation_about(2))
    return np.einsum("ijf,ijkl->fkl", products, turn)


class Holes(NamedTuple):
    """The squares of all spans by the nine terms, with N joints and M cables.

    Attributes:
        squares: (N, 9, M) m²; zero where a cable does not pass.
        by_hole: (N, 9, 2 (N + 1) M) their derivatives by the holes of plates 0 to N, outward and
            then around.
    """

    squares: Tensor
    by_hole: Tensor


class Spans(NamedTuple):
    """The cables at B poses.

    Attributes:
        length_m: (B, 1, M) sums of the spans of each cable.
        slope_m: (B, N, 2, M) by pitch and yaw.
        curve_m: (B, N, 3, M) second derivatives: pitch², pitch yaw, yaw².
        by_hole: (B, 2 (N + 1), M) of a cable's length by its hole in each plate, outward and
            then around.
        slope_by_hole: (B, N, 2, 2 (N + 1), M) of the slopes.
        bend_rad: (B, N + 1, M) turn of a cable at each plate, behind the joint before it and
            before the one after it.
    """

    length_m: Tensor
    slope_m: Tensor
    curve_m: Tensor
    by_hole: Tensor
    slope_by_hole: Tensor
    bend_rad: Tensor


class CableGeometry(nn.Module):
    """Spans of the cables of an arm with N segments and M cables, whose holes may be off."""

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        count = mechanism.segment_count
        cables = mechanism.cable_count
        self.segment_count = count
        self.cable_count = cables
        self.term_angles = constant(np.kron(np.eye(count), _ANGLES))
        self.term_phases = constant(np.tile(_PHASES, count))
        self.straight_terms = constant(np.cos(_PHASES)[None])
        orders = _term_derivatives()
        self.first_order = constant(orders[:, :3].reshape(9, 27))
        self.second_order = constant(orders.reshape(9, 54))
        self.rotation_terms = constant(_rotation_terms().reshape(9, 9))
        nominal, _ = plate_holes_of(mechanism)
        self.radius_m = np.hypot(nominal[:, 0], nominal[:, 1])
        self.bilinear = constant(_bilinear(mechanism, nominal))
        self.unity = constant(np.ones((1, count + 1, 1, cables)))
        plates = np.arange(count + 1)
        joints = np.arange(count)[:, None]
        self.is_before = constant((plates == joints).astype(float)[:, None, :, None])
        self.is_after = constant((plates == joints + 1).astype(float)[:, None, :, None])
        absent = 1.0 - mechanism.passes_joint.T
        self.absent = constant(absent[:, None])
        # |b|² is the sum of squares of the coordinates of b, the first in units of the offset
        squared_units = np.array([mechanism.plate_offset_m**2, 1.0, 1.0])[:, None, None, None]
        first_term = np.eye(9)[0][:, None] * mechanism.passes_joint.T[:, None]
        self.doubled = constant(2.0 * squared_units * first_term)

    def holes(self, placed_m: Tensor) -> Holes:
        """Holes at (2, N + 1, M): their radius from the axis, and how far around they are off."""
        count = self.segment_count
        # a hole's coordinates: one (along the axis), outward, and around
        placed = torch.cat([self.unity, placed_m[:, :, None]])
        before = placed[:, :-1]
        after = placed[:, 1:]
        by_before = (self.bilinear * after).sum(1) + self.doubled * before
        by_after = (self.bilinear * before[:, None]).sum(0) + self.doubled * after
        # a quadratic form is half of the sum of its coordinates times its derivatives
        squares = 0.5 * (before * by_before + after * by_after).sum(0)
        by_hole_before = by_before[1:, :, :, None] * self.is_before
        by_hole_after = by_after[1:, :, :, None] * self.is_after
        by_hole = (by_hole_before + by_hole_after).permute(1, 2, 0, 3, 4).reshape(count, 9, -1)
        return Holes(squares, by_hole)

    def nominal_holes(self) -> Tensor:
        """The squares (N, 9, M) with the holes where the arm file has them."""
        placed = np.stack([self.radius_m, np.zeros_like(self.radius_m)])
        return self.holes(torch.as_tensor(placed)).squares

    def terms(self, angles_rad: Tensor) -> Tensor:
        """(B, N, 1, 9): the nine terms of each joint at angles (B, 1, 2N)."""
        terms = torch.cos(angles_rad @ self.term_angles + self.term_phases)
        return terms.reshape(-1, self.segment_count, 1, 9)

    def lengths(self, terms: Tensor, squares: Tensor) -> Tensor:
        """Sums of the spans (B, 1, M)."""
        return torch.sqrt(terms @ squares).sum(-3)

    def lengths_and_slopes(self, terms: Tensor, squares: Tensor) -> tuple[Tensor, Tensor]:
        """Sums of the spans (B, 1, M) and their slopes (B, 2N, M)."""
        orders = (terms @ self.first_order).reshape(-1, self.segment_count, 3, 9) @ squares
        square, slope = orders.split((1, 2), dim=2)
        length = torch.sqrt(square)
        return length.sum(1), (slope * (0.5 / (length + self.absent))).flatten(1, 2)

    def straight(self, holes: Holes) -> tuple[Tensor, Tensor]:
        """Lengths (1, M) of the cables of the straight arm, and their derivatives by the holes."""
        length = torch.sqrt(self.straight_terms @ holes.squares)
        slope = (self.straight_terms @ holes.by_hole).reshape(
            self.segment_count, -1, self.cable_count
        )
        return length.sum(0), (slope * (0.5 / (length + self.absent))).sum(0)

    def forward(self, terms: Tensor, holes: Holes) -> Spans:
        """All of the `Spans`."""
        count = self.segment_count
        cables = self.cable_count
        orders = (terms @ self.second_order).reshape(-1, count, 6, 9)
        square, first, second = (orders @ holes.squares).split((1, 2, 3), dim=2)
        length = torch.sqrt(square)
        per_length = 1.0 / (length + self.absent)
        # (d²)'' = 2 d d'' + 2 d'²
        half = 0.5 * per_length
        slope = first * half
        share = slope * per_length
        pitch, yaw = share.split(1, dim=2)
        _, own_yaw = slope.split(1, dim=2)
        products = torch.cat([pitch * slope, yaw * own_yaw], dim=2)
        curve = second * half - products

        by_hole = (orders[:, :, :3] @ holes.by_hole).reshape(-1, count, 3, 2 * count + 2, cables)
        by_hole = by_hole * half[:, :, :, None]
        direct, sloped = by_hole.split((1, 2), dim=2)
        slope_by_hole = sloped - share[:, :, :, None] * direct
        direct = direct[:, :, 0]
        # the part of a span's direction that is across the axis is the sine of its angle to it
        squared = (direct * direct).reshape(-1, count, 2, count + 1, cables).sum(2)
        sine = torch.sqrt(squared)
        bend = (sine * (1.0 + squared / 6.0)).sum(1)
        return Spans(length.sum(1), slope, curve, direct.sum(1), slope_by_hole, bend)


def _bilinear(mechanism: Mechanism, nominal_m: Matrix) -> Matrix:
    """(3, 3, N, 9, M): squares of the spans by the coordinates of the holes before and after.

    The coordinates are 1, outward and around; the first is the plate's place on the axis.
    """
    count = mechanism.segment_count
    angle = np.arctan2(nominal_m[:, 0], nominal_m[:, 1])
    zero = np.zeros_like(angle)
    outward = np.stack([zero, np.sin(angle), np.cos(angle)])
    around = np.stack([zero, np.cos(angle), -np.sin(angle)])
    along = np.stack([zero + mechanism.plate_offset_m, zero, zero])
    before = np.stack([-along, outward, around])[:, :, :count]
    after = np.stack([along, outward, around])[:, :, 1:]
    # before and after are (3 coordinates, 3 axes, N, M)
    rotated = -2.0 * np.einsum("fxy,ixnm,jynm->ijnfm", _rotation_terms(), before, after)
    return rotated * mechanism.passes_joint.T[:, None]


class SegmentFrames(NamedTuple):
    """The segments at B poses.

    Attributes:
        along: (B, N, 3) their axes in the base frame.
        joint_axes: (B, 3, 2N) axes of the joint angles, in columns.
        levers: (B, 3N, 3, 2N) w x a for each joint axis w that moves an axis a of a segment, first
            the x axes of all segments, then y, then z; zero for joints that do not.
        commanded: (B, N, 1, 3, 3) axes of the segments at the command, in columns.
    """

    along: Tensor
    joint_axes: Tensor
    levers: Tensor
    commanded: Tensor


class SegmentGeometry(nn.Module):
    """Torques at the joints by forces on the segments and by their weights.

    A force f at r makes the torque w · (r x f) = f · (w x r) on a joint axis w, and r is a sum of
    pieces along the segments' axes.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        count = mechanism.segment_count
        self.segment_count = count
        beyond = np.repeat(np.tril(np.ones((count, count))), 2, axis=1)
        self.beyond = constant(beyond)
        self.beyond_each = constant(np.tile(beyond, (3, 1))[:, None])
        # of each segment its joint centre, which lies at the end of those before it, and its axis
        earlier = np.stack([np.tril(np.ones((count, count)), -1), np.zeros((count, count))], 1)
        own_axis = np.stack([np.zeros((count, count)), np.eye(count)], 1)
        self.earlier = constant(earlier.reshape(2 * count, count))
        self.own = constant(own_axis.reshape(2 * count, count))
        parts, first = _parts_of_rotations(count)
        self.parts = constant(parts)
        self.first_axis = constant(first)

    def frames(self, turns: Tensor) -> SegmentFrames:
        """The frames; `turns` (B, N, 2, 3, 3) of each joint, at the pose and at the command."""
        count = self.segment_count
        joint_turns = turns.split(1, dim=1)
        rotations = [joint_turns[0]]
        for turn in joint_turns[1:]:
            rotations.append(rotations[-1] @ turn)
        pose, commanded = torch.cat(rotations, dim=1).split(1, dim=2)
        parts = pose.reshape(-1, 9 * count) @ self.parts + self.first_axis
        along, joint_axes, crossed = parts.split((3 * count, 6 * count, 27 * count), dim=1)
        joint_axes = joint_axes.reshape(-1, 3, 2 * count)
        levers = crossed.reshape(-1, 9 * count, 3) @ joint_axes
        levers = levers.reshape(-1, 3 * count, 3, 2 * count) * self.beyond_each
        return SegmentFrames(along.reshape(-1, count, 3), joint_axes, levers, commanded)

    def levers(self, frames: SegmentFrames, length_m: Tensor) -> Tensor:
        """(B, N, 6, 2N): torques of unit forces at the joint centres, and slopes by the place.

        Forces are along the axes at the command, places along those of the pose; lengths are (N,).
        """
        count = self.segment_count
        pieces = self.own + self.earlier * length_m
        arms = pieces @ frames.levers[:, :count].flatten(2)
        arms = arms.reshape(-1, count, 2, 3, 2 * count)
        return (frames.commanded.transpose(3, 4) @ arms).flatten(2, 3)

    def torsion(self, frames: SegmentFrames) -> Tensor:
        """(B, N, 1, 2N): torques of unit moments about the segments' axes."""
        return (frames.along @ frames.joint_axes * self.beyond)[:, :, None]


def _parts_of_rotations(count: int) -> tuple[Matrix, Matrix]:
    """What `frames` takes of N rotations (9N,): a matrix (9N, 36N), and what is added (36N,)."""
    rotations = np.eye(9 * count).reshape(-1, count, 3, 3)
    along = rotations[..., 0]
    joint_axes = np.zeros((9 * count, 3, count, 2))
    # a joint's pitch turns about the y axis before it, its yaw about its own z axis
    joint_axes[:, :, 1:, 0] = np.swapaxes(rotations[:, :-1, :, 1], 1, 2)
    joint_axes[..., 1] = np.swapaxes(rotations[..., 2], 1, 2)
    crossed = -np.einsum("cad,pnae->pencd", LEVI_CIVITA, rotations)
    first = np.zeros((3, count, 2))
    first[1, 0, 0] = 1.0
    parts = [table.reshape(9 * count, -1) for table in (along, joint_axes, crossed)]
    added = [np.zeros(3 * count), first.reshape(-1), np.zeros(27 * count)]
    return np.concatenate(parts, axis=1), np.concatenate(added)
