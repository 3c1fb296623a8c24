"""When a push on segment 2 gives its moment alone: near joint 2, and nowhere else on it."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_contact import Calibrator, ContactState, LawModel, find_model
from cablesense_contact.felt_arm import FeltArm
from cablesense_sim.arm import open_arm
from cablesense_sim.built_arm import as_described
from cablesense_training.evaluation.law import KnownArm, law_protocol
from cablesense_training.evaluation.touches import (
    drawn_touches,
    settled_readings_n,
    unloaded_readings,
)

ARM = open_arm("cdsm_lab")


@pytest.mark.parametrize("bend_deg", [1.0, 8.0])
def test_the_outer_two_thirds_of_segment_2_give_place_and_force(bend_deg):
    law = LawModel(find_model("cdsm_lab_anywhere"), ARM)
    rng = np.random.default_rng(0)
    poses = unloaded_readings(ARM, as_described(ARM), np.deg2rad(10.0), rng)
    calibrator = Calibrator(FeltArm(ARM), law)
    tared = calibrator.updated(calibrator.by_tolerances(), poses[0])
    protocol = replace(
        law_protocol(ARM, 300, no_contact_fraction=0.0),
        pose_range_deg=bend_deg,
        force_low_n=20.0,
        force_high_n=25.0,
        two_contacts_fraction=0.0,
    )
    touches = drawn_touches(ARM, protocol, seed=4)
    touches = touches.select(touches.contacts[:, 1])
    read_n = settled_readings_n(ARM, touches, rng)
    stated = KnownArm(law, ARM, tared).stated(np.stack([read_n, read_n]), touches.command_rad)
    outer = touches.place_m[:, 1] > ARM.segments.length_m / 3.0
    states = stated.state
    assert (states[outer] == ContactState.CONTACT).mean() > 0.95
    assert (states[~outer] == ContactState.MOMENT).any()
