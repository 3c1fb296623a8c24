"""Statics of arm files with effects: exact where the closed form carries them, wary elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from arm_variants import variant

from cablesense_sim.arm import open_arm
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.networks import statics as statics_of_arms
from cablesense_training.networks.closed_form import NearCommand
from cablesense_training.networks.statics import statics, unexplained_variance_n2

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
    closed_form, blind = statics(arm, 50), statics(arm.nominal, 50)
    with torch.no_grad():
        inputs = torch.as_tensor(data.tension_difference_n), torch.as_tensor(data.command_rad)
        found, without = (each.candidates(each(*inputs)) for each in (closed_form, blind))
    assert (found.explained.argmax(1).numpy() + 1 == data.segment)[taut].mean() > 0.99
    rows, place = np.arange(200), data.segment - 1
    theta = np.deg2rad(data.angle_deg)
    truth = data.magnitude_n[:, None] * np.stack([np.sin(theta), np.cos(theta)], axis=-1)
    error = np.linalg.norm(found.force_n.numpy()[rows, place] - truth, axis=-1)[taut]
    worse = np.linalg.norm(without.force_n.numpy()[rows, place] - truth, axis=-1)[taut]
    assert np.median(error) < 0.05
    assert np.median(error) < 0.5 * np.median(worse)


def test_the_fast_form_is_for_arms_that_it_can_carry() -> None:
    assert isinstance(statics(open_arm("cdsm"), 50), NearCommand)
    assert isinstance(statics(listing(PAYLOAD, name="cdsm"), 50), NearCommand)
    assert not isinstance(statics(open_arm("cdsm_lab"), 50), NearCommand)
    for effect in (SPRINGS, CABLES, PLATES):
        assert not isinstance(statics(listing(effect, name="cdsm"), 50), NearCommand)


@pytest.mark.slow
def test_what_statics_cannot_carry_counts_as_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statics_of_arms, "_JUDGED_SAMPLES", 32)
    arm = open_arm("cdsm_lab")
    noise = difference_variance_n2(arm.sensors, 50)
    assert unexplained_variance_n2(arm) == 0.0
    assert unexplained_variance_n2(listing(PAYLOAD, CABLES)) == 0.0
    assert statics(arm, 50).reading_variance_n2 == noise
    assert unexplained_variance_n2(listing(GAIN)) == pytest.approx(0.0, abs=1e-9 * noise)
    more = unexplained_variance_n2(listing(FRICTION))
    assert more > noise
    assert statics(listing(FRICTION), 50).reading_variance_n2 == pytest.approx(noise + more)
