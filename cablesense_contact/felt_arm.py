"""An arm of an arm file, as estimates see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.arm_routes import arm_slides
from cablesense_contact.cable_slides import CableSlides
from cablesense_contact.felt import ChannelLimits, LinksAtPose
from cablesense_msgs_py.messages import MAX_JOINT_ANGLE_RAD
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, of_each_segment
from cablesense_sim.build import mechanism_of
from cablesense_sim.joint_motion import SUDDEN_OVER_STEADY
from cablesense_sim.kinematics import contact_torques
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import mean_variance_n2, reading_variance_n2
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.touch import is_one_place, touched_places
from cablesense_sim.uncertain_arm import arm_parameters

_KNOWN_N = 1.0
"""A force is known if both ends of its interval are within this of it."""
_SLACK_BELOW_STD = 4.0
"""An unloaded reading below this many deviations of a sensor's zero may be of a slack cable."""


class FeltArm:
    """An arm of an arm file as estimates see it: a `felt.FeltMachine`.

    Its commands are joint angles, and its frames `segment_n`.

    Attributes:
        arm: its file.
    """

    link_frames = None
    known_n = _KNOWN_N
    reads_joints = False
    largest_command = MAX_JOINT_ANGLE_RAD
    per_radian = 1.0

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        count = arm.segment_count
        length_m = np.array(of_each_segment(arm.segments.length_m, count))
        self.name = arm.name
        self.identity = arm.identity
        self.command_names = tuple(arm.joint_names)
        self.torque_names = self.command_names
        self.first_command = np.zeros(arm.joint_count)
        self.link_names = tuple(f"segment_{n + 1}" for n in range(count))
        self.surface_friction = arm.touch.friction
        self.drift_per_hour = arm.tolerances.drift_n_per_hour
        self.contact_m: Sequence[float] = of_each_segment(arm.segments.contact_m, count)
        self.joint_m: Array = np.concatenate([[0.0], np.cumsum(length_m)[:-1]])
        places = touched_places(arm)
        self.middle_m: Array = places.touched_m.mean(axis=1)
        self.felt_across: Array = np.tile(np.eye(2), (count, 1, 1))
        self.is_one_place = is_one_place(places.touched_m, np.zeros(count))
        lowest, highest = arm.sensors.range_n or (-np.inf, np.inf)
        cables = arm.cable_count
        self.channels = ChannelLimits(
            names=tuple(arm.cable_names),
            units=("N",) * cables,
            lowest=np.full(cables, lowest),
            highest=np.full(cables, highest),
        )
        zero_n = arm.tolerances.sensor_zero_n
        sensor_n = float(np.hypot(zero_n, reading_variance_n2(arm.sensors) ** 0.5))
        self.slack_below = np.full(cables, _SLACK_BELOW_STD * sensor_n)

    @cached_property
    def parameters(self) -> ArmParameters:
        """What is uncertain."""
        return arm_parameters(self.arm)

    @cached_property
    def zeros(self) -> NDArray[np.int64]:
        """(M,) numbers of the parameters that are the channels' zeros."""
        part = self.parameters.slices["sensor_zero"]
        return np.arange(part.start, part.stop)

    @cached_property
    def carried_friction(self) -> slice:
        """Where the parameters stand that are the state of friction."""
        return self.parameters.carried_friction

    @cached_property
    def slides(self) -> CableSlides:
        """How that state follows from what moves the cables."""
        return arm_slides(self.arm)

    @cached_property
    def _mechanism(self) -> Mechanism:
        return mechanism_of(self.arm)

    @cached_property
    def _inertia_kg_m2(self) -> Array:
        """(2N, 2N) of the straight arm, its segments taken as points."""
        mechanism = self._mechanism
        straight_rad = np.zeros(self.arm.joint_count)
        at_joint, slope = contact_torques(mechanism, straight_rad, np.eye(3))
        by_force_m = at_joint + mechanism.centre_of_mass_m[:, None, None] * slope
        return np.einsum("n,nxi,nxj->ij", mechanism.mass_kg, by_force_m, by_force_m)

    def mean_variance(self, count: int) -> Array:
        """(M,) variance of the mean of some readings."""
        return np.full(self.arm.cable_count, mean_variance_n2(self.arm.sensors, count))

    def innovation_noise(self, command: Array, variance: Array) -> Array:
        """(M, M) covariance of innovations, which are of the readings themselves."""
        del command
        return np.diag(variance)

    def unrest(self, speed_rad_s: Array, swing_rad_s2: Array) -> Array:
        """(2N, 2N) covariance of the torques of inertia and damping, as large as they are."""
        swing_n_m = SUDDEN_OVER_STEADY * self._inertia_kg_m2 * swing_rad_s2
        damping_n_m = self._mechanism.joint_damping_n_m_s * speed_rad_s
        return np.asarray(swing_n_m @ swing_n_m.T + np.diag(damping_n_m**2))

    def frame_pose(self, command: Array, pose: Array) -> Array:
        """The commanded angles, which every consumer can know."""
        del pose
        return command

    def links_at(self, pose: Array) -> LinksAtPose:
        """The segments at joint angles (2N,)."""
        mechanism = self._mechanism
        axes = kinematics.segment_rotations(mechanism, pose)
        at_joints = replace(mechanism, contact_m=np.zeros(mechanism.segment_count))
        joints_m = kinematics.contact_points_m(at_joints, pose)
        by_force_m, by_place = kinematics.contact_torques(mechanism, pose, axes)
        return LinksAtPose(axes, joints_m, by_force_m, by_place)
