"""Contacts in base axes and at the joints, and those that explain readings best."""

import numpy as np
import pytest
import torch
from sample_feed import ARM, MECHANISM, UNLOADED, Feed
from scipy.spatial.transform import Rotation

from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.answer import ContactStatics
from cablesense_online.models import load_model
from cablesense_online.plausibility import LARGEST_MISFIT
from cablesense_online.stated_contacts import RestingArm
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.networks.closed_form import ClosedForm, pose_corrections_for

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

POSE = np.random.default_rng(5).uniform(-0.2, 0.2, 8)
CONTACTS = tuple(
    Contact(segment, angle_deg, force_n, float(MECHANISM.contact_m[segment - 1]))
    for segment, angle_deg, force_n in ((2, 70.0, 30.0), (4, 200.0, 12.0))
)


def forces_n(pose_rad):
    return np.sum([normal_force_n(MECHANISM, pose_rad, *contact[:3]) for contact in CONTACTS], 0)


def test_the_wrench_in_base_axes_is_that_of_all_forces_at_their_points():
    wrench = ContactStatics(MECHANISM).at(POSE).base_wrench(CONTACTS)
    forces, points = forces_n(POSE), kinematics.contact_points_m(MECHANISM, POSE)
    np.testing.assert_allclose(wrench[:3], forces.sum(0), atol=1e-9)
    np.testing.assert_allclose(wrench[3:], np.cross(points, forces).sum(0), atol=1e-9)


def test_joint_torques_do_the_work_of_the_forces():
    torques = ContactStatics(MECHANISM).at(POSE).joint_torques_n_m(CONTACTS)
    step = 1e-6 * np.eye(8)
    more, less = (kinematics.contact_points_m(MECHANISM, POSE + s * step) for s in (1, -1))
    work = np.einsum("knx,nx->k", more - less, forces_n(POSE)) / 2e-6
    np.testing.assert_allclose(torques, work, atol=1e-6)


def test_a_contact_pose_is_where_the_force_acts_and_points_along_it():
    contact = CONTACTS[0]
    at = ContactStatics(MECHANISM).at(POSE).contact_pose(contact, 2e-3, 3.0)
    points = kinematics.contact_points_m(MECHANISM, POSE)
    np.testing.assert_allclose(at.point_m, points[contact.segment - 1], atol=1e-12)
    along_force, _, along_segment = Rotation.from_quat(at.quaternion).as_matrix().T
    force_n = normal_force_n(MECHANISM, POSE, *contact[:3])[contact.segment - 1]
    np.testing.assert_allclose(30.0 * along_force, force_n, atol=1e-9)
    covariance = np.reshape(at.covariance, (6, 6))
    place, turn = covariance[:3, :3], covariance[3:, 3:]
    np.testing.assert_allclose(place, np.outer(along_segment, along_segment) * 4e-6, atol=1e-15)
    assert np.trace(turn) == pytest.approx(np.deg2rad(3.0) ** 2)
    assert not covariance[:3, 3:].any()


def test_a_model_of_several_contacts_tells_each_the_strongest_first():
    feed = Feed(load_model("cdsm", "cdsm_multi").estimator, largest_misfit=2.3).tared()
    loaded = solve_equilibrium(MECHANISM, np.zeros(8), forces_n(np.zeros(8))).tensions_n
    answer = feed.sample(loaded)
    assert answer.force in (ForceState.CONTACT, ForceState.UNCONFIRMED)
    assert [contact.segment for contact in answer.contacts] == [2, 4]
    assert answer.contact == answer.contacts[0]
    for found, true in zip(answer.contacts, CONTACTS, strict=True):
        assert found.magnitude_n == pytest.approx(true.magnitude_n, abs=1.5)
        assert found.angle_deg == pytest.approx(true.angle_deg, abs=3.0)
    free = feed.sample(UNLOADED)
    assert free.force is ForceState.FREE
    assert not free.contacts
    assert "readings fit" in feed.estimation.plausibility.status().message
    assert ARM.segment_count + 1 == len(free.probabilities)


@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
def test_the_contacts_that_fit_best_are_those_of_the_exported_closed_form(name):
    """In noise too, with cables slack or not; the prior of forces along costs a little."""
    arm = open_arm(name)
    mechanism, rng = mechanism_of(arm), np.random.default_rng(2)
    spread_n = difference_variance_n2(arm.sensors, 50) ** 0.5
    graph = ClosedForm(mechanism, spread_n**2, pose_corrections_for(mechanism))
    resting = RestingArm(arm, 50)
    for segment in (1, 2, 3, 4):
        command = rng.uniform(-0.1, 0.1, 8)
        angle_deg, size_n = rng.uniform(0.0, 360.0), rng.uniform(10.0, 60.0)
        forces = normal_force_n(mechanism, command, segment, angle_deg, size_n)
        rests = [solve_equilibrium(mechanism, command, each).tensions_n for each in (None, forces)]
        difference_n = rests[1] - rests[0] + rng.normal(0.0, spread_n, 12) * (rests[1] > 1.0)
        resting.command(command)
        estimated = Contact(segment, magnitude_n=size_n)
        (best,), misfit = resting.explained(difference_n, [estimated])
        best_n = best.magnitude_n * np.array(best.direction)
        inputs = (torch.as_tensor(each[None]) for each in (difference_n, command))
        found_n = graph.candidates(graph(*inputs)).force_n
        np.testing.assert_allclose(found_n[0, segment - 1], best_n, atol=0.5 * spread_n)
        true_n = size_n * np.array([np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))])
        np.testing.assert_allclose(best_n, true_n, atol=5.0 * spread_n)
        assert misfit < LARGEST_MISFIT
