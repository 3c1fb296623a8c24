"""What efforts are: told by their columns or an option, else by the model, before any fit."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from cablesense_base.installation import config_path
from cablesense_gap.robot.efforts import effort_interpretations
from cablesense_gap.robot.model import gravity_torque, inverse_dynamics, load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_recording.recording import RecordingError
from tests.helpers.two_link import motion, recorded, torques, write_model

DEGREES = 180.0 / np.pi


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("robot")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


def recording_of(noise_n_m=0.01, **planted):
    """Four trials of the pendulum."""
    rng = np.random.default_rng(0)
    parts = []
    for trial in range(4):
        time_s, position, speed, acceleration = motion(rng)
        position += [0.6, 0.9]
        torque = torques(position, speed, acceleration, **planted)
        parts.append((time_s, np.full(len(time_s), trial), position, torque))
    time_s, trial, position, torque = map(np.concatenate, zip(*parts, strict=True))
    torque += np.random.default_rng(1).normal(0.0, noise_n_m, torque.shape)
    return RobotRecording("made", time_s, trial, position, torque, np.nan * torque)


def interpretations(recording, robot):
    return effort_interpretations(robot, prepared(recording, robot))


@pytest.mark.parametrize(
    "planted", [{}, {"friction": (0.1, 0.08)}, {"friction": (0.1, 0.08), "payload": 0.1}]
)
@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((1e3, 1e3), "torque.shoulder, torque.elbow look like mN·m, not N·m (state --effort torq"),
        ((1.0, 1e3), "torque.elbow looks like mN·m, not N·m (state --effort elbow=torque:0.001)"),
        ((1e2, 1.0), "torque.shoulder looks like N·cm, not N·m (state --effort shoulder=torque:0"),
        ((1.0, -1e3), "torque.elbow looks like mN·m with the other sign"),
    ],
)
def test_torque_in_another_unit_is_told_by_its_name(robot, planted, factors, said):
    recording = recording_of(**planted)
    (suspect,) = interpretations(
        replace(recording, torque=recording.torque * factors), robot
    ).suspect
    assert suspect.startswith(said)


def test_torque_without_gravity_is_told_before_any_fit(robot):
    recording = recording_of(friction=(0.1, 0.08))
    gravity = gravity_torque(robot.model, recording.position)
    lacking = replace(recording, torque=recording.torque - gravity)
    with pytest.raises(RecordingError) as stopped:
        diagnose(lacking, robot)
    text = str(stopped.value)
    assert "the efforts of shoulder, elbow lack the model's gravity of" in text
    assert "(state --effort torque_without_gravity)" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"position": (DEGREES, DEGREES)}, "positions look like degrees"),
        ({"position": (1.0, DEGREES)}, "position.elbow looks like degrees"),
        ({"time_s": 1e3}, "time_s looks like milliseconds"),
        ({"time_s": 1e6}, "time_s looks like microseconds"),
        ({"time_s": 1e9}, "time_s looks like nanoseconds"),
    ],
)
def test_positions_and_times_in_another_unit_are_told_by_their_name(robot, change, said):
    recording = recording_of(friction=(0.1, 0.08))
    changed = {name: getattr(recording, name) * factor for name, factor in change.items()}
    (suspect,) = interpretations(replace(recording, **changed), robot).suspect
    assert suspect.startswith(said)


@pytest.mark.parametrize(
    "planted",
    [
        {},
        {"friction": (1.0, 0.5)},
        {"friction": (0.1, 2.0)},
        {"payload": 1.0},
        {"payload": 5.0},
        {"armature": (2.0, 0.0)},
        {"armature": (0.0, 0.3), "payload": 0.5},
        {"noise_n_m": 0.3},
    ],
)
def test_effects_of_any_size_and_noise_are_no_other_unit(robot, planted):
    assert not interpretations(recording_of(**planted), robot).suspect


@pytest.mark.parametrize("factors", [(0.05, 0.05), (20.0, 40.0)])
def test_a_gain_of_no_known_unit_is_a_doubt_that_names_the_remedy(robot, factors):
    recording = recording_of(friction=(0.1, 0.08))
    said = interpretations(replace(recording, torque=recording.torque * factors), robot)
    assert not said.suspect
    assert len(said.doubts) == 2
    assert "if it is a current, state --effort shoulder=current" in said.doubts[0]


def changed_table(tmp_path, change, **planted):
    table = pd.read_csv(recorded(tmp_path / "whole.csv", **planted))
    path = tmp_path / "changed.csv"
    change(table).to_csv(path, index=False)
    return path


def in_amperes(constants, word="current"):
    def change(table):
        for joint, constant in constants.items():
            torque = table.pop(f"torque.{joint}")
            table[f"{word}.{joint}"] = torque / constant
        return table

    return change


CONSTANTS = {"shoulder": 0.12, "elbow": 0.8}


@pytest.mark.slow
def test_columns_of_currents_are_brought_to_torques_and_their_constants_fitted(tmp_path, robot):
    path = changed_table(tmp_path, in_amperes(CONSTANTS), friction=(0.0, 0.2))
    recording = read_robot_recording(path, robot)
    assert any("torque constant is unknown" in note for note in recording.notes)
    diagnosis = diagnose(recording, robot)
    assert diagnosis.verdict.effects == ("joint_friction",)
    assert diagnosis.verdict.where.joints == ("elbow",)
    fitted = [term for term in diagnosis.amended if term.effect == "current_gain"]
    assert {term.place for term in fitted} == set(CONSTANTS)
    motion_gain = diagnosis.system.motion.gain
    np.testing.assert_allclose(motion_gain, list(CONSTANTS.values()), rtol=0.3)


def test_a_current_whose_constant_is_stated_is_that_torque(tmp_path, robot):
    path = changed_table(tmp_path, in_amperes(CONSTANTS))
    whole = read_robot_recording(tmp_path / "whole.csv", robot)
    stated = ["shoulder=current:0.12", "elbow=current:0.8"]
    recording = read_robot_recording(path, robot, efforts=stated)
    np.testing.assert_allclose(recording.torque, whole.torque, rtol=1e-6)


def test_gravity_is_added_where_a_column_or_an_option_says_that_it_lacks(tmp_path, robot):
    changed_table(tmp_path, lambda table: table)
    whole = read_robot_recording(tmp_path / "whole.csv", robot)
    gravity = gravity_torque(robot.model, whole.position)

    def without(word):
        def change(table):
            for number, joint in enumerate(CONSTANTS):
                torque = table.pop(f"torque.{joint}")
                table[f"{word}.{joint}"] = torque - gravity[:, number]
            return table

        return change

    by_column = read_robot_recording(
        changed_table(tmp_path, without("torque_without_gravity")), robot
    )
    path = changed_table(tmp_path, without("torque"))
    by_option = read_robot_recording(path, robot, efforts=["torque_without_gravity"])
    for recording in (by_column, by_option):
        np.testing.assert_allclose(recording.torque, whole.torque, atol=1e-4)
        assert any("the model's is added" in note for note in recording.notes)
        assert not effort_interpretations(robot, prepared(recording, robot)).suspect


def test_a_stated_torque_is_not_doubted(robot):
    recording = recording_of(friction=(0.1, 0.08))
    doubted = replace(recording, torque=recording.torque * 1e3)
    said = effort_interpretations(robot, prepared(doubted, robot), (True, True))
    assert not said.suspect
    assert not said.doubts


def test_of_a_torque_and_a_current_the_torque_is_read(tmp_path, robot):
    path = changed_table(
        tmp_path,
        lambda t: t.assign(**{"current.elbow": 1.0, "current.fan": 2.0, "current.shoulder": 3.0}),
    )
    recording = read_robot_recording(path, robot)
    whole = read_robot_recording(tmp_path / "whole.csv", robot)
    np.testing.assert_array_equal(recording.torque, whole.torque)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("amps", "'amps' is none of torque, current, torque_without_gravity"),
        ("knee=current", "no joint 'knee'; there are shoulder, elbow"),
        ("elbow=torque:much", "'much' is no factor"),
        ("elbow=torque:0", "'0' is no factor"),
    ],
)
def test_a_statement_that_says_nothing_is_refused(tmp_path, robot, statement, said):
    path = recorded(tmp_path / "whole.csv", trials=1)
    with pytest.raises(RecordingError, match="--effort") as refused:
        read_robot_recording(path, robot, efforts=[statement])
    assert said in str(refused.value)


def test_a_column_that_says_otherwise_than_the_option_is_refused(tmp_path, robot):
    path = changed_table(tmp_path, in_amperes(CONSTANTS))
    with pytest.raises(RecordingError, match="a column current is stated to be torque"):
        read_robot_recording(path, robot, efforts=["torque"])


@pytest.fixture(scope="module")
def six_joints():
    """A robot of six joints, and a recording of it in motion whose links are 10 % off."""
    six = load_robot(config_path("robots/arm_6.xml"))
    rng = np.random.default_rng(5)
    trial, time_s = np.divmod(np.arange(2400), 600)
    time_s = 0.01 * time_s
    position, speed, acceleration = np.zeros((3, 2400, 6))
    for number in range(4):
        rows = trial == number
        for hertz in (0.15, 0.4, 0.8):
            w = 2.0 * np.pi * hertz * rng.uniform(0.8, 1.2, 6)
            size = rng.uniform(0.03, 0.12, 6) / hertz
            phase = w * time_s[rows, None] + rng.uniform(0.0, 2.0 * np.pi, 6)
            position[rows] += size * np.sin(phase)
            speed[rows] += size * w * np.cos(phase)
            acceleration[rows] -= size * w**2 * np.sin(phase)
    built = six.nominal()
    built.mass_kg *= 1.0 + rng.normal(0.0, 0.1, len(built.mass_kg))
    torque = inverse_dynamics(six.varied(built), position, speed, acceleration)
    torque += 0.1 * np.sqrt((torque**2).mean(axis=0)) * np.sign(speed)
    commands = np.empty((2400, 0))
    return six, RobotRecording("six", time_s + 6.0 * trial, trial, position, torque, commands)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r, g: r, None),
        (lambda r, g: replace(r, torque=r.torque - g), "(state --effort torque_without_gravity)"),
        (lambda r, g: replace(r, torque=1e3 * r.torque), "(state --effort torque:0.001)"),
        (
            lambda r, g: replace(r, torque=r.torque * [1, 1, 1, 1, 100, 1]),
            "torque.joint_5 looks like N·cm, not N·m (state --effort joint_5=torque:0.01)",
        ),
        (lambda r, g: replace(r, position=r.position * DEGREES), "positions look like degrees"),
        (lambda r, g: replace(r, time_s=1e3 * r.time_s), "time_s looks like milliseconds"),
        (
            lambda r, g: replace(r, torque=r.torque[:, [0, 2, 1, 3, 4, 5]]),
            "torque.joint_2 and torque.joint_3 look exchanged",
        ),
        (
            lambda r, g: replace(r, torque=r.torque[:, [1, 0, 2, 3, 4, 5]]),
            "torque.joint_1 and torque.joint_2 look exchanged",
        ),
        (
            lambda r, g: replace(r, position=r.position * [1, -1, 1, 1, 1, 1]),
            "position.joint_2 looks as if it had the other sign",
        ),
    ],
)
def test_six_joints_of_which_one_feels_no_gravity(six_joints, change, said):
    six, recording = six_joints
    changed = change(recording, gravity_torque(six.model, recording.position))
    suspect = interpretations(changed, six).suspect
    if said is None:
        assert not suspect
    else:
        assert said in suspect[0]
        assert len(suspect) == 1
