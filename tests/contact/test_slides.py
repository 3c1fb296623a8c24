"""Where cables slide, by the changes of their readings."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_contact.calibration import parameters_of
from cablesense_contact.slides import Belief, CableSlides, directions_along, directions_since
from cablesense_sim.arm import open_arm

PARAMETERS = parameters_of(open_arm("cdsm_lab"))
SLIDES = CableSlides(PARAMETERS)
COUNT = len(PARAMETERS)


def known() -> Belief:
    """Everything is correlated with everything, where it is uncertain."""
    mixed = np.eye(COUNT) + 0.1
    return Belief(
        PARAMETERS.prior_mean, np.outer(PARAMETERS.prior_std, PARAMETERS.prior_std) * mixed
    )


def of_cable(cable: int) -> np.ndarray:
    """Positions of the slides of a cable, from 1 on, that exist."""
    found = [
        part.start + cable - 1
        for name, part in PARAMETERS.slices.items()
        if name.startswith("slide") and PARAMETERS.prior_std[part.start + cable - 1] > 0.0
    ]
    return np.array(found)


def test_a_cable_that_moved_slides_and_the_others_stay_as_they_were():
    direction = np.zeros(12, dtype=np.int8)
    direction[[0, 4]] = 1, -1
    before = known()
    after = SLIDES.sliding(before, direction)
    moved = np.concatenate([of_cable(1), of_cable(5)])
    others = np.setdiff1d(np.arange(COUNT), moved)
    assert len(of_cable(1)) < len(of_cable(12))
    assert_allclose(after.mean[of_cable(1)], 1.0)
    assert_allclose(after.mean[of_cable(5)], -1.0)
    assert (np.sqrt(after.covariance[moved, moved]) < 0.2).all()
    assert_allclose(after.covariance[np.ix_(moved, others)], 0.0)
    assert_array_equal(
        after.covariance[np.ix_(others, others)], before.covariance[np.ix_(others, others)]
    )
    assert SLIDES.sliding(before, np.zeros(12, dtype=np.int8)) is before


def test_after_a_breath_no_guide_holds_anything():
    after = SLIDES.freed(known())
    for cable in range(1, 13):
        assert_allclose(after.mean[of_cable(cable)], 0.0)
        assert (np.sqrt(after.covariance[of_cable(cable), of_cable(cable)]) < 0.1).all()


def test_a_direction_lasts_until_the_reading_turns_back():
    readings = np.array([[0.0, 0.5, 3.0, 5.0, 4.8, 3.5, 3.6, 6.0, -2.0]]).T
    along = directions_along(readings, np.zeros(1), 1.0)[:, 0]
    assert_array_equal(along, [0, 0, 1, 1, 1, -1, -1, 1, -1])
    assert_array_equal(directions_since(readings[:, 0], 1.0), [0, 0, 1, 1, 1, 1, 1, 1, -1])
