"""Columns that are exchanged or reversed stop a diagnosis; effects of a robot do not."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.robot.signs import is_reversed
from cablesense_gap.robot.system import RobotSystem, diagnose, wrong_columns
from cablesense_recording.recording import RecordingError
from tests.helpers.two_link import motion, torques, write_model

LAST = np.array([1.0, -1.0])
SWAPPED = [1, 0]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return load_robot(write_model(tmp_path_factory.mktemp("robot")))


def bent(read=lambda torque: torque, **planted):
    """The pendulum about poses at which the sign of a position matters."""
    rng = np.random.default_rng(0)
    parts = []
    for trial in range(4):
        time_s, position, speed, acceleration = motion(rng)
        position += [0.6, 0.9]
        torque = read(torques(position, speed, acceleration, **planted))
        parts.append((time_s, np.full(len(time_s), trial), position, torque))
    time_s, trial, position, torque = map(np.concatenate, zip(*parts, strict=True))
    torque += np.random.default_rng(1).normal(0.0, 0.01, torque.shape)
    return RobotRecording("bent", time_s, trial, position, torque, np.nan * torque)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"torque": lambda t: t[:, SWAPPED]}, ["torque.shoulder and torque.elbow look exchanged"]),
        ({"torque": lambda t: t * LAST}, ["torque.elbow looks as if it had the other sign"]),
        ({"torque": lambda t: np.clip(t * LAST, -0.05, 0.05)}, ["torque.elbow looks as if"]),
        ({"torque": np.negative}, ["torque.shoulder looks as if", "torque.elbow looks as if"]),
        ({"position": lambda p: p * LAST}, ["position.elbow looks as if"]),
        (
            {"command": lambda t: t[:, SWAPPED], "torque": lambda t: np.nan * t},
            ["command.shoulder and command.elbow look exchanged"],
        ),
        (
            {"command": lambda t: t * LAST, "torque": lambda t: np.nan * t},
            ["command.elbow looks as if it had the other sign"],
        ),
    ],
)
def test_columns_that_are_exchanged_or_reversed_stop_the_diagnosis(robot, changes, said):
    recording = bent(friction=(0.1, 0.08), payload=0.1)
    recording = replace(recording, command=recording.torque)
    changed = {name: change(getattr(recording, name)) for name, change in changes.items()}
    with pytest.raises(RecordingError, match="or continue with --force") as stopped:
        diagnose(replace(recording, **changed), robot)
    assert all(each in str(stopped.value) for each in said)
    assert str(stopped.value).count(" look") == len(said)


@pytest.mark.parametrize(
    "planted",
    [
        {"payload": 5.0},
        {"friction": (1.0, 0.5)},
        {"armature": (2.0, 0.0)},
        {"read": lambda torque: 3.0 * torque + 2.0},
    ],
)
def test_effects_of_any_size_are_no_exchange(robot, planted):
    recording = bent(**planted)
    shares_left = RobotSystem(robot, prepared(recording, robot), {}).left_shares()
    assert max(shares_left.values()) > 0.6
    assert wrong_columns(recording, robot) == []


def test_a_reversed_torque_is_found_behind_friction_that_dominates_it(robot):
    recording = bent(friction=(0.1, 1.0))
    assert wrong_columns(recording, robot) == []
    reversed_one = replace(recording, torque=recording.torque * LAST)
    assert wrong_columns(reversed_one, robot) == ["torque.elbow looks as if it had the other sign"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torque": lambda t: 1e3 * t}, "torque.shoulder, torque.elbow look like mN·m, not N·m"),
        ({"torque": lambda t: 100.0 * t}, "torque.shoulder, torque.elbow look like N·cm, not N·m"),
        (
            {"position": lambda p: (p - 0.9) % (2.0 * np.pi) + 0.9},
            "jumps by a whole turn before row",
        ),
    ],
    ids=["millinewton metres", "newton centimetres", "wrapped"],
)
def test_other_units_and_wrapped_angles_stop_before_a_fit(robot, change, said):
    recording = bent(friction=(0.02, 0.02))
    changed = {name: made(getattr(recording, name)) for name, made in change.items()}
    with pytest.raises(RecordingError, match="or continue with --force") as stopped:
        diagnose(replace(recording, **changed), robot)
    assert said in str(stopped.value)


def test_the_unit_of_a_joint_without_torque_in_the_model_is_no_question(robot):
    """The model has about no torque at a joint that friction alone loads."""
    recording = bent()
    system = RobotSystem(robot, prepared(recording, robot), {})
    weak = system.readings.copy()
    weak[:, 1] *= 1e-4
    system.predict = lambda _variants: weak[None]  # the model's elbow has about no torque
    assert system.doubtful() == []


def swinging_pendulum(inertia_kg_m2):
    """Torque and acceleration of a pendulum that swings slower than it would by itself."""
    time_s = np.arange(0.0, 10.0, 0.01)
    angle = 0.3 * np.sin(3.0 * time_s) + 0.1 * np.sin(4.7 * time_s)
    acceleration = -2.7 * np.sin(3.0 * time_s) - 2.209 * np.sin(4.7 * time_s)
    stiffness_n_m = 2.0
    return stiffness_n_m * np.sin(angle) + inertia_kg_m2 * acceleration, acceleration


@pytest.mark.parametrize("rotor_kg_m2", [0.0, 0.1, 0.5, 3.0])
def test_a_rotor_that_turns_the_sign_of_a_torque_is_no_reversal(rotor_kg_m2):
    modelled, acceleration = swinging_pendulum(0.02)
    measured, _ = swinging_pendulum(0.02 + rotor_kg_m2)
    assert not is_reversed(measured, modelled, acceleration)
    assert (measured @ modelled < 0.0) == (rotor_kg_m2 > 0.3)
    assert is_reversed(-modelled, modelled, acceleration)
