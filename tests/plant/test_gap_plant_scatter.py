"""What the workshop leaves on every arm of the plant."""

import numpy as np
import pytest
from gap_plant import NOMINAL

from cablesense_gap.plant.arm import ideal_arm, scattered

DRAWN = ideal_arm(NOMINAL)
ARMS = [scattered(DRAWN, np.random.default_rng(seed)) for seed in range(300)]


def angles_deg(holes: np.ndarray) -> np.ndarray:
    return np.rad2deg(np.arctan2(holes[..., 1], holes[..., 2]))


def test_sizes_are_those_of_a_careful_workshop() -> None:
    masses = np.array([arm.body.mass_kg / 0.5 - 1.0 for arm in ARMS])
    pretensions = np.array([arm.body.pretension_n - 50.0 for arm in ARMS])
    contacts = np.array([arm.body.contact_at_m[:, 0] - 0.065 for arm in ARMS])
    zeros = np.array([arm.sensing.offset_n for arm in ARMS])
    holes = np.array([angles_deg(arm.body.after_m) for arm in ARMS])
    turned = (holes - angles_deg(DRAWN.body.after_m) + 180.0) % 360.0 - 180.0
    for found, sigma in (
        (masses, 0.005),
        (pretensions, 0.15),
        (contacts, 0.0003),
        (turned, 0.05),
        (zeros, 0.05),
    ):
        assert found.std() == pytest.approx(sigma, rel=0.1)
        assert abs(found.mean()) < 0.15 * sigma


def test_a_cable_keeps_its_radius_and_one_angle() -> None:
    body = ARMS[0].body
    np.testing.assert_allclose(np.linalg.norm(body.after_m[..., 1:], axis=-1), 0.05)
    np.testing.assert_allclose(body.after_m[..., 1:], body.before_m[..., 1:])
