"""The contact-angle convention: from angle and magnitude to a force and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import LoadError, contact_angle_deg, normal_force_n

MECHANISM = mechanism_of(open_arm("cdsm"))
STRAIGHT = np.zeros(8)


@pytest.mark.parametrize(
    ("angle_deg", "direction"),
    [(0, [0, 0, 1]), (90, [0, 1, 0]), (180, [0, 0, -1]), (270, [0, -1, 0]), (-90, [0, -1, 0])],
)
def test_the_angle_counts_from_up_to_left(angle_deg: float, direction: list[float]) -> None:
    forces = normal_force_n(MECHANISM, STRAIGHT, 2, angle_deg, 10.0)
    expected = np.zeros((4, 3))
    expected[1] = 10.0 * np.array(direction)
    np.testing.assert_allclose(forces, expected, atol=1e-12)


angles = st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8)


@settings(max_examples=60, deadline=None)
@given(
    command=angles,
    segment=st.integers(1, 4),
    angle_deg=st.floats(-1000.0, 1000.0),
    magnitude_n=st.floats(1e-3, 1e4),
)
def test_there_and_back(
    command: list[float], segment: int, angle_deg: float, magnitude_n: float
) -> None:
    forces = normal_force_n(MECHANISM, command, segment, angle_deg, magnitude_n)
    force = forces[segment - 1]
    assert np.count_nonzero(forces.any(axis=-1)) == 1
    assert np.linalg.norm(force) == pytest.approx(magnitude_n)
    axis = kinematics.segment_rotations(MECHANISM, np.array(command))[segment - 1, :, 0]
    assert axis @ force == pytest.approx(0.0, abs=1e-9 * magnitude_n)
    back = float(contact_angle_deg(MECHANISM, command, segment, force))
    assert 0.0 <= back < 360.0
    assert abs((back - angle_deg + 180.0) % 360.0 - 180.0) < 1e-6


def test_batches_are_their_rows() -> None:
    rng = np.random.default_rng(3)
    command = rng.uniform(-0.3, 0.3, (5, 6, 8))
    segment = rng.integers(0, 5, (5, 6))
    angle = rng.uniform(0, 360, (5, 6))
    forces = normal_force_n(MECHANISM, command, segment, angle, 7.0)
    assert forces.shape == (5, 6, 4, 3)
    for i in np.ndindex(5, 6):
        alone = normal_force_n(MECHANISM, command[i], segment[i], angle[i], 7.0)
        np.testing.assert_array_equal(forces[i], alone)
    touched = segment > 0
    back = contact_angle_deg(
        MECHANISM, command[touched], segment[touched], forces[touched, segment[touched] - 1]
    )
    np.testing.assert_allclose(back, angle[touched], atol=1e-9)


@pytest.mark.parametrize(
    ("segment", "angle_deg", "magnitude_n", "words"),
    [
        (5, 0.0, 1.0, "from 0 .* to 4"),
        (-1, 0.0, 1.0, "from 0 .* to 4"),
        (1.5, 0.0, 1.0, "whole number"),
        (1, np.nan, 1.0, "angle_deg"),
        (1, np.inf, 1.0, "angle_deg"),
        (1, 0.0, -1.0, "magnitude_n"),
        (1, 0.0, np.nan, "magnitude_n"),
        ([1, 9], 0.0, 1.0, "from 0 .* to 4"),
    ],
)
def test_impossible_contacts_are_refused(
    segment: object, angle_deg: float, magnitude_n: float, words: str
) -> None:
    with pytest.raises(LoadError, match=words):
        normal_force_n(MECHANISM, STRAIGHT, segment, angle_deg, magnitude_n)
