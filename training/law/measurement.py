"""The measurement model of an uncertain arm, linear about the state that a reading shows.

The arm holds cable lengths h(c + z) at commanded angles c with joint zeros z. Cable i with the
stretch s_i = l_i(q) - h_i + T0_i / k_i has the tension T_i = max(0, s_i / κ_i) at its actuator and
ρ_in T_i across joint n, where ρ = exp(u μ Φ) is what friction makes of it (u the slide, Φ the wrap
angle up to there) and κ the compliance that the pieces have with these tensions. At rest

    Σ_in (ρ_in ∂l_in/∂q) T_i = τ_weight(q) + τ,      y_i = (1 + g_i) T_i + b_i + noise

with τ the torques of contacts (with several guides u Φ is the sum over those up to joint n). A reading y gives a pose q by Gauss-Newton on the stretches. There
the model's own tensions T(q), with the torques τ(q) that they balance, are one exact state, and
everything else is linear about it:

    δT = D δτ + [(I - D J') A - D B] δθ,      D = K J H⁻¹,      H = J K J' + geometry,

A and B being the derivatives of T and of the left side by the parameters θ at a fixed pose. The
innovation y - y(q) then has the covariance S = R + G Σ G', and S says all that readings tell of
torques, of faults and of the parameters (Schmidt, Application of State-Space Methods to
Navigation Problems, 1966: parameters that are considered, not estimated).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.tolerances import ArmParameters
from cablesense_training.law.geometry import (
    CableGeometry,
    Holes,
    SegmentFrames,
    SegmentGeometry,
    Spans,
    constant,
)

_SLACK_WEIGHT = 1e-5
"""Weight of a slack cable's length in the fit of the pose, over that of a taut one. It holds the
pose where few are taut."""
_TAUT_ABOVE_STD = 4.0
"""A reading above this many deviations of the sensor shows a taut cable."""
_POSE_STEPS = 3
"""Gauss-Newton steps from the command to the pose; each about squares its error."""


class Measurement(NamedTuple):
    """What B readings say, linear about their states; P parameters.

    Attributes:
        innovation_n: (B, M) reading minus that of the untouched arm with the mean parameters.
        information_n2: (B, M, M) inverse covariance S⁻¹ of innovations.
        by_torque: (B, M, 2N) derivative D of readings by contact torques, N/(N·m).
        by_parameter: (B, M, P) derivative G of readings by parameters.
        torque_precision: (B, 2N, 2N) D' S⁻¹ D.
        torque_pull: (B, 2N) D' S⁻¹ times the innovation.
        at_joint_m: (B, N, 3, 2N) torques of unit forces at the joint centres, along the axes that
            the segments have at the command.
        by_place: (B, N, 3, 2N) their derivative by the distance from the joint centre.
        by_torsion: (B, N, 2N) torques of unit moments about the segments' axes.
        pose_rad: (B, 2N) joint angles by the reading.
    """

    innovation_n: Tensor
    information_n2: Tensor
    by_torque: Tensor
    by_parameter: Tensor
    torque_precision: Tensor
    torque_pull: Tensor
    at_joint_m: Tensor
    by_place: Tensor
    by_torsion: Tensor
    pose_rad: Tensor


class Parameters(NamedTuple):
    """The mean parameters by kind, as the measurement takes them."""

    compliance_m_n: Tensor  # (M,)
    pretension_n: Tensor  # (M,)
    holes: Holes
    slide: Tensor  # (N + 1, M)
    gain: Tensor  # (M,) one and the deviation
    zero_n: Tensor  # (M,)
    mass_kg: Tensor  # (N,)
    centre_m: Tensor  # (N,)
    length_m: Tensor  # (N,)
    gravity_m_s2: Tensor  # (3,)
    joint_zero_rad: Tensor  # (2N,)
    friction: Tensor  # (1,)


class FrictionWraps(NamedTuple):
    """Where a cable turns with the arm straight: at the actuator, and between two joints, rad."""

    pulley_rad: float
    guide_rad: float


class MeasurementModel(nn.Module):
    """`Measurement` of readings (B, M) at commands (B, 2N), mean (P,) and covariance (P, P).

    Args:
        mechanism: the arm as its file describes it, with effects on its body.
        held_by: the arm by which its actuators are commanded: as drawn.
        parameters: its uncertain parameters.
        reading_variance_n2: of one reading: noise and step of the sensor, N².
        wraps: of the cables with the arm straight.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held_by: Mechanism,
        parameters: ArmParameters,
        reading_variance_n2: float,
        wraps: FrictionWraps,
    ) -> None:
        super().__init__()
        count = mechanism.segment_count
        self.segment_count = count
        self.cable_count = mechanism.cable_count
        self.sizes = _sizes(parameters)
        self.cables = CableGeometry(mechanism)
        self.held_cables = CableGeometry(held_by)
        self.segments = SegmentGeometry(mechanism)
        self.reading_variance_n2 = reading_variance_n2
        self.taut_above_n = _TAUT_ABOVE_STD * reading_variance_n2**0.5
        self.compliance_m_n = constant(1.0 / mechanism.stiffness_n_m)
        self.pretension_n = constant(mechanism.pretension_n)
        self.mass_kg = constant(mechanism.mass_kg)
        self.centre_m = constant(mechanism.centre_of_mass_m)
        self.length_m = constant(mechanism.segment_length_m)
        self.gravity_m_s2 = constant(mechanism.gravity_m_s2)
        gravity = mechanism.gravity_m_s2
        by_tilt = [np.cross([0.0, 1.0, 0.0], gravity), np.cross([1.0, 0.0, 0.0], gravity)]
        self.gravity_by_tilt = constant(np.array(by_tilt))
        self.carried = constant(np.triu(np.ones((count, count)), 1))
        self.pulley_rad = constant(np.full((1, mechanism.cable_count), wraps.pulley_rad))
        between = np.full((count, 1), wraps.guide_rad)
        between[0] = 0.0
        self.guide_rad = constant(between * mechanism.passes_joint.T)
        until = np.tril(np.ones((count, count + 1)), 1)
        self.guides_until = constant(until)
        self.reaches = constant(until[:, None, :, None])
        run, spans = _compliance_shares(mechanism)
        self.run_share = constant(run)
        self.span_share = constant(spans)
        self.cable_identity = constant(np.eye(mechanism.cable_count))
        self.same_joint = constant(_same_joint(count))
        self.mass_sensitivity = constant(_first_moment_slopes(mechanism))

    def forward(
        self,
        reading_n: Tensor,
        command_rad: Tensor,
        mean: Tensor,
        covariance: Tensor,
        unrest_n2_m2: Tensor,
    ) -> Measurement:
        """The measurement; `unrest_n2_m2` (2N, 2N) is the covariance of torques by motion."""
        given = self.parameters_of(mean)
        commanded = self.held_cables.rotations(command_rad + given.joint_zero_rad)
        nominal = self.held_cables.nominal_holes()
        held, held_slope = self.held_cables.lengths_and_slopes(commanded, nominal)
        held = held - self.held_cables.straight_m(nominal)
        held = held + self.cables.straight_m(given.holes)
        unstretched = held - given.pretension_n * given.compliance_m_n

        tension = (reading_n - given.zero_n) / given.gain
        taut = (tension > self.taut_above_n).to(tension.dtype)
        angles, at_pose = self._pose(
            command_rad + given.joint_zero_rad, tension * taut, taut, unstretched, given
        )

        spans = self.cables(at_pose, given.holes)
        carried, compliance, wrap_rad = self._friction(spans, given)
        stretch = (spans.length_m - unstretched) / compliance
        pulls = (stretch > 0.0).to(stretch.dtype)
        tension_n = stretch * pulls
        jacobian = (spans.slope_m * carried[:, :, None]).flatten(1, 2)
        frames = self.segments.frames(at_pose)
        weight, weight_levers, moments = self._weight(frames, given)
        torque = (jacobian @ tension_n[..., None])[..., 0] - weight

        stiffness = pulls / compliance
        geometric = (spans.curve_m * (carried * tension_n[:, None])[:, :, None]).sum(3)
        hessian = (jacobian * stiffness[:, None]) @ spans.jacobian_t_m.transpose(1, 2)
        hessian = hessian + (geometric.flatten(1) @ self.same_joint).reshape(hessian.shape)
        by_torque = stiffness[..., None] * (spans.jacobian_t_m.transpose(1, 2) @ inverse(hessian))

        by_parameter = self._by_parameter(
            given,
            spans,
            carried,
            wrap_rad,
            held_slope,
            tension_n,
            stiffness,
            by_torque,
            jacobian,
            weight_levers,
            moments,
        )
        by_torque = given.gain[:, None] * by_torque
        variance = self.reading_variance_n2 * self.cable_identity
        spread = variance + (by_parameter @ covariance) @ by_parameter.transpose(1, 2)
        spread = spread + (by_torque @ unrest_n2_m2) @ by_torque.transpose(1, 2)
        information = inverse(spread)
        expected_n = given.gain * tension_n + given.zero_n
        innovation = reading_n - expected_n + (by_torque @ torque[..., None])[..., 0]
        weighted = information @ by_torque
        command_frames = self.segments.frames(self.cables.rotations(command_rad))
        levers = self.segments.levers(frames, command_frames.axes, given.length_m)
        return Measurement(
            innovation,
            information,
            by_torque,
            by_parameter,
            by_torque.transpose(1, 2) @ weighted,
            (innovation[:, None] @ weighted)[:, 0],
            *levers,
            angles,
        )

    def parameters_of(self, mean: Tensor) -> Parameters:
        """The parameters of a mean θ (P,)."""
        count = self.segment_count
        parts = list(mean.split(self.sizes))
        stiffness, pretension = parts[:2]
        outward, around, slide, gain, zero, mass, centre, length, tilt, joint_zero, friction = (
            parts[2:]
        )
        plates = (count + 1, self.cable_count)
        return Parameters(
            compliance_m_n=self.compliance_m_n * torch.exp(-stiffness),
            pretension_n=self.pretension_n + pretension,
            holes=self.cables.holes(outward.reshape(plates), around.reshape(plates)),
            slide=slide.reshape(plates),
            gain=1.0 + gain,
            zero_n=zero,
            mass_kg=self.mass_kg * (1.0 + mass),
            centre_m=self.centre_m + centre,
            length_m=self.length_m + length,
            gravity_m_s2=self.gravity_m_s2 + tilt @ self.gravity_by_tilt,
            joint_zero_rad=joint_zero,
            friction=friction,
        )

    def _pose(
        self,
        start_rad: Tensor,
        tension_n: Tensor,
        taut: Tensor,
        unstretched_m: Tensor,
        given: Parameters,
    ) -> tuple[Tensor, Tensor]:
        """Angles (B, 2N) at which taut cables have the lengths of their tensions, and rotations.

        The Jacobian is that of the start: each step is a part of the first, a few hundredths.
        """
        turns = self.cables.rotations(start_rad)
        length, slope = self.cables.lengths_and_slopes(turns, given.holes)
        wanted = unstretched_m + tension_n * given.compliance_m_n
        weight = taut * (1.0 - _SLACK_WEIGHT) + _SLACK_WEIGHT
        weighted = slope * weight[:, None]
        solve = inverse(weighted @ slope.transpose(1, 2)) @ weighted
        angles = start_rad
        for step in range(_POSE_STEPS):
            missing = wanted - length
            # a slack cable may hang as loosely as the pose leaves it
            missing = taut * missing + (1.0 - taut) * missing.clamp(max=0.0)
            angles = angles + (solve @ missing[..., None])[..., 0]
            turns = self.cables.rotations(angles)
            if step + 1 < _POSE_STEPS:
                length = self.cables.lengths(turns, given.holes)
        return angles, turns

    def _friction(self, spans: Spans, given: Parameters) -> tuple[Tensor, Tensor, Tensor]:
        """Ratios ρ (B, N, M) of tensions, compliances κ (B, M), and wraps (B, N + 1, M), rad."""
        bends = spans.bend_rad + self.guide_rad
        wrap_rad = torch.cat([self.pulley_rad + 0.0 * bends[:, :1], bends], dim=1)
        carried = torch.exp(self.guides_until @ (given.friction * given.slide * wrap_rad))
        share = self.run_share + (self.span_share * carried).sum(1)
        return carried, given.compliance_m_n * share, wrap_rad

    def _weight(self, frames: SegmentFrames, given: Parameters) -> tuple[Tensor, Tensor, Tensor]:
        """Torques of the weight (B, 2N), their levers (B, 3, N, 2N), and first moments (N,)."""
        beyond = self.carried @ given.mass_kg
        moments = given.mass_kg * given.centre_m + given.length_m * beyond
        levers = self.segments.weight_levers(frames)
        by_moment = (levers * given.gravity_m_s2[:, None, None]).sum(1)
        return (by_moment * moments[:, None]).sum(1), levers, moments

    def _by_parameter(
        self,
        given: Parameters,
        spans: Spans,
        carried: Tensor,
        wrap_rad: Tensor,
        held_slope: Tensor,
        tension_n: Tensor,
        stiffness: Tensor,
        by_torque: Tensor,
        jacobian: Tensor,
        weight_levers: Tensor,
        moments: Tensor,
    ) -> Tensor:
        """G (B, M, P): derivative of readings by parameters at fixed contact torques."""
        count = self.segment_count
        cables = self.cable_count
        joints = 2 * count

        # parameters of one cable: its own tension at a fixed pose (A), and torques (B)
        pulls = (tension_n > 0.0).to(tension_n.dtype)
        by_stiffness = tension_n - given.pretension_n * pulls
        straight = self._straight_by_hole(given.holes)
        by_hole = stiffness[:, None, None] * (spans.by_hole - straight)
        by_slide = given.friction * wrap_rad
        # a guide acts on the spans behind it
        behind = self.guides_until.T @ (self.span_share * carried)
        given_way = (tension_n * stiffness * given.compliance_m_n)[:, None]
        by_own_slide = -given_way * behind * by_slide
        own = torch.cat(
            [by_stiffness[:, None], pulls[:, None], by_hole.flatten(1, 2), by_own_slide], dim=1
        )
        across_n = (carried * tension_n[:, None])[:, :, None]
        rubbed = (spans.slope_m * across_n)[:, :, :, None] * self.reaches * by_slide[:, None, None]
        rubbed = rubbed.reshape(-1, joints, (count + 1) * cables)
        turned = spans.slope_by_hole.reshape(-1, count, 2, 2 * (count + 1), cables)
        turned = (turned * across_n[:, :, None]).reshape(-1, joints, 2 * (count + 1) * cables)
        nothing = 0.0 * jacobian
        own_torque = torch.cat([nothing, nothing, turned, rubbed], dim=2)
        freed = self.cable_identity - by_torque @ jacobian
        of_cables = (freed[:, :, None] * own[:, None]).flatten(2) - by_torque @ own_torque

        of_sensors = torch.cat(
            [self.cable_identity * tension_n[:, None], self.cable_identity + 0.0 * freed], dim=2
        )

        # what moves no cable at a fixed pose: masses, centres, lengths, the tilt
        by_moment = (weight_levers * given.gravity_m_s2[:, None, None]).sum(1)
        of_segments = (by_torque @ by_moment.transpose(1, 2)) @ self.mass_sensitivity
        by_gravity = (weight_levers * moments[:, None]).sum(2)
        of_tilt = by_torque @ (self.gravity_by_tilt @ by_gravity).transpose(1, 2)

        of_zeros = -freed @ (stiffness[..., None] * held_slope.transpose(1, 2))

        slid = self.guides_until @ (given.slide * wrap_rad)
        friction_own = -given_way[:, 0] * (self.span_share * carried * slid).sum(1)
        friction_torque = (spans.slope_m * (across_n * slid[:, :, None])).flatten(1, 2).sum(2)
        of_friction = freed @ friction_own[..., None] - by_torque @ friction_torque[..., None]

        gained = given.gain[:, None]
        return torch.cat(
            [
                gained * of_cables,
                of_sensors,
                gained * of_segments,
                gained * of_tilt,
                gained * of_zeros,
                gained * of_friction,
            ],
            dim=2,
        )

    def _straight_by_hole(self, holes: Holes) -> Tensor:
        """(2, N + 1, M) derivative of the straight arm's lengths by the holes."""
        apart = holes.after_m - holes.before_m
        across = apart[:, 1:] * (self.cables.passes / torch.sqrt((apart * apart).sum(1)))[:, None]
        none = 0.0 * across[:1]
        pulled = torch.cat([none, across]) - torch.cat([across, none])
        outward = (pulled * self.cables.outward).sum(1)
        around = (pulled * self.cables.around).sum(1)
        return torch.stack([outward, around])


