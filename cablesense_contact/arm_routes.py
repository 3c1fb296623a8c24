"""The cables of an arm of an arm file, from the pulley at the actuator over its plates."""

from __future__ import annotations

import math

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_routes import MOVED_STD, OnTheWay
from cablesense_contact.cable_slides import CableSlides, FrictionParameters
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.uncertain_arm import arm_parameters, cable_friction


class ArmRoutes:
    """A `CableRoutes`: guide 0 is the pulley, guide n the plates before joint n.

    Attributes:
        compliance_m_n, pretension_n, moved_n, are_followed, returning: see there.
    """

    are_followed = True
    returning = 0.0

    def __init__(self, arm: Arm) -> None:
        """For the arm of a file."""
        mechanism = mechanism_of(arm)
        self._friction = cable_friction(arm)
        ratio = self._friction.run_compliance
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
        self.moved_n = MOVED_STD * math.sqrt(reading_variance_n2(arm.sensors))

    def on_the_way(self, from_command: Array, to_command: Array, steps: int) -> OnTheWay:
        """Pieces and guides on a straight way between commands (2N,), in steps.

        Pieces before and in segments keep their lengths, which are counted as zero.
        """
        shares = np.linspace(0.0, 1.0, steps + 1)[:, None]
        commands = from_command + shares * (to_command - from_command)
        span_m = kinematics.spans(self._mechanism, commands).length_m
        others_m = np.zeros((*span_m.shape[:-1], 2))
        return OnTheWay(
            length_m=np.concatenate([others_m, span_m], axis=-1),
            wrap_rad=np.array([self.wrap_rad(command) for command in commands]),
        )

    def slope_m(self, command: Array) -> Array:
        """(M, N + 2, 2N) derivatives of the pieces' lengths by the joint angles at a command."""
        mechanism = self._mechanism
        count = mechanism.segment_count
        by_angle = kinematics.cable_jacobian_m(mechanism, command)
        slope = np.zeros((mechanism.cable_count, count + 2, count, 2))
        joints = np.arange(count)
        slope[:, joints + 2, joints] = by_angle.reshape(-1, count, 2)
        return slope.reshape(mechanism.cable_count, count + 2, 2 * count)

    def wrap_rad(self, command: Array) -> Array:
        """(M, N + 1) by which cables turn at the guides at a command (2N,).

        On their way over a joint they turn by what it bends, half of it at the plates before and
        half at those behind.
        """
        passes = self._mechanism.passes_joint
        half_rad = 0.5 * kinematics.bend_rad(command) * passes
        plates_rad = half_rad.copy()
        plates_rad[:, 1:] += half_rad[:, :-1] + self._friction.guide_wrap_rad * passes[:, 1:]
        pulley_rad = np.full((len(plates_rad), 1), self._friction.pulley_wrap_rad)
        return np.concatenate([pulley_rad, plates_rad], axis=1)


def arm_slides(arm: Arm) -> CableSlides:
    """The slides of the cables of an arm."""
    parameters = arm_parameters(arm)
    return CableSlides(ArmRoutes(arm), FrictionParameters.of(parameters))
