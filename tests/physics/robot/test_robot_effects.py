"""Every listed effect of robots, in every comparison: seen at a typical size, nothing at zero."""

from dataclasses import fields

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.amending import changed, known_robot_effects, load_amended, write_amended
from cablesense_gap.robot.model import OF_POSITION, load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem
from cablesense_gap.simulator import Term
from tests.helpers.two_link import JOINTS, XML, motion, torques

KP_N_M = 40.0
"""Of the servos, N·m/rad."""
PULLED = """
  <tendon><spatial name="cable">
    <site site="motor"/><site site="guide"/><site site="hook"/>
  </spatial></tendon>
  <actuator><motor name="cable" tendon="cable" gear="-1"/>
"""
SITES = {
    "<worldbody>": '<site name="motor" pos="-0.05 0 0.02"/>',
    '<body name="upper">': '<site name="guide" pos="0.25 0 0.03"/>',
    '<body name="lower" pos="0.3 0 0">': '<site name="hook" pos="0.1 0 0.01"/>',
}
COMPARISONS = ("torques", "forward", "forward by commands", "servos")


def table(torque_read: bool) -> pd.DataFrame:
    """Six trials of servos about hanging; their commands, or torques, of the elbow a current."""
    rng = np.random.default_rng(3)
    trials = []
    for trial in range(6):
        time_s, position, speed, acceleration = motion(rng)
        position[:, 0] += 0.5 * np.pi
        torque = torques(position, speed, acceleration)
        columns = {"time_s": time_s + 10.0 * trial, "trial": trial}
        for j, joint in enumerate(JOINTS):
            read = torque[:, j] + rng.normal(0.0, 0.01, len(time_s))
            columns[f"position.{joint}"] = position[:, j] + rng.normal(0.0, 1e-4, len(time_s))
            if torque_read:
                columns[f"{'torque' if j == 0 else 'current'}.{joint}"] = read
            else:
                columns[f"command.{joint}"] = position[:, j] + torque[:, j] / KP_N_M
        if not torque_read:
            columns["command.cable"] = 5.0
        trials.append(pd.DataFrame(columns))
    return pd.concat(trials)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The pendulum with servos, and a tendon over a guide."""
    xml = XML.replace("<motor ", f'<position kp="{KP_N_M}" ').replace("<actuator>", PULLED)
    for body, site in SITES.items():
        xml = xml.replace(body, body + site)
    path = tmp_path_factory.mktemp("model") / "robot.xml"
    path.write_text(xml)
    return load_robot(path)


@pytest.fixture(scope="module")
def systems(robot, tmp_path_factory):
    """One for each comparison, by name."""
    folder = tmp_path_factory.mktemp("recordings")
    recordings = {}
    for torque_read in (True, False):
        path = folder / f"{'torques' if torque_read else 'commands'}.csv"
        table(torque_read).to_csv(path, index=False)
        recordings[torque_read] = read_robot_recording(path, robot)
    motions = (
        prepared(recordings[True], robot),
        prepared(recordings[True], robot, forward=True),
        prepared(recordings[False], robot),
        prepared(recordings[False], robot, external=True),
    )
    return {
        name: RobotSystem(robot, each, {}) for name, each in zip(COMPARISONS, motions, strict=True)
    }


def candidate(system, name):
    """The effect as a system offers it; None where it does not."""
    offered = (*system.candidates, *system.tolerances)
    return next((each for each in offered if each.effect == name), None)


def sized(offered, size):
    """The effect at the last of its places, with numbers of `size` times their typical one."""
    numbers = (*offered.parameters, *offered.richer)
    return {
        Term(offered.effect, offered.places[-1], p.name): p.typical
        * (1.0 if p.role == "shape" else size)
        for p in numbers
    }


@pytest.mark.parametrize("name", list(known_robot_effects()))
def test_it_is_seen_wherever_it_is_offered_and_nothing_is_at_size_zero(name, systems):
    offering = [system for system in systems.values() if candidate(system, name)]
    assert offering
    seen_floors = []
    for system in offering:
        offered = candidate(system, name)
        nominal, none, whole = system.predict([{}, sized(offered, 0.0), sized(offered, 1.0)])
        np.testing.assert_allclose(none, nominal, atol=1e-6, err_msg=system.compared)
        seen_floors.append(np.abs(whole - nominal).max())
    assert min(seen_floors) > 0.02
    assert max(seen_floors) > 1.0


@pytest.mark.parametrize("name", list(known_robot_effects()))
def test_it_changes_what_it_says(name, robot, systems):
    effect = known_robot_effects()[name]
    system = next(each for each in systems.values() if candidate(each, name))
    values = sized(candidate(system, name), 1.0)
    change = changed(robot, [values])
    nominal = robot.nominal()
    altered = {
        each.name for each in fields(change) if change.key(each.name) != nominal.key(each.name)
    }
    assert altered
    if effect.adds:
        assert effect.adds in altered
    if effect.of_torques:
        assert not altered & set(OF_POSITION)


@pytest.mark.parametrize("name", list(known_robot_effects()))
def test_the_amended_robot_is_the_changed_one(name, robot, systems, tmp_path):
    system = next(each for each in systems.values() if candidate(each, name))
    values = sized(candidate(system, name), 1.0)
    write_amended(tmp_path, robot, values, {})
    again, beside = load_amended(tmp_path)
    in_model = {term.effect for term in set(values) - set(beside)}
    assert in_model == ({name} if known_robot_effects()[name].in_model else set())
    amended = RobotSystem(again, system.motion, beside)
    expected = system.predict([values])[0] * system.scale
    np.testing.assert_allclose((amended.nominal - expected) / system.scale, 0.0, atol=1e-2)
