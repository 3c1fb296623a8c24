"""Machines without joint sensors: their joints follow from poses of frames, or are refused."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_msgs_py.qos import INPUTS
from cablesense_msgs_py.topics import CABLE_TENSIONS
from cablesense_recording.recording import RecordingError
from tests.helpers.bags import START_NS, STORE, Bag, header_of
from tests.helpers.two_link import XML, recorded

POSITIONS = ["position.shoulder", "position.elbow"]
WITH_TIP = XML.replace(
    '<inertial pos="0.1 0 0"', '<site name="tip" pos="0.2 0 0"/><inertial pos="0.1 0 0"'
)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(WITH_TIP)
    return load_robot(path)


def poses(robot, position, frame="tip"):
    """(R, 7) of a site or body, by MuJoCo's forward kinematics."""
    data = mujoco.MjData(robot.model)
    rows = []
    for angles in position:
        data.qpos[:] = angles
        mujoco.mj_forward(robot.model, data)
        found = data.site(frame) if frame == "tip" else data.body(frame)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, found.xmat)
        rows.append(np.concatenate([found.xpos, quaternion]))
    return np.array(rows)


def tracked(robot, path, frames=("tip",), parts=7, noise_m=0.0, **planted):
    """A recording's table with poses in place of positions, and its positions."""
    table = pd.read_csv(recorded(path / "whole.csv", trials=5, **planted))
    position = table[POSITIONS].to_numpy()
    table = table.drop(columns=POSITIONS)
    rng = np.random.default_rng(0)
    for frame in frames:
        pose = poses(robot, position, frame)
        pose[:, :3] += rng.normal(0.0, 1.0, (len(pose), 3)) * noise_m
        labels = [f"pose.{frame}.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        for label, values in list(zip(labels, pose.T, strict=True))[:parts]:
            table[label] = values
    return table, position


def read(robot, path, table):
    table.to_csv(path / "tracked.csv", index=False)
    return read_robot_recording(path / "tracked.csv", robot)


@pytest.mark.parametrize("parts", [7, 3])
def test_joints_follow_from_the_pose_of_the_tip(robot, tmp_path, parts):
    table, position = tracked(robot, tmp_path, parts=parts)
    recording = read(robot, tmp_path, table)
    assert any("by inverse kinematics" in note for note in recording.notes)
    if parts == 7:
        np.testing.assert_allclose(recording.position, position, atol=1e-5)
    else:  # the elbow may be up or down
        reached = poses(robot, recording.position)[:, :3]
        np.testing.assert_allclose(reached, poses(robot, position)[:, :3], atol=1e-5)


def test_two_markers_give_the_posture(robot, tmp_path):
    table, position = tracked(robot, tmp_path, ("tip", "lower"), parts=3)
    recording = read(robot, tmp_path, table)
    np.testing.assert_allclose(recording.position, position, atol=1e-5)


def test_a_joint_that_was_measured_stays_as_it_is(robot, tmp_path):
    table, position = tracked(robot, tmp_path, parts=3)
    recording = read(robot, tmp_path, table.assign(**{POSITIONS[0]: position[:, 0]}))
    np.testing.assert_allclose(recording.position, position, atol=1e-5)


@pytest.mark.slow
def test_a_tracked_robot_without_joint_sensors_is_diagnosed(robot, tmp_path):
    table, _ = tracked(robot, tmp_path, noise_m=1e-4, friction=(0.0, 0.2))
    diagnosis = diagnose(read(robot, tmp_path, table), robot)
    assert diagnosis.verdict.effects == ("joint_friction",)
    assert diagnosis.verdict.where.joints == ("elbow",)


def test_a_frame_before_a_joint_does_not_show_it(robot, tmp_path):
    table, _ = tracked(robot, tmp_path, ("upper",))
    with pytest.raises(
        RecordingError, match=r"pose.upper does not determine shoulder, elbow|elbow"
    ):
        read(robot, tmp_path, table)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda t: t.rename(columns=lambda name: name.replace("tip", "hand")),
            "has poses of hand, which the model has not; robot.xml has the bodies and sites tip,",
        ),
        (lambda t: t.drop(columns="pose.tip.y"), "misses pose.tip.y; a pose has x, y, z in m"),
        (lambda t: t.drop(columns="pose.tip.qy"), "misses pose.tip.qy"),
        (lambda t: t.assign(**{"pose.tip.qw": 2.0}), "row 1, pose.tip: its quaternion has the"),
        (
            lambda t: t.assign(**{"pose.tip.x": t["pose.tip.x"].where(t.index != 700)}),
            "row 701, pose.tip: empty or not finite, as when a tracker loses it",
        ),
        (
            lambda t: t.assign(
                **{f"pose.tip.{axis}": 1e3 * t[f"pose.tip.{axis}"] for axis in "xyz"}
            ),
            "pose.tip cannot be reached: the nearest postures are off by",
        ),
    ],
)
def test_poses_that_cannot_be_used_are_refused_in_one_line(robot, tmp_path, change, said):
    table, _ = tracked(robot, tmp_path)
    with pytest.raises(RecordingError) as refused:
        read(robot, tmp_path, change(table))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_poses_beside_all_positions_are_not_used(robot, tmp_path):
    table, position = tracked(robot, tmp_path)
    whole = table.assign(**dict(zip(POSITIONS, position.T, strict=True)))
    recording = read(robot, tmp_path, whole)
    np.testing.assert_allclose(recording.position, position)
    assert "Poses are not used: all joints have positions." in recording.notes


