"""The examples that need no running node."""

import numpy as np
import pytest
from two_link import recorded, write_model

from cablesense_training import open_estimator
from examples import own_arm, own_effect, own_robot


def test_a_sensor_reads_nothing_below_its_threshold(capsys):
    own_effect.main()
    assert capsys.readouterr().out.replace(" ", "") == "[[5.0.3.]\n[5.1.43.]]\n"


@pytest.mark.slow
def test_a_model_is_trained_for_an_own_arm(tmp_path):
    pytest.importorskip("torch")
    assert open_estimator(own_arm.make(tmp_path)).metadata.arm.name == "my_arm"


@pytest.mark.slow
def test_friction_of_an_own_robot_is_found(tmp_path, capsys):
    recorded(tmp_path / "recording.csv", friction=(0.2, 0.0))
    own_robot.main(str(write_model(tmp_path)), str(tmp_path / "recording.csv"))
    assert "joint_friction" in capsys.readouterr().out


def test_a_push_turns_the_joints_with_it_up_to_their_limit():
    pytest.importorskip("rclpy")
    from examples.follow_force import LIMIT_RAD, next_command_rad

    torques_n_m = np.array([0.1, -2.0])
    assert next_command_rad(np.zeros(2), torques_n_m) == pytest.approx([0.0, -0.004])
    assert next_command_rad(np.full(2, LIMIT_RAD), -torques_n_m)[1] == LIMIT_RAD
