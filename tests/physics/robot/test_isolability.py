"""What a planned motion tells apart: pairs whose physics says whether it can."""

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_gap.report.isolability import write_picture
from cablesense_gap.report.style import ReportError
from cablesense_gap.robot.isolability import CONFUSED, blocks_that_part, isolability, planned
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.protocol import RobotBlock, standard_protocol
from tests.helpers.two_link import write_model

HOIST = """<mujoco model="hoist"><worldbody><body name="load">
<joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
</body></worldbody><actuator><motor joint="lift"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return load_robot(write_model(tmp_path_factory.mktemp("model")))


@pytest.fixture(scope="module")
def found(pendulum):
    return isolability(planned(pendulum, standard_protocol(pendulum), "torques"))


@pytest.fixture
def hoist(tmp_path):
    path = tmp_path / "hoist.xml"
    path.write_text(HOIST)
    return load_robot(path)


def share(found, effect, place, other):
    row = found.sites.index((effect, place))
    return found.share[row, found.effects.index(other)]


def test_a_tilt_in_a_plane_is_the_first_joints_zero(found):
    assert share(found, "joint_zero", "shoulder", "base_tilt") >= CONFUSED
    assert found.may_confuse("joint_zero", "base_tilt")


def test_friction_that_turns_round_is_no_spring_and_no_offset(found):
    for other in ("joint_spring", "torque_offset", "link_mass"):
        assert share(found, "joint_friction", "elbow", other) < 0.01
    assert "joint_spring" not in found.imitators(found.sites.index(("joint_friction", "elbow")))


def test_every_size_from_which_an_effect_is_named_is_within_its_range(found):
    named = found.named_from[np.isfinite(found.named_from)]
    assert len(named) > 10
    assert (named > 0.0).all()
    assert found.seen[np.isfinite(found.named_from)].all()


def lifts(downwards):
    """A hoist that lifts, or lifts and lowers, in five trials."""
    time_s = np.arange(0.0, 6.0, 0.01)
    blocks = []
    for w in (2.0, 3.0, 4.0, 5.0, 6.0):
        way = 0.3 * np.sin(w * time_s) if downwards else 0.3 * time_s - 0.02 * np.sin(w * time_s)
        blocks.append(RobotBlock("lift", "lift the load", way[:, None]))
    return blocks


@pytest.mark.parametrize("downwards", [False, True])
def test_losses_are_told_from_a_torque_constant_where_the_load_is_lowered_too(hoist, downwards):
    found = isolability(planned(hoist, lifts(downwards), "torques"))
    alike = share(found, "load_friction", "lift", "torque_scale")
    assert (alike < CONFUSED) == downwards


@pytest.mark.slow
def test_commands_alone_show_friction_too(hoist):
    found = isolability(planned(hoist, lifts(downwards=True), "commands"))
    assert np.isfinite(found.named_from[found.sites.index(("joint_friction", "lift"))])


@pytest.mark.slow
def test_motion_is_chosen_in_which_two_effects_differ(pendulum):
    pair = "rotor_inertia", "payload"
    blocks = blocks_that_part(pendulum, pair)
    assert 1 <= len(blocks) <= 3
    twice = [block for block in blocks for _ in range(2)]
    system = planned(pendulum, twice, "torques")
    parted = isolability(system).worst()
    names = [c.effect for c in system.candidates]
    assert parted.shape == (len(names), len(names))


def test_an_effect_that_no_channel_shows_is_refused(pendulum):
    with pytest.raises(CableSenseError, match="servo_gain"):
        blocks_that_part(pendulum, ("servo_gain", "payload"))


def test_the_picture_is_drawn_as_its_ending_says(found, tmp_path):
    path = tmp_path / "pairs.svg"
    write_picture(path, found, "pendulum")
    assert "<svg" in path.read_text()
    with pytest.raises(ReportError, match="svg or"):
        write_picture(tmp_path / "pairs.pdf", found, "pendulum")
