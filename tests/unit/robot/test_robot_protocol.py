"""The protocol that robots are recorded on, and what is hidden in one by its own names."""

import numpy as np
import pytest

from cablesense_gap.robot.model import load_robot
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
