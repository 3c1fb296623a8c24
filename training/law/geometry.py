"""Cables through guide holes and segments on joints, with all derivatives that the law needs.

With before_i and after_i the holes of cable i in the plates around a joint, each in the frame of
its own plate, and R = Ry(pitch) Rz(yaw) the turn of the joint, the span across it is

    d_i² = |before_i|² + |after_i|² - 2 before_i · R after_i.

Every derivative of d² by the angles has R replaced by its own derivative, and those by the holes
follow from R after and Rᵀ before. So a stack of six matrices for each joint does all.
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

_BY_ANGLE = np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
"""Coefficients of d/dx (1, cos x, sin x) = (0, -sin x, cos x)."""

_TINY = 1e-18


def constant(value: NDArray[np.generic]) -> nn.Buffer:
    """Numbers of an arm that go with a module and are not trained."""
    return nn.Buffer(torch.as_tensor(np.ascontiguousarray(value)))


def _rotation_about(axis: int) -> Matrix:
    """(3, 3, 3): rotation about an axis as coefficients of (1, cos, sin), by Rodrigues."""
    along = np.diag(np.eye(3)[axis])
    return np.stack([along, np.eye(3) - along, LEVI_CIVITA[:, axis]], axis=-1)


def _joint_rotation_stack() -> Matrix:
    """(9, 81): products of (1, cos, sin) of pitch and yaw to nine matrices.

    They are R, R_p, R_y, R_pp, R_py and R_yy, and the first three transposed.
    """
    plain = np.einsum("kmi,mlj->ijkl", _rotation_about(1), _rotation_about(2))

    def by_pitch(coefficients: Matrix) -> Matrix:
        return np.einsum("ai,ijkl->ajkl", _BY_ANGLE, coefficients)

    def by_yaw(coefficients: Matrix) -> Matrix:
        return np.einsum("bj,ijkl->ibkl", _BY_ANGLE, coefficients)

    pitched = by_pitch(plain)
    yawed = by_yaw(plain)
    stack = [plain, pitched, yawed, by_pitch(pitched), by_yaw(pitched), by_yaw(yawed)]
    stack += [np.swapaxes(each, 2, 3) for each in stack[:3]]
    return np.stack(stack, axis=2).reshape(9, 81)


def error_function(value: Tensor) -> Tensor:
    """erf, to 1e-7: ONNX Runtime has it in single precision only."""
    return torch.erf(value.float()).double()


class Holes(NamedTuple):
    """Where the cables pass the plates around each joint, (N, 3, M) m in the frames of the plates."""

    before_m: Tensor
    after_m: Tensor


class Spans(NamedTuple):
    """The cables at B poses.

    Attributes:
        length_m: (B, M) sums of the spans of each cable.
        slope_m: (B, N, 2, M) by pitch and yaw.
        curve_m: (B, N, 3, M) second derivatives: pitch², pitch yaw, yaw².
        by_hole: (B, 2, N + 1, M) of a cable's length by its hole, outward and around, in each plate.
        slope_by_hole: (B, 2N, 2, N + 1, M) of the slopes of all joints.
        bend_rad: (B, N, M) turn of a cable at the guides of each joint: behind the joint before it
            and before this one.
    """

    length_m: Tensor
    slope_m: Tensor
    curve_m: Tensor
    by_hole: Tensor
    slope_by_hole: Tensor
    bend_rad: Tensor

    @property
    def jacobian_t_m(self) -> Tensor:
        """(B, 2N, M) transposed derivative of the cables' lengths by the joint angles."""
        return self.slope_m.flatten(1, 2)


