"""The reference of cables over guides: closed form, symmetry, and the simulator's law."""

import numpy as np
from friction_law import random_history, searched, tensions_by_law
from hypothesis import given, settings
from hypothesis import strategies as st


def test_one_guide_holds_back_e_to_the_grip_either_way() -> None:
    stiffness_n_m = np.array([2e5, 5e5])
    pulled_m = np.array([0.0, 2e-4, 0.0])
    stretch_m = 50.0 / stiffness_n_m + np.outer(pulled_m, [1.0, 0.0])
    _, out, back = searched(stiffness_n_m, np.array([0.3]), stretch_m)
    np.testing.assert_allclose(out[0] / out[1], np.exp(0.3), rtol=1e-9)
    np.testing.assert_allclose(back[0] / back[1], np.exp(-0.3), rtol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_cable_may_be_turned_round(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 10)
    mirrored = searched(stiffness[::-1], grip[::-1], stretch[:, ::-1])
    np.testing.assert_allclose(mirrored[:, ::-1], searched(stiffness, grip, stretch), atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_law_of_the_simulator_finds_what_the_search_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 12)
    expected = searched(stiffness, grip, stretch)
    np.testing.assert_allclose(tensions_by_law(stiffness, grip, stretch), expected, atol=1e-6)
