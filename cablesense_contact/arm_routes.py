"""The cables of an arm of an arm file, from the pulley at the actuator over its plates."""

from __future__ import annotations

import math

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_routes import MOVED_STD
from cablesense_contact.cable_slides import CableSlides, FrictionParameters
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.uncertain_arm import arm_parameters, cable_friction

_WRAP_RAD = 1.0
"""Angle that counts, at every guide, for when a cable slides back: that of the pulley."""


class ArmRoutes:
    """A `CableRoutes`: guide 0 is the pulley, guide n the plates before joint n.

    Attributes:
        compliance_m_n, pretension_n, wrap_rad, moved_n, are_followed: see there.
    """

    are_followed = True

    def __init__(self, arm: Arm) -> None:
        """For the arm of a file."""
        mechanism = mechanism_of(arm)
        ratio = cable_friction(arm).run_compliance
        self._mechanism = mechanism
        count = mechanism.segment_count
        cables = mechanism.cable_count
        before_pulley = ratio / (1.0 + ratio)
        behind_m_n = (1.0 - before_pulley) / mechanism.stiffness_n_m
        pieces = mechanism.piece_length_m
        pieces_m_n = behind_m_n[:, None] * pieces / pieces.sum(axis=1, keepdims=True)
        # the piece to the base plate, and then each span with what lies in the segment behind it
        self.compliance_m_n = np.zeros((cables, count + 2))
        self.compliance_m_n[:, 0] = before_pulley / mechanism.stiffness_n_m
        self.compliance_m_n[:, 1:-1] = pieces_m_n[:, 0::2]
        self.compliance_m_n[:, 2:] += pieces_m_n[:, 1::2]
        self.pretension_n = mechanism.pretension_n
        self.wrap_rad = np.full((cables, count + 1), _WRAP_RAD)
        self.moved_n = MOVED_STD * math.sqrt(reading_variance_n2(arm.sensors))

    def on_the_way_m(self, from_command: Array, to_command: Array, steps: int) -> Array:
        """(steps + 1, M, N + 2) lengths of pieces on a straight way between commands (2N,).

        Of those before and in segments, which keep their lengths, they are counted as zero.
        """
        shares = np.linspace(0.0, 1.0, steps + 1)[:, None]
        commands = from_command + shares * (to_command - from_command)
        span_m = kinematics.spans(self._mechanism, commands).length_m
        return np.concatenate([np.zeros_like(span_m[..., :1]).repeat(2, axis=-1), span_m], axis=-1)

    def slope_m(self, command: Array) -> Array:
        """(M, N + 2, 2N) derivatives of the pieces' lengths by the joint angles at a command."""
        mechanism = self._mechanism
        count = mechanism.segment_count
        by_angle = kinematics.cable_jacobian_m(mechanism, command)
        slope = np.zeros((mechanism.cable_count, count + 2, count, 2))
        joints = np.arange(count)
        slope[:, joints + 2, joints] = by_angle.reshape(-1, count, 2)
        return slope.reshape(mechanism.cable_count, count + 2, 2 * count)

    def bends_rad(self, command: Array) -> Array:
        """(M, N + 1) by which cables turn at the guides at a command (2N,).

        On their way over a joint they turn by what it bends, half of it at the plates before and
        half at those behind.
        """
        half_rad = 0.5 * kinematics.bend_rad(command) * self._mechanism.passes_joint
        before_and_behind_rad = half_rad.copy()
        before_and_behind_rad[:, 1:] += half_rad[:, :-1]
        return np.concatenate([self.wrap_rad[:, :1], before_and_behind_rad], axis=1)


def arm_slides(arm: Arm) -> CableSlides:
    """The slides of the cables of an arm."""
    parameters = arm_parameters(arm)
    return CableSlides(ArmRoutes(arm), FrictionParameters.of(parameters))
