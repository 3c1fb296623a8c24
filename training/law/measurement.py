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

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.parameter_groups import CARRIED_FRICTION
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.geometry import (
    LEVI_CIVITA,
    CableGeometry,
    Holes,
    Matrix,
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


class Weighed(NamedTuple):
    """The weight of the segments.

    Attributes:
        torque: (B, 1, 2N) on the joints.
        by_pose: (B, 2N, 2N) its derivative by the joint angles.
        by_parameter: (B, 2N, 5N + 2) by the numbers of the bodies and the tilt.
    """

    torque: Tensor
    by_pose: Tensor
    by_parameter: Tensor


class CarriedTensions(NamedTuple):
    """What friction makes of the tensions at the actuators.

    Attributes:
        ratio: (B, N, M) ρ of the tension across a joint.
        compliance_m_n: (B, 1, M) κ, stretch of a cable by that tension.
        wrap_rad: (B, N + 1, M) at the guides.
        by_exponent: (B, N + 1, M) derivative of κ / κ_0 by the exponents ε Φ.
        by_run: (B, 1, M) the same by the logarithm of `run_compliance`.
    """

    ratio: Tensor
    compliance_m_n: Tensor
    wrap_rad: Tensor
    by_exponent: Tensor
    by_run: Tensor


class Parameters(NamedTuple):
    """The mean parameters by kind, as the measurement takes them."""

    compliance_m_n: Tensor  # (M,)
    pretension_n: Tensor  # (M,)
    run_share: Tensor  # (M,) of the compliance, before the pulley
    holes: Holes
    carried_friction: Tensor  # (N + 1, M)
    gain: Tensor  # (M,) one and the deviation
    zero_n: Tensor  # (M,)
    bodies: Tensor  # (5N,) of segments: mass, centre, length; centres along y and along z
    length_m: Tensor  # (N,)
    gravity_m_s2: Tensor  # (1, 3)
    joint_zero_rad: Tensor  # (2N,)


class MeasurementModel(nn.Module):
    """`Measurement` of readings (B, M) at commands (B, 2N), mean (P,) and covariance (P, P).

    Args:
        mechanism: the arm as its file describes it, with effects on its body.
        held_by: the arm by which its actuators are commanded: as drawn.
        parameters: its uncertain parameters.
        reading_variance_n2: of one reading: noise and step of the sensor, N².
        friction: where the cables rub.
        pose_steps: Gauss-Newton steps from the command to the pose.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held_by: Mechanism,
        parameters: ArmParameters,
        reading_variance_n2: float,
        friction: CableFriction,
        pose_steps: int = POSE_STEPS,
    ) -> None:
        super().__init__()
        count = mechanism.segment_count
        self.segment_count = count
        self.cable_count = mechanism.cable_count
        cables = mechanism.cable_count
        self.pose_steps = pose_steps
        self.sizes = _sizes(parameters)
        self.cables = CableGeometry(mechanism)
        self.segments = SegmentGeometry(mechanism)
        nominal, scale = _nominal(mechanism, parameters, self.cables.radius_m)
        self.nominal = constant(nominal)
        self.scale = constant(scale)
        zero_n = float(parameters.prior_std[parameters.slices["sensor_zero"]].max())
        self.taut_above_n = _TAUT_ABOVE_STD * math.hypot(reading_variance_n2**0.5, zero_n)
        self.compliance_m_n = constant(1.0 / mechanism.stiffness_n_m)
        self.gravity_m_s2 = constant(mechanism.gravity_m_s2[None])
        gravity = mechanism.gravity_m_s2
        by_tilt = [np.cross([0.0, 1.0, 0.0], gravity), np.cross([1.0, 0.0, 0.0], gravity)]
        self.gravity_by_tilt = constant(np.array(by_tilt))
        self.cross = constant(LEVI_CIVITA.reshape(3, 9))
        self.is_length = constant((np.arange(5 * count) >= count).astype(float))
        self.moment_slopes = constant(_first_moment_slopes(mechanism))
        self.spring_n_m_rad = constant(np.repeat(mechanism.joint_stiffness_n_m_rad, 2))
        self.springs = constant(np.diag(np.repeat(mechanism.joint_stiffness_n_m_rad, 2)))
        self.until = constant(np.triu(np.ones((2 * count, 2 * count))))
        self.after = constant(np.tril(np.ones((2 * count, 2 * count)), -1))

        held = CableGeometry(held_by)
        self.held_squares_m2 = constant(held.nominal_holes().numpy())
        straight = held.lengths(held.straight_terms, self.held_squares_m2)
        self.held_straight_m = constant(straight.numpy())

        # a cable's guides: at the actuator, and in the plates 0 to N - 1
        wrap_rad = np.full((count + 1, cables), friction.guide_wrap_rad)
        wrap_rad[0] = friction.pulley_wrap_rad
        wrap_rad[1] = 0.0
        wrap_rad[1:] *= mechanism.passes_joint.T
        self.wrap_rad = constant(wrap_rad)
        self.plate_of_guide = constant(np.eye(count + 1, k=-1))
        until = np.tril(np.ones((count, count + 1)), 1)
        self.reaches = constant(until[:, None, :, None])
        # of the compliance behind the pulley: the run up to the base, and from each joint on
        behind_pulley = _compliance_shares(mechanism)
        self.behind_pulley = constant(behind_pulley)
        self.pieces_behind = constant(np.concatenate([np.eye(1, count + 1), until]))
        self.run_log = constant(np.log(friction.run_compliance))

        self.reading_variance_n2 = reading_variance_n2
        self.cable_identity = constant(np.eye(cables))
        self.same_joint = constant(_same_joint(count))
        # a cable has a stiffness, a pretension, a compliance of its run, 2 (N + 1) numbers of
        # holes, and N + 1 carried frictions
        self.same_cable = constant(np.tile(np.eye(cables), 3 * count + 6))
        self.same_sensor = constant(np.tile(np.eye(cables), 2))
        self.plain_and_exponents = ((2 * count + 5) * cables, (count + 1) * cables)
        self.by_gain = constant(np.array([[1.0], [0.0]]))
        self.by_zero = constant(np.array([[0.0], [1.0]]))
        self.zero = constant(np.array(0.0))
        self.one = constant(np.array(1.0))
        self.nothing = constant(np.zeros((3, 1)))
        self.slack_weight = constant(np.array(_SLACK_WEIGHT))
        self.far_m = constant(np.array(_FAR_M))

    def forward(
        self,
        reading_n: Tensor,
        command_rad: Tensor,
        mean: Tensor,
        covariance: Tensor,
        unrest_n2_m2: Tensor,
    ) -> Measurement:
        """The measurement; `unrest_n2_m2` (2N, 2N) is the covariance of torques by motion."""
        parameters = self.parameters_of(mean)
        reading = reading_n[:, None]
        start_rad = (command_rad + parameters.joint_zero_rad)[:, None]
        start = self.cables.terms(start_rad)
        held, held_slope = self.cables.lengths_and_slopes(start, self.held_squares_m2)
        straight, straight_by_hole = self.cables.straight(parameters.holes)
        given_m = parameters.pretension_n * parameters.compliance_m_n
        unstretched = held + (straight - self.held_straight_m - given_m)

        tension = (reading - parameters.zero_n) / parameters.gain
        angles = self._pose(start_rad, start, tension, unstretched, parameters)
        at_pose = self.cables.terms(angles)
        spans = self.cables(at_pose, parameters.holes)
        carried = self._friction(spans, parameters)
        stretch = (spans.length_m - unstretched) / carried.compliance_m_n
        pulls = (stretch > 0.0).to(stretch.dtype)
        tension_n = stretch * pulls
        stiffness = pulls / carried.compliance_m_n

        # torques of one newton at each actuator, and of all that there is
        ratio = carried.ratio[:, :, None]
        across_n = ratio * tension_n[:, None]
        jacobian = (spans.slope_m * ratio).flatten(1, 2)
        frames = self._frames(at_pose, command_rad)
        weighed = self._weight(frames, parameters)
        torque = tension_n @ jacobian.transpose(1, 2) - weighed.torque
        torque = torque + self.spring_n_m_rad * angles

        # how tensions (B, 2N, M) and torques (B, 2N, 2N) follow the pose
        stiffened = spans.slope_m.flatten(1, 2) * stiffness
        geometric = (across_n @ spans.curve_m.transpose(2, 3)).flatten(1)
        geometric = (geometric @ self.same_joint).reshape(-1, *self.springs.shape)
        hessian = jacobian @ stiffened.transpose(1, 2) + geometric - weighed.by_pose
        by_torque = stiffened.transpose(1, 2) @ inverse(hessian + self.springs)
        by_torque = by_torque * parameters.gain[:, None]

        by_parameter = self._by_parameter(
            parameters,
            spans,
            straight_by_hole,
            carried,
            tension_n,
            stiffness,
            across_n,
            jacobian,
            held_slope,
            weighed,
            by_torque,
        )
        spread = by_parameter @ covariance @ by_parameter.transpose(1, 2)
        spread = spread + self.reading_variance_n2 * self.cable_identity
        spread = spread + by_torque @ unrest_n2_m2 @ by_torque.transpose(1, 2)
        information = inverse(spread)
        expected = parameters.gain * tension_n + parameters.zero_n
        innovation = reading - expected + torque @ by_torque.transpose(1, 2)
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
            levers=self.segments.levers(frames, parameters.length_m),
            by_torsion=self.segments.torsion(frames),
            pose_rad=angles,
        )

    def parameters_of(self, mean: Tensor) -> Parameters:
        """The parameters of a mean θ (P,)."""
        count = self.segment_count
        values = self.nominal + self.scale * mean
        parts = values.split(self.sizes)
        stiffness, pretension, run, holes, carried, gain, zero, bodies, tilt, joint_zero, _ = parts
        return Parameters(
            compliance_m_n=self.compliance_m_n / torch.exp(stiffness),
            pretension_n=pretension,
            run_share=torch.sigmoid(self.run_log + run),
            holes=self.cables.holes(holes.reshape(2, count + 1, self.cable_count)),
            carried_friction=carried.reshape(count + 1, self.cable_count),
            gain=gain,
            zero_n=zero,
            bodies=bodies,
            length_m=bodies[2 * count : 3 * count],
            gravity_m_s2=self.gravity_m_s2 + tilt @ self.gravity_by_tilt,
            joint_zero_rad=joint_zero,
        )

    def _pose(
        self,
        start_rad: Tensor,
        start: Tensor,
        tension_n: Tensor,
        unstretched_m: Tensor,
        given: Parameters,
    ) -> Tensor:
        """Angles (B, 1, 2N) at which taut cables have the lengths of their tensions.

        The Jacobian is that of the start: each step is a part of the first, a few hundredths.
        """
        taut = tension_n > self.taut_above_n
        wanted = unstretched_m + torch.where(taut, tension_n, self.zero) * given.compliance_m_n
        # a slack cable may hang as loosely as the pose leaves it
        loose = torch.where(taut, self.far_m, self.zero)
        weight = torch.where(taut, self.one, self.slack_weight)
        length, slope = self.cables.lengths_and_slopes(start, given.holes.squares)
        weighted = slope * weight
        solve = weighted.transpose(1, 2) @ inverse(weighted @ slope.transpose(1, 2))
        angles = start_rad
        for step in range(self.pose_steps):
            if step:
                length = self.cables.lengths(self.cables.terms(angles), given.holes.squares)
            angles = angles + torch.minimum(wanted - length, loose) @ solve
        return angles

    def _friction(self, spans: Spans, given: Parameters) -> CarriedTensions:
        """What friction makes of tensions.

        With the share r of a cable's compliance before the pulley, and the shares c of the pieces
        behind it, a tension T at the actuator stretches it by κ T, κ = κ_0 (r + (1 - r) Σ c ρ).
        """
        wrap_rad = self.plate_of_guide @ spans.bend_rad + self.wrap_rad
        carried = torch.exp(self.pieces_behind @ (given.carried_friction * wrap_rad))
        stretched = self.behind_pulley * carried
        behind = stretched.sum(1, keepdim=True)
        run = given.run_share
        return CarriedTensions(
            ratio=carried[:, 1:],
            compliance_m_n=given.compliance_m_n * (run + (1.0 - run) * behind),
            wrap_rad=wrap_rad,
            by_exponent=self.pieces_behind.T @ ((1.0 - run) * stretched),
            by_run=run * (1.0 - run) * (1.0 - behind),
        )

    def _frames(self, at_pose: Tensor, command_rad: Tensor) -> SegmentFrames:
        at_command = self.cables.terms(command_rad[:, None])
        turns = torch.cat([at_pose, at_command], dim=2) @ self.cables.rotation_terms
        return self.segments.frames(turns.reshape(-1, self.segment_count, 2, 3, 3))

    def _weight(self, frames: SegmentFrames, given: Parameters) -> Weighed:
        joints = 2 * self.segment_count
        slopes = (given.bodies @ self.moment_slopes).reshape(3 * self.segment_count, -1)
        # first moments of mass, which are linear in the centres and lengths
        moments = (slopes @ (given.bodies * self.is_length))[None]
        by_moment = (given.gravity_m_s2 @ frames.levers).flatten(2)
        by_gravity = (moments @ frames.levers.flatten(2)).reshape(-1, 3, joints)
        # joint k turns what joint j <= k carries: g · w_j x (w_k x r) = (g x w_j) · (w_k x r)
        turned = (given.gravity_m_s2 @ self.cross).reshape(3, 3) @ by_gravity
        turned = frames.joint_axes.transpose(1, 2) @ turned
        by_pose = turned * self.until + turned.transpose(1, 2) * self.after
        by_masses = by_moment.transpose(1, 2) @ slopes
        by_tilt = by_gravity.transpose(1, 2) @ self.gravity_by_tilt.T
        return Weighed(moments @ by_moment, by_pose, torch.cat([by_masses, by_tilt], dim=2))

    def _by_parameter(
        self,
        given: Parameters,
        spans: Spans,
        straight_by_hole: Tensor,
        carried: CarriedTensions,
        tension_n: Tensor,
        stiffness: Tensor,
        across_n: Tensor,
        jacobian: Tensor,
        held_slope: Tensor,
        weighed: Weighed,
        by_torque: Tensor,
    ) -> Tensor:
        """G (B, M, P): derivative of readings by parameters at fixed contact torques."""
        # Parameters of one cable: its own tension at a fixed pose (A), and torques beside (B).
        # At a guide they are in the exponent ε Φ, which acts on the spans behind it.
        by_pretension = stiffness * given.compliance_m_n
        by_stiffness = tension_n - given.pretension_n * by_pretension
        by_hole = stiffness * (spans.by_hole - straight_by_hole)
        by_compliance = -(tension_n * by_pretension)
        by_run = carried.by_run * by_compliance
        by_exponent = carried.by_exponent * by_compliance
        by_own_parameter = torch.cat(
            [by_stiffness, by_pretension, by_run, by_hole, by_exponent], dim=1
        )
        rubbed = (spans.slope_m * across_n)[:, :, :, None] * self.reaches
        turned = spans.slope_by_hole * across_n[:, :, :, None]
        beside = torch.cat([self.nothing * rubbed[:, :, :, :3], turned, rubbed], dim=3)
        torques = jacobian[:, :, None] * by_own_parameter[:, None] + beside.flatten(1, 2)
        gained = (by_own_parameter * given.gain).flatten(1)[:, None]
        of_cables = self.same_cable * gained - by_torque @ torques.flatten(2)
        plain, of_exponents = of_cables.split(self.plain_and_exponents, dim=2)
        of_carried = of_exponents * carried.wrap_rad.flatten(1)[:, None]
        # the coefficient itself is in no reading: only what is carried of it
        of_coefficient = 0.0 * of_exponents[:, :, :1]

        # a sensor reads its tension times its gain, and its zero
        sensed = self.by_gain * tension_n + self.by_zero
        of_sensors = self.same_sensor * sensed.flatten(1)[:, None]

        # joint zeros hold other lengths
        slack_n = stiffness.transpose(1, 2) * held_slope.transpose(1, 2)
        of_zeros = by_torque @ (jacobian @ slack_n) - slack_n * given.gain[:, None]

        of_bodies = by_torque @ weighed.by_parameter
        parts = [plain, of_carried, of_sensors, of_bodies, of_zeros, of_coefficient]
        return torch.cat(parts, dim=2)


def _nominal(
    mechanism: Mechanism, parameters: ArmParameters, radius_m: Matrix
) -> tuple[Matrix, Matrix]:
    """The numbers of an arm as its file describes it, in the places of its parameters θ.

    Of holes they are radius and offset around. With the second, n + s θ are those of another arm.
    """
    slices = parameters.slices
    nominal = np.zeros(len(parameters))
    scale = np.ones(len(parameters))
    nominal[slices["pretension"]] = mechanism.pretension_n
    for plate, radius in enumerate(radius_m):
        nominal[slices[f"hole_outward_{plate}"]] = radius
    nominal[slices["sensor_gain"]] = 1.0
    nominal[slices["segment_mass"]] = mechanism.mass_kg
    scale[slices["segment_mass"]] = mechanism.mass_kg
    nominal[slices["centre_of_mass"]] = mechanism.centre_of_mass_m
    nominal[slices["segment_length"]] = mechanism.segment_length_m
    return nominal, scale


def _sizes(parameters: ArmParameters) -> list[int]:
    """Numbers of parameters of each kind, with all holes together, all guides, and all bodies."""
    sizes: dict[str, int] = {}
    bodies = ("segment_mass", "centre_of_mass", "segment_length", "centre_across")
    for name, part in parameters.slices.items():
        kind = name.rstrip("0123456789") if name.startswith(CARRIED_FRICTION) else name
        kind = "hole" if name.startswith("hole") else kind
        kind = "bodies" if name in bodies else kind
        sizes[kind] = sizes.get(kind, 0) + part.stop - part.start
    return list(sizes.values())


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


def _compliance_shares(mechanism: Mechanism) -> Matrix:
    """(N + 1, M) shares of the compliance behind the pulley: the run, and from each joint on."""
    pieces = mechanism.piece_length_m
    count = mechanism.segment_count
    behind = np.zeros((count + 1, mechanism.cable_count))
    behind[0] = pieces[:, 0]
    for n in range(count):
        behind[n + 1] = pieces[:, 1 + 2 * n]
        if n + 1 < count:
            behind[n + 1] += pieces[:, 2 + 2 * n]
    return behind / behind.sum(0)


def _first_moment_slopes(mechanism: Mechanism) -> Matrix:
    """(5N, 3N · 5N): numbers of bodies to the derivatives of first moments by their parameters.

    A segment has the first moments m x + l Σ m of those that it carries, m y and m z; the
    parameters of masses are shares.
    """
    count = mechanism.segment_count
    carried = np.triu(np.ones((count, count)), 1)
    slopes = np.zeros((5, count, 3, count, 5, count))
    mass, x, length, y, z = range(5)
    for n in range(count):
        for axis, centre in enumerate((x, y, z)):
            slopes[centre, n, axis, n, mass, n] = mechanism.mass_kg[n]
            slopes[mass, n, axis, n, centre, n] = 1.0
        slopes[length, n, 0, n, mass] = carried[n] * mechanism.mass_kg
        slopes[mass, :, 0, n, length, n] = carried[n]
    return slopes.reshape(5 * count, -1)


def inverse(matrix: Tensor) -> Tensor:
    """Inverse of square matrices (..., k, k), in PyTorch and in an exported graph."""
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        return torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
    return torch.linalg.inv(matrix)
