"""Names of topics and services, names of frames, and the error of a message that breaks them.

Topics with `~` are relative to the estimator's own name; when it publishes is said in docs/ros.md,
"Topics". Frames are `base_link` and `segment_1` … `segment_N`, each with an optional prefix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cablesense_base import CableSenseError, some_of

CABLE_TENSIONS: Final = "cable_tensions"
"""`sensor_msgs/JointState`: `name` cable_1 … cable_M, `effort` in N, stamped with the time of the
sample."""
SIMULATED_TENSIONS: Final = "simulated_tensions"
"""`sensor_msgs/JointState`: as `cable_tensions`, from a sim whose tensions `can_emulator` sends as
CAN frames."""
JOINT_COMMANDS: Final = "joint_commands"
"""`sensor_msgs/JointState`: `position` in rad as commanded, by name (`joint_1_pitch`,
`joint_1_yaw`, …) in any order. Other joints keep their command, at first straight."""
JOINT_TRAJECTORY: Final = "joint_trajectory"
"""`trajectory_msgs/JointTrajectory`: `sim`, `can_driver` and `estimator` take it as commands every
20 ms; recordings for a diagnosis, page and controllers need `joint_commands`."""
CABLE_OFFSETS: Final = "cable_offsets"
"""`sensor_msgs/JointState`: cable names, `position` in m by which each cable is to exceed its
commanded length, at most 5 mm. As in `joint_commands`, `header.frame_id` marks a breath
(`messages.breath_turn`)."""
JOINT_STATES: Final = "joint_states"
"""`sensor_msgs/JointState`: `position` in rad by joint name, as they are in the simulation; of a
real arm the set-points of its commands, from `can_driver`."""
APPLIED_WRENCH: Final = "applied_wrench"
"""`geometry_msgs/WrenchStamped`: a known force on one segment, in base axes, N: in frame
`segment_N` without torque, or in the base frame, or that of a machine's link, with the torque that
says where."""
TRIAL: Final = "trial"
"""`std_msgs/Int32`: optional, for a diagnosis: the number of the trial that starts now."""
ROBOT_DESCRIPTION: Final = "robot_description"
"""`std_msgs/String`: the URDF generated from the arm file; transient local."""
DIAGNOSTICS: Final = "/diagnostics"
"""`diagnostic_msgs/DiagnosticArray`: from every node, 1 Hz."""
CONTACT_POINT: Final = "~/contact_point"
"""`geometry_msgs/PointStamped`: where the contact is along the segment, as a point on its axis, in
frame `segment_N`; only during a contact."""
CONTACT_REGION: Final = "~/contact_region"
"""`geometry_msgs/PolygonStamped`: two points on the segment's axis, in frame `segment_N`, the ends
of the place's 95 % interval; only during a contact."""
CONTACT_POSE: Final = "~/contact_pose"
"""`geometry_msgs/PoseWithCovarianceStamped`: the same point in the base frame, the x axis along
the normal force, the z axis along the segment; only during a contact."""
CONTACT_COVARIANCE: Final = "~/contact_covariance"
"""`std_msgs/Float64MultiArray`: 4 x 4 by rows, of the place on the segment's axis, m, and the
force along the segment's axes, N; without a stamp, after the sample's wrench; only during a
contact."""
FORCE_DIRECTION: Final = "~/force_direction"
"""`geometry_msgs/Vector3Stamped`: unit vector in frame `segment_N`, only during a contact."""
WRENCH: Final = "~/wrench"
"""`geometry_msgs/WrenchStamped`: the environment's force on the arm."""
STATUS: Final = "~/status"
"""`diagnostic_msgs/DiagnosticArray`: the state of every wrench, with the wrench's stamp: one
status, whose message is a `messages.ForceState`."""
ESTIMATE: Final = "~/estimate"
"""`cablesense_msgs/ForceEstimate`: where that package is installed, state, wrench, intervals,
place, and the covariance of place and force together. Recordings leave it out."""
WRENCH_LOWER: Final = "~/wrench_lower"
"""`geometry_msgs/WrenchStamped`: with every estimate, the lower end of the 95 % intervals of force
and direction. Directions range from this one to the upper's with a growing angle; where it is zero
every direction may be true."""
WRENCH_UPPER: Final = "~/wrench_upper"
"""`geometry_msgs/WrenchStamped`: the upper end."""
WRENCH_BASE: Final = "~/wrench_base"
"""`geometry_msgs/WrenchStamped`: with every wrench the same force, of all contacts together, in
axes and about the origin of `base_link`."""
JOINT_TORQUES: Final = "~/joint_torques"
"""`sensor_msgs/JointState`: `effort` in N·m by which contacts turn the joints, by joint name."""
SEGMENT_WRENCHES: Final = "~/wrenches/segment_{}"
"""`geometry_msgs/WrenchStamped`: the force on that segment, zero where nothing touches it; none
from a network of one contact."""
CONTACT_PROBABILITIES: Final = "~/contact_probabilities"
"""`std_msgs/Float64MultiArray`: the probability of no contact, of segment 1, … of segment N; at
most 30 Hz."""
MARKERS: Final = "~/markers"
"""`visualization_msgs/MarkerArray`: an arrow (0.2 m for 50 N) and a sphere while something
touches; at most 30 Hz."""
CALIBRATION: Final = "calibration"
"""`std_msgs/UInt8MultiArray`: the content of a calibration file, as a commissioning makes it; the
estimator takes it over; transient local."""
CALIBRATION_USED: Final = "~/calibration"
"""`std_msgs/UInt8MultiArray`: the same, as the estimator uses it from now on; its layout's label
has model, settings and time as JSON; transient local."""
TARE: Final = "~/tare"
"""`std_srvs/Trigger`: take the present tensions as the unloaded state."""
TARE_UNDO: Final = "~/tare_undo"
"""`std_srvs/Trigger`: go back to the tare before the last one."""
BREATHE: Final = "~/breathe"
"""`std_srvs/Trigger`: of the breather, one breath from now on; answered when it begins."""
COMMISSION: Final = "~/commission"
"""`std_srvs/Trigger`: of the commissioner, begin a commissioning; answered when it begins."""


class ContractError(CableSenseError):
    """A message that breaks the contract: names the field, its content, what would be right."""


@dataclass(frozen=True)
class Frames:
    """The frames of a machine with `segment_count` links; `prefix` goes before each name.

    Links are the segments of an arm, `segment_1` …, unless they have `names` of their own.
    """

    segment_count: int
    prefix: str = ""
    names: tuple[str, ...] = ()

    @property
    def base(self) -> str:
        """The base frame (REP-105)."""
        return f"{self.prefix}base_link"

    def segment(self, number: int) -> str:
        """The frame of segment `number`, counted from 1."""
        if self.names:
            return f"{self.prefix}{self.names[number - 1]}"
        return f"{self.prefix}segment_{number}"

    def segment_number(self, frame_id: str) -> int:
        """The number in a segment's frame name.

        Raises:
            ContractError: the frame is not one of this arm's segments.
        """
        frames = [self.segment(number) for number in range(1, self.segment_count + 1)]
        if frame_id not in frames:
            raise ContractError(
                f"header.frame_id is {frame_id[:40]!r}; it must be one of {some_of(frames)}"
            )
        return 1 + frames.index(frame_id)