class CableGeometry(nn.Module):
    """Spans of the cables of an arm with N segments and M cables, whose holes may be off."""

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        count = mechanism.segment_count
        cables = mechanism.cable_count
        self.segment_count = count
        self.cable_count = cables
        self.trig_map = constant(np.kron(np.eye(2 * count), [0.0, 1.0, 1.0]))
        self.trig_shift = constant(np.tile([0.0, 0.0, -0.5 * np.pi], 2 * count))
        joint = np.repeat(np.arange(count), 9)
        self.pitch_feature = constant(6 * joint + np.tile(np.arange(9) // 3, count))
        self.yaw_feature = constant(6 * joint + 3 + np.tile(np.arange(9) % 3, count))
        self.rotation_map = constant(_joint_rotation_stack())
        holes, _ = plate_holes_of(mechanism)
        angle = np.arctan2(holes[:, 0], holes[:, 1])
        outward = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        around = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        self.hole_m = constant(holes)
        self.outward = constant(outward)
        self.around = constant(around)
        units = np.stack([outward, around], axis=1)
        # (N, 2, 1, 2, 2, M): before and after each joint, outward and around, (y, z)
        self.units = constant(np.stack([units[:-1], units[1:]], axis=1)[:, :, None])
        offset = np.full((count, 1, cables), mechanism.plate_offset_m)
        self.before_x = constant(-offset)
        self.after_x = constant(offset)
        passes = mechanism.passes_joint.T.astype(float)
        self.passes = constant(passes)
        self.absent = constant(1.0 - passes)
        plate = np.zeros((count, 2, count + 1))
        for n in range(count):
            plate[n, 0, n] = 1.0
            plate[n, 1, n + 1] = 1.0
        self.plate = constant(plate.reshape(2 * count, count + 1).T)
        self.plate_of_side = constant(plate[:, :, None, None, :, None])
        self.first = constant(np.array([0, 0, 1]))
        self.second = constant(np.array([0, 1, 1]))
        bends = np.stack([np.eye(count), np.eye(count, k=-1)], axis=2)
        self.bends_of_joint = constant(bends.reshape(count, 2 * count))

    def holes(self, outward_m: Tensor, around_m: Tensor) -> Holes:
        """The holes, displaced by (N + 1, M) outward and around the axis."""
        outward = outward_m[:, None] * self.outward
        return self._holes_at(self.hole_m + outward + around_m[:, None] * self.around)

    def nominal_holes(self) -> Holes:
        """The holes where the arm file has them."""
        return self._holes_at(self.hole_m)

    def _holes_at(self, hole_m: Tensor) -> Holes:
        before = torch.cat([self.before_x, hole_m[:-1]], dim=1)
        after = torch.cat([self.after_x, hole_m[1:]], dim=1)
        return Holes(before, after)

    def rotations(self, angles_rad: Tensor) -> Tensor:
        """(B, N, 9, 3, 3): the stack of each joint at angles (B, 2N)."""
        trig = torch.cos(angles_rad @ self.trig_map + self.trig_shift)
        features = trig.index_select(1, self.pitch_feature) * trig.index_select(
            1, self.yaw_feature
        )
        stack = features.reshape(-1, self.segment_count, 9) @ self.rotation_map
        return stack.reshape(-1, self.segment_count, 9, 3, 3)

    def straight_m(self, holes: Holes) -> Tensor:
        """(M,) sums of the spans with the arm straight."""
        apart = holes.after_m - holes.before_m
        return (torch.sqrt((apart * apart).sum(1)) * self.passes).sum(0)

    def lengths(self, turns: Tensor, holes: Holes) -> Tensor:
        """Sums of the spans (B, M); `turns` by `rotations`."""
        rotated = turns[:, :, 0] @ holes.after_m
        inner = (holes.before_m * rotated).sum(2)
        return (self._length(inner, holes) * self.passes).sum(1)

    def lengths_and_slopes(self, turns: Tensor, holes: Holes) -> tuple[Tensor, Tensor]:
        """Sums of the spans (B, M) and their slopes (B, 2N, M); `turns` by `rotations`."""
        count = self.segment_count
        first = turns[:, :, :3].reshape(-1, count, 9, 3)
        rotated = (first @ holes.after_m).reshape(-1, count, 3, 3, self.cable_count)
        inner = (holes.before_m[:, None] * rotated).sum(3)
        length = self._length(inner[:, :, 0], holes)
        slope = -inner[:, :, 1:] * (self.passes / length)[:, :, None]
        return (length * self.passes).sum(1), slope.flatten(1, 2)

    def _length(self, inner: Tensor, holes: Holes) -> Tensor:
        """(B, N, M); one where a cable does not pass."""
        squares = (holes.before_m**2 + holes.after_m**2).sum(1) * self.passes + self.absent
        return torch.sqrt(squares - inner * (2.0 * self.passes))

    def forward(self, turns: Tensor, holes: Holes) -> Spans:
        """All of the `Spans`; `turns` by `rotations`."""
        count = self.segment_count
        cables = self.cable_count
        both = torch.cat([holes.after_m, holes.before_m], dim=2)
        turned = (turns.reshape(-1, count, 27, 3) @ both).reshape(-1, count, 9, 3, 2 * cables)
        rotated = turned[:, :, :6, :, :cables]
        back = turned[:, :, 6:, :, cables:]
        inner = (holes.before_m[:, None] * rotated).sum(3)
        length = self._length(inner[:, :, 0], holes)
        per_length = (self.passes / length)[:, :, None]
        slope = -inner[:, :, 1:3] * per_length
        products = slope.index_select(2, self.first) * slope.index_select(2, self.second)
        curve = -(inner[:, :, 3:] + products) * per_length

        # for both holes of a span: where the other one is, in this one's frame, and its slopes
        seen = torch.stack([rotated[:, :, :3, 1:], back[:, :, :, 1:]], dim=2)
        own = torch.stack([holes.before_m[:, 1:], holes.after_m[:, 1:]], dim=1)
        away = own[:, :, None] - seen[:, :, :, :1]
        by_hole = (away[:, :, :, None] * self.units).sum(5) * per_length[:, :, None, None]
        direct = (seen[:, :, :, 1:, None] * self.units).sum(5)
        through = slope[:, :, None, :, None] * by_hole
        slope_by_side = -(direct + through) * per_length[:, :, None, None]
        of_plates = self.plate @ by_hole.reshape(-1, 2 * count, 2 * cables)
        of_plates = of_plates.reshape(-1, count + 1, 2, cables).transpose(1, 2)
        slope_by_hole = (slope_by_side[:, :, :, :, :, None] * self.plate_of_side).sum(2)
        sine = torch.sqrt((away * away).sum((3, 4)) + _TINY) * per_length
        bend = sine + sine**3 / 6.0
        bend = self.bends_of_joint @ bend.reshape(-1, 2 * count, cables)
        return Spans(
            length_m=(length * self.passes).sum(1),
            slope_m=slope,
            curve_m=curve,
            by_hole=of_plates,
            slope_by_hole=slope_by_hole.flatten(1, 2),
            bend_rad=bend,
        )


class SegmentFrames(NamedTuple):
    """The segments at B poses.

    Attributes:
        axes: (B, N, 3, 3) axes of each segment in its rows, in the base frame.
        joint_axes: (B, 2N, 3) axes of the joint angles.
    """

    axes: Tensor
    joint_axes: Tensor


class SegmentGeometry(nn.Module):
    """Torques at the joints by forces on the segments and by their weights."""

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        count = mechanism.segment_count
        self.segment_count = count
        beyond = np.repeat(np.tril(np.ones((count, count))), 2, axis=1)
        self.beyond = constant(beyond)
        inside = np.zeros((count, count, count))
        for joint in range(count):
            for segment in range(joint, count):
                inside[segment, joint, joint:segment] = 1.0
        self.between = constant(np.repeat(inside, 2, axis=1))
        self.cross = constant(LEVI_CIVITA.transpose(1, 0, 2).reshape(3, 9))
        self.upright = constant(np.array([0.0, 1.0, 0.0]))

    def frames(self, turns: Tensor) -> SegmentFrames:
        """The frames; `turns` (B, N, 9, 3, 3) by `CableGeometry.rotations`."""
        own = turns[:, :, 0].unbind(1)
        rotation = own[0]
        rotations = [rotation]
        for turn in own[1:]:
            rotation = rotation @ turn
            rotations.append(rotation)
        axes = torch.stack(rotations, dim=1).transpose(2, 3)
        # a joint's pitch turns about the y axis before it, its yaw about its own z axis
        first = self.upright + 0.0 * axes[:, :1, 1]
        before = torch.cat([first, axes[:, :-1, 1]], dim=1)
        joint_axes = torch.stack([before, axes[:, :, 2]], dim=2)
        return SegmentFrames(axes, joint_axes.flatten(1, 2))

    def levers(
        self, frames: SegmentFrames, force_axes: Tensor, length_m: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Torques of unit forces at the joint centres (B, N, 3, 2N), their slope by the place.

        The torque on joint axis w of a force e at distance r is w · (r x e) = r · (e x w). Forces
        are along `force_axes` (B, N, 3, 3), places along those of the pose; `length_m` is (N,).
        Third are the torques (B, N, 2N) of unit moments about the segments' axes.
        """
        count = self.segment_count
        along = frames.axes[:, :, 0]
        crossed = (force_axes.reshape(-1, 3) @ self.cross).reshape(-1, 3 * count, 3, 3)
        turned = crossed.flatten(1, 2) @ frames.joint_axes.transpose(1, 2)
        turned = turned.reshape(-1, count, 3, 3, 2 * count)
        pieces = length_m[:, None] * along
        centres = (self.between @ pieces[:, None]).transpose(2, 3)
        at_joint = (turned * centres[:, :, None]).sum(3)
        slope = (turned * along[:, :, None, :, None]).sum(3) * self.beyond[:, None]
        torsion = (along @ frames.joint_axes.transpose(1, 2)) * self.beyond
        return at_joint, slope, torsion

    def weight_levers(self, frames: SegmentFrames) -> Tensor:
        """(B, 3, N, 2N) torques per gravity component and first moment of mass on each axis."""
        along = frames.axes[:, :, 0]
        count = self.segment_count
        crossed = (along @ self.cross).reshape(-1, count, 3, 3)
        turned = -(crossed.flatten(1, 2) @ frames.joint_axes.transpose(1, 2))
        turned = turned.reshape(-1, count, 3, 2 * count) * self.beyond[:, None]
        return turned.transpose(1, 2)
