"""Sizes over decades, what implausible ones cost, and verdicts that are stated with doubts."""

import numpy as np
import pytest
from two_link import recorded, write_model

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Gap

LIFT = """<mujoco><worldbody>
<body name="column"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
<body name="carriage" pos="0.3 0 0"><joint name="reach" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return load_robot(write_model(tmp_path_factory.mktemp("robot")))


@pytest.fixture(scope="module")
def system(tmp_path_factory, robot):
    path = recorded(tmp_path_factory.mktemp("recording") / "recording.csv", trials=5)
    return RobotSystem(robot, prepared(read_recording(path, robot), robot), {})


def lifted(tmp_path, payload_kg):
    """A lift and a slide on it, with a payload on the latter."""
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    rng, parts = np.random.default_rng(3), []
    time_s = np.arange(0.0, 4.0, 0.01)
    for trial in range(5):
        at, w = rng.uniform(0.0, 6.0, 2), 2.0 * np.pi * rng.uniform(0.3, 0.9, 2)
        wave = 0.1 * np.sin(w * time_s[:, None] + at)
        force = -(w**2) * wave * [2.5 + payload_kg, 0.5 + payload_kg]
        force += [9.81 * (2.5 + payload_kg), 0.0]
        parts.append((time_s, np.full(400, trial), wave, force))
    time_s, trial, position, force = map(np.concatenate, zip(*parts, strict=True))
    force += 0.02 * rng.standard_normal(force.shape)
    recording = RobotRecording("lift", time_s, trial, position, force, np.empty((2000, 0)))
    return recording, load_robot(path)


@pytest.mark.slow  # whole searches
@pytest.mark.parametrize("payload_kg", [0.1, 5.0])
def test_payloads_are_found_and_sized_over_decades_on_slides(tmp_path, payload_kg):
    """On a slide the mass of its link, 0.5 kg, is the same."""
    verdict = diagnose(*lifted(tmp_path, payload_kg)).verdict
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
        ({("payload", "lower", "mass_kg"): 6.0}, 0.9, "The mass of lower is 13.0 times"),
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
        before_n=10.0, after_n=2.0, floor_n=1.0, removed_fraction=removed, ci95=(0.0, 1.0),
        by_cable_n=(),
    )  # fmt: skip
    doubts = system.doubts({Term(*term): value for term, value in values.items()}, gap)
    assert len(doubts) == (says is not None)
    assert says is None or says in doubts[0]