def _sizes(parameters: ArmParameters) -> list[int]:
    """Numbers of parameters of each kind, the holes of all plates together."""
    at = parameters.slices
    sizes = {}
    for name, part in at.items():
        kind = name.rstrip("0123456789")
        sizes[kind] = sizes.get(kind, 0) + part.stop - part.start
    return list(sizes.values())


def _same_joint(count: int) -> np.ndarray:
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


def _compliance_shares(mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Shares of a cable's compliance: (M,) before its first guide, and (N, M) from each joint on."""
    pieces = mechanism.piece_length_m
    whole = pieces.sum(1)
    count = mechanism.segment_count
    behind = np.zeros((count, mechanism.cable_count))
    for n in range(count):
        behind[n] = pieces[:, 1 + 2 * n]
        if n + 1 < count:
            behind[n] += pieces[:, 2 + 2 * n]
    return pieces[:, 0] / whole, behind / whole


def _first_moment_slopes(mechanism: Mechanism) -> np.ndarray:
    """(N, 3N): first moments of mass by shares of masses, centres and lengths."""
    count = mechanism.segment_count
    mass = mechanism.mass_kg
    beyond = np.triu(np.ones((count, count)), 1)
    by_mass = np.diag(mass * mechanism.centre_of_mass_m)
    by_mass = by_mass + mechanism.segment_length_m[:, None] * beyond * mass
    by_centre = np.diag(mass)
    by_length = np.diag(beyond @ mass)
    return np.concatenate([by_mass, by_centre, by_length], axis=1)


def inverse(matrix: Tensor) -> Tensor:
    """Inverse of square matrices (..., k, k), in PyTorch and in an exported graph."""
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        return torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
    return torch.linalg.inv(matrix)
