"""The measurement model of an uncertain arm, linear about the state that a reading shows.

The arm holds cable lengths h(c + z) at commanded angles c with joint zeros z. Cable i with the
stretch s_i = l_i(q) - h_i + T0_i / k_i has the tension T_i = max(0, s_i / κ_i) at its actuator and
ρ_in T_i across joint n, where ρ = exp(ε Φ) is what friction makes of it (ε the carried friction, Φ
the wrap angle up to there) and κ the compliance that the pieces have with these tensions. At rest

    Σ_in (ρ_in ∂l_in/∂q) T_i = τ_weight(q) + τ,      y_i = (1 + g_i) T_i + b_i + noise

with τ the torques of contacts; with several guides, ε Φ is the sum over those up to joint n. A
reading y gives a pose q by Gauss-Newton on the stretches. There
the model's own tensions T(q), with the torques τ(q) that they balance, are one exact state, and
everything else is linear about it:

    δT = D δτ + [A - D (J A + B)] δθ,      D = K J' H⁻¹,      H = J K J' + geometry - weight,

A and B being the derivatives of T and of the left side by the parameters θ at a fixed pose, and
the last two terms of H those of J T and of the weight's torques by the pose. The
innovation y - y(q) then has the covariance S = R + G Σ G', and S says all that readings tell of
torques, of faults and of the parameters (Schmidt, Application of State-Space Methods to
Navigation Problems, 1966: parameters that are considered, not estimated).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.friction import GuideFriction
from cablesense_training.law.geometry import (
    CableGeometry,
    Matrix,
    SegmentFrames,
    SegmentGeometry,
    constant,
)
from cablesense_training.law.parameter_slopes import ParameterSlopes, State
from cablesense_training.law.parameters import ArmNumbers, Parameters
from cablesense_training.law.weight import SegmentWeight

_SLACK_WEIGHT = 1e-5
"""Weight of a slack cable's length in the fit of the pose, over that of a taut one. It holds the
pose where few are taut."""
_TAUT_ABOVE_STD = 4.0
"""A reading above this many deviations of the sensor shows a taut cable."""
POSE_STEPS = 3
"""Gauss-Newton steps from the command to the pose; each leaves a few hundredths of its error."""
_FAR_M = 1e9
"""Upper limit of a change of length that limits no taut cable: longer than any arm."""


class Measurement(NamedTuple):
    """What B readings say, linear about their states; P parameters.

    Attributes:
        reading_n: (B, 1, M).
        innovation_n: (B, 1, M) reading minus that of the untouched arm with the mean parameters.
        information_n2: (B, M, M) inverse covariance S⁻¹ of innovations.
        by_torque: (B, M, 2N) derivative D of readings by contact torques, N/(N·m).
        by_parameter: (B, M, P) derivative G of readings by parameters.
        informed: (B, M, 2N) S⁻¹ D.
        torque_precision: (B, 2N, 2N) D' S⁻¹ D.
        torque_pull: (B, 1, 2N) D' S⁻¹ times the innovation.
        levers: (B, N, 6, 2N) torques of unit forces at the joint centres, along the axes that the
            segments have at the command, and their derivatives by the distance from the centre.
        by_torsion: (B, N, 1, 2N) torques of unit moments about the segments' axes.
        pose_rad: (B, 1, 2N) joint angles by the reading.
    """

    reading_n: Tensor
    innovation_n: Tensor
    information_n2: Tensor
    by_torque: Tensor
    by_parameter: Tensor
    informed: Tensor
    torque_precision: Tensor
    torque_pull: Tensor
    levers: Tensor
    by_torsion: Tensor
    pose_rad: Tensor


class PoseFit(nn.Module):
    """Angles (B, 1, 2N) at which taut cables have the lengths of their tensions.

    Args:
        cables: the geometry of the arm.
        steps: Gauss-Newton steps.
    """

    def __init__(self, cables: CableGeometry, steps: int) -> None:
        super().__init__()
        self.cables = cables
        self.steps = steps
        self.zero = constant(np.array(0.0))
        self.one = constant(np.array(1.0))
        self.slack_weight = constant(np.array(_SLACK_WEIGHT))
        self.far_m = constant(np.array(_FAR_M))

    def forward(
        self,
        start_rad: Tensor,
        start: Tensor,
        tension_n: Tensor,
        taut_above_n: Tensor,
        unstretched_m: Tensor,
        given: Parameters,
    ) -> Tensor:
        """The angles, from `start_rad` (B, 1, 2N) on, where the geometry's terms are `start`.

        Above `taut_above_n` (M,) cables are taut for certain. The Jacobian is that of the start:
        each step is a part of the first, a few hundredths.
        """
        taut = tension_n > taut_above_n
        wanted = unstretched_m + torch.where(taut, tension_n, self.zero) * given.compliance_m_n
        # a slack cable may hang as loosely as the pose leaves it
        loose = torch.where(taut, self.far_m, self.zero)
        weight = torch.where(taut, self.one, self.slack_weight)
        length, slope = self.cables.lengths_and_slopes(start, given.holes.squares)
        weighted = slope * weight
        solve = weighted.transpose(1, 2) @ inverse(weighted @ slope.transpose(1, 2))
        angles = start_rad
        for step in range(self.steps):
            if step:
                length = self.cables.lengths(self.cables.terms(angles), given.holes.squares)
            angles = angles + torch.minimum(wanted - length, loose) @ solve
        return angles


class MeasurementModel(nn.Module):
    """`Measurement` of readings (B, M) at commands (B, 2N), mean (P,) and covariance (P, P).

    Args:
        mechanism: the arm as its file describes it, with effects on its body.
        held_by: the arm by which its actuators are commanded: as drawn.
        parameters: its uncertain parameters.
        reading_variance_n2: of one reading: noise and step of the sensor, N².
        friction: where the cables rub.
        pose_steps: Gauss-Newton steps from the command to the pose.
        unexplained_n2: (M, M) covariance of readings by what is not known of the arm, N²; none by
            default. Which cables are taut is seen by the sensors' own noise.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held_by: Mechanism,
        parameters: ArmParameters,
        reading_variance_n2: float,
        friction: CableFriction,
        pose_steps: int = POSE_STEPS,
        unexplained_n2: Array | None = None,
    ) -> None:
        super().__init__()
        self.segment_count = mechanism.segment_count
        self.cables = CableGeometry(mechanism)
        self.segments = SegmentGeometry(mechanism)
        self.numbers = ArmNumbers(mechanism, parameters, friction, self.cables)
        self.friction = GuideFriction(mechanism, friction)
        self.weight = SegmentWeight(mechanism)
        self.slopes = ParameterSlopes(mechanism.segment_count, mechanism.cable_count, parameters)
        self.zeros = parameters.slices["sensor_zero"]
        self.sensor_variance_n2 = reading_variance_n2
        self.pose = PoseFit(self.cables, pose_steps)

        springs_n_m_rad = np.repeat(mechanism.joint_stiffness_n_m_rad, 2)
        self.spring_n_m_rad = constant(springs_n_m_rad)
        self.springs = constant(np.diag(springs_n_m_rad))
        self.same_joint = constant(_same_joint(mechanism.segment_count))
        held = CableGeometry(held_by)
        self.held_squares_m2 = constant(held.nominal_holes().numpy())
        straight = held.lengths(held.straight_terms, self.held_squares_m2)
        self.held_straight_m = constant(straight.numpy())
        self.cable_identity = constant(np.eye(mechanism.cable_count))
        reading_covariance_n2 = reading_variance_n2 * np.eye(mechanism.cable_count)
        if unexplained_n2 is not None:
            reading_covariance_n2 += unexplained_n2
        self.reading_covariance_n2 = constant(reading_covariance_n2)

    def forward(
        self,
        reading_n: Tensor,
        command_rad: Tensor,
        mean: Tensor,
        covariance: Tensor,
        unrest_n2_m2: Tensor,
    ) -> Measurement:
        """The measurement; `unrest_n2_m2` (2N, 2N) is the covariance of torques by motion."""
        given = self.numbers(mean)
        reading = reading_n[:, None]
        state = self._state(reading, command_rad, given, self._taut_above_n(covariance))
        by_torque = self._by_torque(state, given)
        by_parameter = self.slopes(given, state, by_torque)
        spread = by_parameter @ covariance @ by_parameter.transpose(1, 2)
        spread = spread + self.reading_covariance_n2
        spread = spread + by_torque @ unrest_n2_m2 @ by_torque.transpose(1, 2)
        information = inverse(spread)
        innovation = self._innovation(reading, state, given, by_torque)
        informed = information @ by_torque
        return Measurement(
            reading_n=reading,
            innovation_n=innovation,
            information_n2=information,
            by_torque=by_torque,
            by_parameter=by_parameter,
            informed=informed,
            torque_precision=by_torque.transpose(1, 2) @ informed,
            torque_pull=innovation @ informed,
            levers=self.segments.levers(state.frames, given.length_m),
            by_torsion=self.segments.torsion(state.frames),
            pose_rad=state.pose_rad,
        )

    def _taut_above_n(self, covariance: Tensor) -> Tensor:
        """(M,) tensions above which cables are taut for certain, as well as zeros are known."""
        of_zeros = covariance[self.zeros, self.zeros] * self.cable_identity
        return _TAUT_ABOVE_STD * torch.sqrt(self.sensor_variance_n2 + of_zeros.sum(0))

    def _state(
        self, reading: Tensor, command_rad: Tensor, given: Parameters, taut_above_n: Tensor
    ) -> State:
        """The state that readings (B, 1, M) show at commands (B, 2N)."""
        start_rad = (command_rad + given.joint_zero_rad)[:, None]
        start = self.cables.terms(start_rad)
        held, held_slope = self.cables.lengths_and_slopes(start, self.held_squares_m2)
        straight, straight_by_hole = self.cables.straight(given.holes)
        given_m = given.pretension_n * given.compliance_m_n
        unstretched = held + (straight - self.held_straight_m - given_m)

        read_n = (reading - given.zero_n) / given.gain
        angles = self.pose(start_rad, start, read_n, taut_above_n, unstretched, given)
        at_pose = self.cables.terms(angles)
        spans = self.cables(at_pose, given.holes)
        carried = self.friction(spans, given)
        stretch = (spans.length_m - unstretched) / carried.compliance_m_n
        pulls = (stretch > 0.0).to(stretch.dtype)
        tension_n = stretch * pulls
        ratio = carried.ratio[:, :, None]
        frames = self._frames(at_pose, command_rad)
        return State(
            pose_rad=angles,
            spans=spans,
            straight_by_hole=straight_by_hole,
            held_slope_m=held_slope,
            carried=carried,
            tension_n=tension_n,
            stiffness_n_m=pulls / carried.compliance_m_n,
            across_n=ratio * tension_n[:, None],
            jacobian_m=(spans.slope_m * ratio).flatten(1, 2),
            frames=frames,
            weighed=self.weight(frames, given),
        )

    def _by_torque(self, state: State, given: Parameters) -> Tensor:
        """D (B, M, 2N): derivative of readings by contact torques, as the pose follows them."""
        slope_m = state.spans.slope_m
        stiffened = slope_m.flatten(1, 2) * state.stiffness_n_m
        geometric = (state.across_n @ state.spans.curve_m.transpose(2, 3)).flatten(1)
        geometric = (geometric @ self.same_joint).reshape(-1, *self.springs.shape)
        hessian = state.jacobian_m @ stiffened.transpose(1, 2) + geometric - state.weighed.by_pose
        by_torque = stiffened.transpose(1, 2) @ inverse(hessian + self.springs)
        return by_torque * given.gain[:, None]

    def _innovation(
        self, reading: Tensor, state: State, given: Parameters, by_torque: Tensor
    ) -> Tensor:
        """(B, 1, M) readings minus those of the untouched arm with the mean parameters."""
        torque = state.tension_n @ state.jacobian_m.transpose(1, 2) - state.weighed.torque
        torque = torque + self.spring_n_m_rad * state.pose_rad
        expected = given.gain * state.tension_n + given.zero_n
        return reading - expected + torque @ by_torque.transpose(1, 2)

    def _frames(self, at_pose: Tensor, command_rad: Tensor) -> SegmentFrames:
        """Frames of the segments, at the pose and at the command."""
        at_command = self.cables.terms(command_rad[:, None])
        turns = torch.cat([at_pose, at_command], dim=2) @ self.cables.rotation_terms
        return self.segments.frames(turns.reshape(-1, self.segment_count, 2, 3, 3))


def _same_joint(count: int) -> Matrix:
    """(3N, 4N²) that puts second derivatives of the joints' spans into a matrix (2N, 2N)."""
    placed = np.zeros((count, 3, 2 * count, 2 * count))
    for n in range(count):
        pitch = 2 * n
        yaw = pitch + 1
        placed[n, 0, pitch, pitch] = 1.0
        placed[n, 1, pitch, yaw] = 1.0
        placed[n, 1, yaw, pitch] = 1.0
        placed[n, 2, yaw, yaw] = 1.0
    return placed.reshape(3 * count, -1)


def inverse(matrix: Tensor) -> Tensor:
    """Inverse of square matrices (..., k, k), in PyTorch and in an exported graph."""
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        return torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
    return torch.linalg.inv(matrix)
