"""Two references of cables over guides: closed forms, work, symmetry, one beside the other."""

from collections.abc import Callable

import numpy as np
import pytest
from friction_law import divided, random_history, searched, tensions_by_law, timed
from hypothesis import given, settings
from hypothesis import strategies as st

Way = Callable[..., np.ndarray]

K = np.array([2e5, 5e5, 3e5])
GRIP = np.array([0.3, 0.2])
WAYS = pytest.mark.parametrize(("way", "close"), [(searched, 1e-9), (timed, 0.01)])


def pulled(amount_m: np.ndarray, piece: int, pieces: int = 3) -> np.ndarray:
    """Stretch of an even cable of which one piece lengthens."""
    return 50.0 / K[:pieces] + np.outer(amount_m, np.eye(pieces)[piece])


@WAYS
def test_one_guide_holds_back_e_to_the_grip_either_way(way: Way, close: float) -> None:
    stretch = pulled(np.array([0.0, 2e-4, 0.0]), 0, 2)
    tension = way(K[:2], GRIP[:1], stretch)
    np.testing.assert_allclose(tension[1, 0] / tension[1, 1], np.exp(0.3), rtol=close)
    np.testing.assert_allclose(tension[2, 0] / tension[2, 1], np.exp(-0.3), rtol=close)


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_both_ways_agree_and_a_cable_may_be_turned_round(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 10)
    steps = divided(stretch, 8)
    one = searched(stiffness, grip, steps)[::8]
    mirrored = searched(stiffness[::-1], grip[::-1], steps[:, ::-1])[::8]
    np.testing.assert_allclose(mirrored[:, ::-1], one, atol=1e-5)
    # what is too much at a sliding guide goes with the speed, so with one over the steps
    fast, slow = (timed(stiffness, grip, stretch, steps) for steps in (1500, 3000))
    assert np.abs(2.0 * slow - fast - one).max() < 0.005 * np.ptp(one)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_law_of_the_simulator_finds_what_the_search_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 12)
    expected = searched(stiffness, grip, stretch)
    np.testing.assert_allclose(tensions_by_law(stiffness, grip, stretch), expected, atol=1e-6)
