"""Sizes over decades, what implausible ones cost, and verdicts that are stated with doubts."""

import numpy as np
import pytest
from robot_sets import lifted

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Gap
from tests.helpers.two_link import recorded, write_model


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return load_robot(write_model(tmp_path_factory.mktemp("robot")))


@pytest.fixture(scope="module")
def system(tmp_path_factory, robot):
    path = recorded(tmp_path_factory.mktemp("recording") / "recording.csv", trials=5)
    return RobotSystem(robot, prepared(read_robot_recording(path, robot), robot), {})


@pytest.mark.slow  # whole searches
@pytest.mark.parametrize("payload_kg", [0.1, 5.0])
def test_payloads_are_found_and_sized_over_decades_on_slides(tmp_path, payload_kg):
    """On a slide the mass of its link, 0.5 kg, is the same."""
    path, recording = lifted(payload_kg / 0.5, np.random.default_rng(3), tmp_path)
    verdict = diagnose(recording, load_robot(path)).verdict
    assert "payload" in (verdict.ambiguity_group or verdict.effects)
    assert verdict.where.bodies == ("carriage",)
    as_payload = verdict.effects == ("payload",)
    size = verdict.parameters["payload.mass_kg" if as_payload else "link_mass.share"]
    truth = payload_kg if as_payload else payload_kg / 0.5
    assert size.value == pytest.approx(truth, rel=0.1)
    assert size.ci95[0] < truth < size.ci95[1]


@pytest.mark.parametrize(
    ("values", "removed", "says"),
    [
        ({("torque_scale", "elbow", "share"): -0.9}, 0.9, "share ends at its bound of -0.9"),
        ({("link_mass", "lower", "share"): 3.0}, 0.9, "share ends at its bound of 3"),
        ({("payload", "lower", "mass_kg"): 6.0}, 0.9, "6 kg are added to lower, which has 0.5 kg"),
        ({("rotor_inertia", "elbow", "inertia_kg_m2"): 0.1}, 0.9, "The inertia of elbow is"),
        ({("joint_friction", "elbow", "torque_n_m"): 0.1}, 0.4, "leaves 60% of the gap"),
        ({("joint_friction", "elbow", "torque_n_m"): 0.1}, 0.9, None),
        ({("payload", "lower", "mass_kg"): 4.0}, 0.9, None),
    ],
)
def test_a_verdict_is_doubtful_at_bounds_far_from_the_model_and_if_much_is_left(
    system, values, removed, says
):
    gap = Gap(
        before_n=10.0,
        after_n=2.0,
        floor_n=1.0,
        removed_fraction=removed,
        ci95=(0.0, 1.0),
        by_cable_n=(),
    )
    doubts = system.doubts({Term(*term): value for term, value in values.items()}, gap)
    assert len(doubts) == (says is not None)
    assert says is None or says in doubts[0]
