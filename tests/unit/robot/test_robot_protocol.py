"""The protocol that robots are recorded on, and what is hidden in one by its own names."""

import numpy as np
import pytest

from cablesense_gap.robot.model import RobotError, load_robot
from cablesense_gap.robot.protocol import next_experiment, standard_protocol
from cablesense_gap.scoring import read_answers, score
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import ChannelGap
from tests.helpers.two_link import write_model
from tests.helpers.verdict_cases import verdict_of


@pytest.fixture
def robot(tmp_path):
    return load_robot(write_model(tmp_path))


def test_the_protocol_moves_every_joint_alone_and_all_at_once(robot):
    blocks = standard_protocol(robot)
    alone = [np.ptp(b.position, axis=0) > 1e-9 for b in blocks if b.kind != "all joints"]
    assert [list(moved) for moved in alone] == [[True, False]] * 2 + [[False, True]] * 2
    assert all((np.ptp(b.position, axis=0) > 0.5).all() for b in blocks if b.kind == "all joints")


def test_a_slide_without_a_range_moves_a_little_and_the_protocol_says_so(tmp_path):
    path = tmp_path / "slide.xml"
    body = "<body><joint name='lift' type='slide'/><geom size='0.1'/></body>"
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    blocks = standard_protocol(load_robot(path))
    assert max(np.abs(block.position).max() for block in blocks) <= 0.1
    assert "between -0.1 and 0.1 m (the model has no range of it)" in blocks[0].does


FINGER = "<body><joint name='{0}' type='slide' range='{1}'/><geom size='0.1'/></body>"
FINGERS = "".join(
    FINGER.format(*each) for each in (("a", "0 0.04"), ("b", "-0.04 0.04"), ("c", "0 0.1"))
)


def fingers(tmp_path, equalities):
    path = tmp_path / "fingers.xml"
    path.write_text(
        f"<mujoco><worldbody>{FINGERS}</worldbody><equality>{equalities}</equality></mujoco>"
    )
    return load_robot(path)


@pytest.mark.parametrize(
    ("equalities", "leading", "followed"),
    [
        ("<joint joint1='b' joint2='a'/>", "ac", {1: lambda p: p[:, 0]}),
        (
            "<joint joint1='b' joint2='a' polycoef='0.01 -2 0 0 0'/>",
            "ac",
            {1: lambda p: 0.01 - 2.0 * p[:, 0]},
        ),
        (
            "<joint joint1='b' joint2='a' polycoef='0 1 5 0 0'/>",
            "ac",
            {1: lambda p: p[:, 0] + 5.0 * p[:, 0] ** 2},
        ),
        (
            "<joint joint1='c' joint2='b'/><joint joint1='b' joint2='a'/>",
            "a",
            {1: lambda p: p[:, 0], 2: lambda p: p[:, 0]},
        ),
        ("<joint joint1='b' polycoef='0.02 0 0 0 0'/>", "ac", {1: lambda p: 0.02 + 0 * p[:, 0]}),
        (
            "<joint joint1='b' joint2='a'/><joint joint1='a' joint2='b'/>",
            "bc",
            {0: lambda p: p[:, 1]},
        ),
        ("<joint joint1='b' joint2='a' active='false'/>", "abc", {}),
    ],
)
def test_joints_that_are_tied_follow_theirs(tmp_path, equalities, leading, followed):
    robot = fingers(tmp_path, equalities)
    blocks = standard_protocol(robot)
    alone = [block for block in blocks if block.kind != "all joints"]
    assert [block.does.split()[1] for block in alone] == [j for j in leading for _ in range(2)]
    for block in blocks:
        for joint, law in followed.items():
            assert block.position[:, joint] == pytest.approx(law(block.position), abs=1e-12)
        low, high = robot.model.jnt_range.T
        assert (block.position >= low - 1e-9).all()
        assert (block.position <= high + 1e-9).all()


def test_the_protocol_says_which_joints_follow(tmp_path):
    ties = "<joint joint1='c' joint2='b'/><joint joint1='b' joint2='a'/>"
    chain = standard_protocol(fingers(tmp_path, ties))
    assert "; b and c follow; the others stay" in chain[0].does
    assert chain[-1].does.endswith("; b and c follow")
    one = standard_protocol(fingers(tmp_path, "<joint joint1='b' joint2='a'/>"))
    assert "; b follows; the others stay" in one[0].does
    assert "follow" not in one[2].does  # c alone


def test_an_equality_that_is_not_active_ties_nothing(tmp_path):
    tie = "<joint joint1='b' joint2='a' active='{}'/>"
    active = fingers(tmp_path, tie.format("true"))
    inactive = fingers(tmp_path, tie.format("false"))
    assert active.geared[1, 0] == 1.0
    assert not inactive.geared.any()
    assert not inactive.left_out


def test_two_equalities_of_one_joint_are_refused(tmp_path):
    ties = "<joint joint1='c' joint2='b'/><joint joint1='c' joint2='a'{}/>"
    with pytest.raises(RobotError, match=r"fingers\.xml: two equalities tie joint c; leave one"):
        fingers(tmp_path, ties.format(""))
    assert fingers(tmp_path, ties.format(" active='false'")).geared[2].tolist() == [0.0, 1.0, 0.0]


def test_a_joint_that_mimics_another_in_a_urdf_follows_it(tmp_path):
    link = (
        "<link name='{0}'><inertial><mass value='1'/>"
        "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )
    joint = (
        "<joint name='{0}' type='prismatic'><parent link='base'/><child link='{0}'/>"
        "<axis xyz='1 0 0'/><limit lower='-0.05' upper='0.05' effort='1' velocity='1'/>{1}</joint>"
    )
    mimic = "<mimic joint='left' multiplier='-1' offset='0.01'/>"
    parts = [link.format("left"), link.format("right"), joint.format("left", "")]
    path = tmp_path / "gripper.urdf"
    path.write_text(
        f"<robot name='gripper'><link name='base'/>{''.join(parts)}"
        f"{joint.format('right', mimic)}</robot>"
    )
    blocks = standard_protocol(load_robot(path))
    assert not any("move right alone" in block.does for block in blocks)
    for block in blocks:
        assert block.position[:, 1] == pytest.approx(0.01 - block.position[:, 0])


def test_the_next_experiment_moves_the_joint_in_question(robot):
    asked = next_experiment(
        robot, [{Term("joint_friction", "shoulder", "torque_n_m"): 0.1}], np.array([0.1, 0.01])
    )
    assert "shoulder alone" in asked or "all joints" in asked
    assert "0.7 floors" in asked  # one of two joints has a floor's size of friction all the time


def test_places_of_a_robot_are_scored_by_its_own_names(tmp_path):
    answers = tmp_path / "answers.csv"
    answers.write_text("recording,effects,where\na,joint_coupling,wrist-2_into_wrist-1\n")
    channels = {"wrist-1": ChannelGap(unit="N·m", before=1.0, after=0.1, floor=0.1)}
    said = verdict_of("joint_coupling", joints=("wrist-2",), channels=channels)
    assert score({"a": said}, read_answers(answers)).where.hits == 1