class TrackerBag(Bag):
    """A bag of poses in one of the messages that trackers publish, and of efforts alone."""

    def pose(self, kind, topic, stamp_ns, pose, parent="base_link", frame="tip"):
        made = {name: STORE.types[f"geometry_msgs/msg/{name}"] for name in GEOMETRY}
        w, x, y, z = map(float, pose[3:])
        turned = made["Quaternion"](x, y, z, w)
        point = made["Point"](*map(float, pose[:3]))
        header = header_of(stamp_ns, parent)
        if kind == "geometry_msgs/msg/PoseStamped":
            message = STORE.types[kind](header, made["Pose"](point, turned))
        elif kind == "nav_msgs/msg/Odometry":
            still = made["Twist"](made["Vector3"](0.0, 0.0, 0.0), made["Vector3"](0.0, 0.0, 0.0))
            covariance = np.zeros(36)
            with_covariance = made["PoseWithCovariance"](made["Pose"](point, turned), covariance)
            twist = made["TwistWithCovariance"](still, covariance)
            message = STORE.types[kind](header, frame, with_covariance, twist)
        else:
            shift = made["Vector3"](*map(float, pose[:3]))
            transform = made["TransformStamped"](header, frame, made["Transform"](shift, turned))
            message = STORE.types[kind]([transform])
        if topic not in self.channels:
            offered = INPUTS[CABLE_TENSIONS].offered
            self.channels[topic] = self.file.add(topic, kind, offered)
        raw = bytes(STORE.serialize_cdr(message, kind))
        self.file.write(self.channels[topic], stamp_ns, raw)


GEOMETRY = (
    *("Quaternion", "Point", "Pose", "PoseWithCovariance", "Vector3", "Twist"),
    *("TwistWithCovariance", "Transform", "TransformStamped"),
)
KINDS = {
    "geometry_msgs/msg/PoseStamped": "/tracker/tip/pose",
    "nav_msgs/msg/Odometry": "/odometry",
    "tf2_msgs/msg/TFMessage": "/tf",
}


def tracker_bag(robot, path, kind, parents=("base_link",)):
    """The bag, and the positions behind it; efforts come 2 ms after the poses."""
    table = pd.read_csv(recorded(path / "whole.csv", trials=1))
    position = table[POSITIONS].to_numpy()
    efforts = np.ascontiguousarray(table[["torque.shoulder", "torque.elbow"]])
    with TrackerBag(path / "tracked.mcap") as bag:
        for row, pose in enumerate(poses(robot, position)):
            stamp_ns = START_NS + row * 10_000_000
            for number, parent in enumerate(parents):
                bag.pose(kind, KINDS[kind], stamp_ns + number, pose, parent)
            names = ("shoulder", "elbow")
            bag.joint_state(
                "joint_states", stamp_ns + 2_000_000, stamp_ns, names, effort=efforts[row]
            )
    return path / "tracked.mcap", position, efforts


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_poses_and_efforts_of_a_bag_give_positions_and_torques(robot, tmp_path, kind):
    path, position, efforts = tracker_bag(robot, tmp_path, kind)
    recording = read_robot_recording(path, robot)
    rows = len(recording)
    assert rows >= len(position) - 1
    np.testing.assert_allclose(recording.position, position[:rows], atol=1e-5)
    np.testing.assert_allclose(recording.torque, efforts[:rows], atol=1e-6)
    assert f"Poses of tip are those of {KINDS[kind]}, in the axes of base_link" in " ".join(
        recording.notes
    )


@pytest.mark.slow
def test_poses_in_several_axes_are_refused(robot, tmp_path):
    kind = "tf2_msgs/msg/TFMessage"
    path, _, _ = tracker_bag(robot, tmp_path, kind, ("base_link", "camera"))
    with pytest.raises(RecordingError, match="in the axes of base_link and of camera; record one"):
        read_robot_recording(path, robot)


@pytest.mark.slow
def test_transforms_from_link_to_link_are_no_poses(robot, tmp_path):
    path, _, _ = tracker_bag(robot, tmp_path, "tf2_msgs/msg/TFMessage", ("upper",))
    with pytest.raises(RecordingError, match="holds no sensor_msgs/msg/JointState with"):
        read_robot_recording(path, robot)
