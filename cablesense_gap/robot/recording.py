"""A recording of a robot, read under the names of its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from cablesense_gap.robot.model import Robot, gravity_torque
from cablesense_gap.robot.poses import PoseKinematics, pose_frames
from cablesense_recording.channels import RobotChannels
from cablesense_recording.efforts import Meaning
from cablesense_recording.robot_recording import RobotRecording as RobotRecording
from cablesense_recording.robot_recording import read_by_channels


def channels_of(robot: Robot) -> RobotChannels:
    """The channels that a recording of the robot may have."""
    return RobotChannels(
        model=robot.path.name,
        joints=robot.joints,
        joint_names=robot.joint_names,
        actuators=robot.controls,
        position_units=robot.position_units,
        torque_units=robot.torque_units,
        limited=tuple(robot.model.jnt_limited.astype(bool).tolist()),
        driven=_driven(robot),
        frames=pose_frames(robot),
    )


def _driven(robot: Robot) -> tuple[bool, ...]:
    """Whether a drive may act on each joint: all, where the model does not say."""
    model = robot.model
    of_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    if not len(of_joint) or not of_joint.all():
        return (True,) * len(robot.joints)
    return tuple(joint in model.actuator_trnid[:, 0] for joint in range(len(robot.joints)))


def read_robot_recording(
    path: str | Path,
    robot: Robot,
    topics: Sequence[str] = (),
    *,
    efforts: Sequence[str] = (),
    force: bool = False,
) -> RobotRecording:
    """Read a .csv or .csv.gz file, a folder of them, a .mcap file or a rosbag2 folder.

    Files of a folder do not share trials. `topics` are those of a bag to read where several fit.
    `efforts` state what efforts are, as `gap diagnose --effort` does; to those that lack gravity's
    torque the model's is added.
    With `force` a channel that stands still while its joint moves is no reason to refuse.

    Raises:
        RecordingError: as `cablesense_recording.robot_recording.read_by_channels`.
    """
    channels = channels_of(robot)
    recording = read_by_channels(
        path, channels, topics, efforts=efforts, kinematics=PoseKinematics(robot), force=force
    )
    lacks = [each.meaning is Meaning.WITHOUT_GRAVITY for each in recording.efforts]
    if not any(lacks):
        return recording
    gravity = gravity_torque(robot.model, recording.position)
    return replace(recording, torque=recording.torque + np.where(lacks, gravity, 0.0))
