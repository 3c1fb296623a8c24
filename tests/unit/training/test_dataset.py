"""A dataset says the truth: its tensions follow from its labels by the arm's statics."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import (
    cable_jacobian_m,
    contact_jacobians_m,
    contact_torques,
    segment_rotations,
)
from cablesense_sim.loads import contact_angle_deg
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact, MultiContact, SingleContact
from cablesense_training.errors import DatasetError
from tests.helpers.joint_torques import load_torques_n_m


@pytest.fixture(scope="module")
def arm():
    return open_arm("cdsm")


def ideal(arm, protocol=SingleContact, **options):
    return draw_dataset(arm, protocol(samples=500, noise=False, **options), seed=3)


@pytest.mark.parametrize("protocol", [SingleContact, MultiContact])
@pytest.mark.parametrize("pose", ["straight", "random"])
def test_without_contact_and_noise_nothing_changes(arm, protocol, pose):
    dataset = ideal(arm, protocol, pose=pose)
    idle = ~dataset.contacts.any(axis=1)
    assert idle.sum() == pytest.approx(100, abs=2)
    assert not dataset.tension_difference_n[idle].any()
    assert np.abs(dataset.tension_difference_n[~idle]).max(axis=1).min() > 0.0


@pytest.mark.parametrize("protocol", [SingleContact, MultiContact])
def test_cables_balance_the_contacts(arm, protocol):
    """On the stiff arm, which hardly gives way, J'(q) dT is the contacts' joint torque."""
    dataset = ideal(arm, protocol, pose="random")
    mechanism = mechanism_of(arm)
    cables = cable_jacobian_m(mechanism, dataset.command_rad)
    contact = contact_jacobians_m(mechanism, dataset.command_rad)
    torque = np.einsum("bmj,bm->bj", cables, dataset.tension_difference_n)
    expected = np.einsum("bncj,bnc->bj", contact, dataset.forces_n)
    assert np.abs(expected).max() > 10.0
    assert torque == pytest.approx(expected, abs=0.1)
    assert (dataset.slack_cables > 0).any()


def test_contacts_anywhere_balance_the_cables(arm):
    """On the stiff arm the torques of forces at their places are those of the tensions."""
    dataset = ideal(arm, AnywhereContact, pose="random", force_high_n=20.0)
    mechanism = mechanism_of(arm)
    axes = segment_rotations(mechanism, dataset.command_rad)
    at_joint, by_place = contact_torques(mechanism, dataset.command_rad, axes)
    lever = at_joint + dataset.places_m[..., None, None] * by_place
    expected = np.einsum("bncj,bnc->bj", lever, dataset.local_forces_n)
    cables = cable_jacobian_m(mechanism, dataset.command_rad)
    torque = np.einsum("bmj,bm->bj", cables, dataset.tension_difference_n)
    assert np.abs(expected).max() > 2.0
    assert torque == pytest.approx(expected, abs=0.01)
    turned = np.einsum("bnij,bnj->bni", axes, dataset.local_forces_n)
    assert turned == pytest.approx(dataset.forces_n, abs=1e-9)


def test_unloaded_cables_carry_the_weight(arm):
    dataset = ideal(arm, pose="random")
    mechanism = mechanism_of(arm)
    cables = cable_jacobian_m(mechanism, dataset.command_rad)
    torque = np.einsum("bmj,bm->bj", cables, dataset.unloaded_n)
    expected = load_torques_n_m(mechanism, dataset.command_rad)
    assert torque == pytest.approx(expected, abs=0.01)


def test_labels_and_forces_say_the_same(arm):
    dataset = ideal(arm, pose="random")
    touched = dataset.segment > 0
    segment = dataset.segment[touched]
    command = dataset.command_rad[touched]
    forces = dataset.forces_n[touched]
    segment_forces = forces[np.arange(len(forces)), segment - 1]
    assert np.linalg.norm(segment_forces, axis=1) == pytest.approx(dataset.magnitude_n[touched])
    assert np.linalg.norm(forces.sum(axis=1) - segment_forces) == 0.0
    angle = contact_angle_deg(mechanism_of(arm), command, segment, segment_forces)
    turned = (angle - dataset.angle_deg[touched] + 180.0) % 360.0 - 180.0
    assert turned == pytest.approx(0.0, abs=1e-6)
    assert not dataset.forces_n[~touched].any()


@pytest.mark.slow
def test_noise_is_that_of_the_sensor(arm):
    options = {"samples": 4096, "no_contact_fraction": 1.0}
    noisy = draw_dataset(arm, SingleContact(**options), seed=3)
    sensor = arm.sensors
    one = sensor.noise_std_n**2 + sensor.step_n**2 / 12.0
    # one step's rounding is not quite uniform at this noise, hence the wide bound
    assert noisy.tension_difference_n.var() == pytest.approx(one, rel=0.35)
    calm = draw_dataset(arm, SingleContact(noise=False, **options), seed=3)
    assert np.abs(noisy.unloaded_n - calm.unloaded_n).max() < sensor.step_n
    reading = noisy.tension_difference_n + noisy.unloaded_n
    steps = reading / sensor.step_n
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    single = draw_dataset(arm, SingleContact(tare_samples=1, **options), seed=3)
    assert single.unloaded_n.std(axis=0).mean() > 4.0 * noisy.unloaded_n.std(axis=0).mean()


def test_a_case_beyond_the_arm_is_drawn_again_and_marked():
    lab = open_arm("cdsm_lab")
    protocol = SingleContact(
        samples=256, pose="random", noise=False, force_low_n=200.0, force_high_n=240.0
    )
    dataset = draw_dataset(lab, protocol, seed=0)
    redrawn = dataset.redrawn > 0
    assert 0 < redrawn.sum() <= 6
    assert np.isfinite(dataset.tension_difference_n).all()
    shares = dataset.contacts.mean(axis=0)
    assert shares == pytest.approx(0.2, abs=0.01)
    again = draw_dataset(lab, protocol, seed=0)
    assert again.tension_difference_n.tobytes() == dataset.tension_difference_n.tobytes()


def test_a_protocol_beyond_the_arm_is_refused_with_a_case():
    lab = open_arm("cdsm_lab")
    protocol = SingleContact(samples=64, force_low_n=500.0, force_high_n=600.0)
    with pytest.raises(DatasetError, match=r"samples 0 and following: more than 2%.*command"):
        draw_dataset(lab, protocol)


def test_arrays_must_fit_the_arm(arm):
    dataset = ideal(arm)
    with pytest.raises(DatasetError, match=r"unloaded_n has shape \(500, 11\).*need \(500, 12\)"):
        replace(dataset, unloaded_n=dataset.unloaded_n[:, :11])


def test_single_contact_labels_are_refused_for_several(arm):
    with pytest.raises(DatasetError, match="use contacts, angles_deg and magnitudes_n"):
        _ = ideal(arm, MultiContact).segment
