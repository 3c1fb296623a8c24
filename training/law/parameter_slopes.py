"""How readings follow the uncertain parameters, about the state that a reading shows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.parameter_groups import CARRIED_FRICTION
from cablesense_sim.tolerances import ArmParameters
from cablesense_training.law.friction import CarriedTensions, guides_up_to_joints
from cablesense_training.law.geometry import SegmentFrames, Spans, constant
from cablesense_training.law.parameters import Parameters, groups_by_kind, positions_of
from cablesense_training.law.weight import Weighed

_PLAIN_KINDS = ("cable_stiffness", "pretension", "run_compliance", "holes")
"""Kinds of one cable that `ParameterSlopes.forward` takes as they are."""
_SENSOR_KINDS = ("sensor_gain", "sensor_zero")
"""Kinds of one sensor."""
_OTHER_KINDS = ("bodies", "base_tilt", "joint_zero", "friction")
"""Kinds that concern all cables."""


class State(NamedTuple):
    """The state that B readings show: an exact one, as torques balance its tensions.

    Attributes:
        pose_rad: (B, 1, 2N) joint angles.
        spans: of the cables there.
        straight_by_hole: (2 (N + 1), M) of a straight arm's cable lengths by their holes.
        held_slope_m: (B, 2N, M) of the held lengths by the commanded angles.
        carried: what friction makes of the tensions at the actuators.
        tension_n: (B, 1, M) at the actuators.
        stiffness_n_m: (B, 1, M) of the cables; zero of slack ones.
        across_n: (B, N, 1, M) tensions across the joints.
        jacobian_m: (B, 2N, M) torques of one newton at each actuator.
        frames: of the segments.
        weighed: the weight of the segments.
    """

    pose_rad: Tensor
    spans: Spans
    straight_by_hole: Tensor
    held_slope_m: Tensor
    carried: CarriedTensions
    tension_n: Tensor
    stiffness_n_m: Tensor
    across_n: Tensor
    jacobian_m: Tensor
    frames: SegmentFrames
    weighed: Weighed


class ParameterSlopes(nn.Module):
    """G (B, M, P): derivative of readings by parameters at fixed contact torques."""

    def __init__(self, segment_count: int, cable_count: int, parameters: ArmParameters) -> None:
        super().__init__()
        kinds = groups_by_kind(segment_count)
        plain = sum((kinds[kind] for kind in _PLAIN_KINDS), ())
        carried = kinds[CARRIED_FRICTION]
        sensors = sum((kinds[kind] for kind in _SENSOR_KINDS), ())
        others = sum((kinds[kind] for kind in _OTHER_KINDS), ())
        positions = positions_of(parameters, (*plain, *carried, *sensors, *others))
        self.are_in_order = bool((positions == np.arange(len(positions))).all())
        # of each parameter the column that `forward` computes for it
        self.columns = constant(np.argsort(positions))
        self.reaches = constant(guides_up_to_joints(segment_count)[:, None, :, None])
        # each of these groups has one parameter of each cable, or sensor
        self.same_cable = constant(np.tile(np.eye(cable_count), len(plain) + len(carried)))
        self.same_sensor = constant(np.tile(np.eye(cable_count), len(sensors)))
        self.plain_and_exponents = (len(plain) * cable_count, len(carried) * cable_count)
        self.by_gain = constant(np.array([[1.0], [0.0]]))
        self.by_zero = constant(np.array([[0.0], [1.0]]))
        self.nothing = constant(np.zeros((3, 1)))

    def forward(self, given: Parameters, state: State, by_torque: Tensor) -> Tensor:
        """G at a state; `by_torque` (B, M, 2N) is the derivative by contact torques."""
        # Parameters of one cable: its own tension at a fixed pose (A), and torques beside (B).
        # At a guide they are in the exponent ε Φ, which acts on the state.spans behind it.
        by_pretension = state.stiffness_n_m * given.compliance_m_n
        by_stiffness = state.tension_n - given.pretension_n * by_pretension
        by_hole = state.stiffness_n_m * (state.spans.by_hole - state.straight_by_hole)
        by_compliance = -(state.tension_n * by_pretension)
        by_run = state.carried.by_run * by_compliance
        by_exponent = state.carried.by_exponent * by_compliance
        # of the kinds of `_PLAIN_KINDS`, and then of carried friction
        by_own_parameter = torch.cat(
            [by_stiffness, by_pretension, by_run, by_hole, by_exponent], dim=1
        )
        rubbed = (state.spans.slope_m * state.across_n)[:, :, :, None] * self.reaches
        turned = state.spans.slope_by_hole * state.across_n[:, :, :, None]
        beside = torch.cat([self.nothing * rubbed[:, :, :, :3], turned, rubbed], dim=3)
        torques = state.jacobian_m[:, :, None] * by_own_parameter[:, None] + beside.flatten(1, 2)
        gained = (by_own_parameter * given.gain).flatten(1)[:, None]
        of_cables = self.same_cable * gained - by_torque @ torques.flatten(2)
        plain, of_exponents = of_cables.split(self.plain_and_exponents, dim=2)
        of_carried = of_exponents * state.carried.wrap_rad.flatten(1)[:, None]
        # the coefficient itself is in no reading: only what is state.carried of it
        of_coefficient = 0.0 * of_exponents[:, :, :1]

        # a sensor reads its tension times its gain, and its zero
        sensed = self.by_gain * state.tension_n + self.by_zero
        of_sensors = self.same_sensor * sensed.flatten(1)[:, None]

        # joint zeros hold other lengths
        slack_n = state.stiffness_n_m.transpose(1, 2) * state.held_slope_m.transpose(1, 2)
        of_zeros = by_torque @ (state.jacobian_m @ slack_n) - slack_n * given.gain[:, None]

        of_bodies = by_torque @ state.weighed.by_parameter
        # of the kinds of `_PLAIN_KINDS`, carried friction, `_SENSOR_KINDS` and `_OTHER_KINDS`
        parts = [plain, of_carried, of_sensors, of_bodies, of_zeros, of_coefficient]
        slopes = torch.cat(parts, dim=2)
        return slopes if self.are_in_order else slopes[:, :, self.columns]
