"""Statics of arm files with effects: exact where the closed form carries them, wary elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from arm_variants import variant

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.networks.closed_form import ClosedForm
from cablesense_training.networks.compact import CompactKinematics
from cablesense_training.networks.second_order import SecondOrderClosedForm
from cablesense_training.networks.statics import exact_statics, statics, unexplained_variance_n2

PAYLOAD = ("payload", "segment_3", {"mass_kg": 0.6})
SOFT = ("cable_stiffness", "arm", {"change": -0.4})
SPRINGS = ("joint_elasticity", "arm", {"stiffness_n_m_rad": 8.0})
CABLES = ("routing_geometry", "segment_2", {"cables_angle_rad": 0.06, "cables_radius_m": 0.002})
PLATES = ("routing_geometry", "segment_3", {"plates_angle_rad": 0.05, "plates_radius_m": -0.001})
CONTACT = ("contact_offset", "segment_2", {"offset_m": 0.02})
TILT = ("base_tilt", "arm", {"roll_rad": 0.2})
TIGHT = ("pretension_error", "cable_7", {"error_n": 12.0})
FRICTION = ("capstan_friction", "arm", {"coefficient": 0.2})
GAIN = ("sensor_gain", "cable_5", {"gain": 0.1})


def listing(*effects, name: str = "cdsm_lab"):
    listed = [{"effect": effect, "at": at, "parameters": p} for effect, at, p in effects]
    return variant({"effects": listed}, name)


def _explained(information, covariance_n2):
    """The evidence for a contact is the misfit that it explains."""
    return information, 0.0 * covariance_n2[..., 0, 0]


@pytest.mark.parametrize(
    "effects",
    [(SPRINGS,), (CABLES,), (PLATES,), (CONTACT, TILT, TIGHT, SOFT),
     (PAYLOAD, SPRINGS, CABLES, PLATES)],
    ids=lambda effects: "+".join(effect[0] for effect in effects),
)  # fmt: skip
def test_contacts_on_an_amended_arm_are_recovered(effects) -> None:
    arm = listing(*effects)
    protocol = SingleContact(
        samples=200, pose="random", pose_range_deg=8.0, force_low_n=5.0, force_high_n=60.0,
        noise=False, no_contact_fraction=0.0,
    )  # fmt: skip
    data = draw_dataset(arm, protocol)
    taut = data.slack_cables == 0
    closed_form, blind = exact_statics(arm, 50), exact_statics(arm.nominal, 50)
    with torch.no_grad():
        inputs = torch.as_tensor(data.tension_difference_n), torch.as_tensor(data.command_rad)
        found, without = closed_form.weigh(*inputs, _explained), blind.weigh(*inputs, _explained)
    assert (found.evidence[:, 0].argmax(1).numpy() + 1 == data.segment)[taut].mean() > 0.99
    rows, place = np.arange(200), data.segment - 1
    theta = np.deg2rad(data.angle_deg)
    truth = data.magnitude_n[:, None] * np.stack([np.sin(theta), np.cos(theta)], axis=-1)
    error = np.linalg.norm(found.force_n.numpy()[rows, place] - truth, axis=-1)[taut]
    worse = np.linalg.norm(without.force_n.numpy()[rows, place] - truth, axis=-1)[taut]
    assert np.median(error) < 0.05
    assert np.median(error) < 0.5 * np.median(worse)


@pytest.mark.parametrize("effect", [CABLES, PLATES])
def test_compact_kinematics_know_every_plate(effect) -> None:
    arm = listing(effect)
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    angles = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 8))
    column = np.concatenate([angles[:, 0::2], angles[:, 1::2]], axis=1)[..., None]
    pose = CompactKinematics(mechanism)(torch.as_tensor(column))
    span = kinematics.spans(mechanism, angles)
    passes = mechanism.passes_joint
    compact = pose.span_m.numpy()[:, 0].swapaxes(1, 2)
    np.testing.assert_allclose(compact[:, passes], span.length_m[:, passes], atol=1e-12)
    jacobian = np.concatenate([span.by_pitch, span.by_yaw], axis=-1)
    np.testing.assert_allclose(pose.jacobian_t_m.numpy().swapaxes(1, 2), jacobian, atol=1e-12)


def test_the_fast_form_is_for_arms_that_it_can_carry() -> None:
    assert isinstance(statics(open_arm("cdsm"), 50), SecondOrderClosedForm)
    assert isinstance(statics(listing(PAYLOAD, name="cdsm"), 50), SecondOrderClosedForm)
    for effect in (SPRINGS, CABLES, PLATES):
        assert isinstance(statics(listing(effect, name="cdsm"), 50), ClosedForm)


@pytest.mark.slow
def test_what_statics_cannot_carry_counts_as_spread() -> None:
    arm = open_arm("cdsm_lab")
    noise = difference_variance_n2(arm.sensors, 50)
    assert unexplained_variance_n2(arm) == 0.0
    assert unexplained_variance_n2(listing(PAYLOAD, CABLES)) == 0.0
    assert exact_statics(arm, 50).reading_variance_n2 == noise
    assert unexplained_variance_n2(listing(GAIN)) == pytest.approx(0.0, abs=1e-9 * noise)
    more = unexplained_variance_n2(listing(FRICTION))
    assert more > noise
    assert exact_statics(listing(FRICTION), 50).reading_variance_n2 == pytest.approx(noise + more)
