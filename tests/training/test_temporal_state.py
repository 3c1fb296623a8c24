"""The state of a model with memory: its parts, and what a tare leaves of it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cablesense_training.inference.temporal_estimator import TemporalState


@given(st.integers(0, 200), st.integers(1, 4), st.integers(1, 8))
def test_parts_are_known_from_the_whole_size(hidden, gives, segments):
    layout = TemporalState(hidden, 3 * segments * gives, 3 * segments, 2 * segments)
    again = TemporalState.of_size(layout.size, hidden, 3 * segments, 2 * segments)
    assert again == layout


def test_a_tare_forgets_what_was_heard_and_keeps_what_was_drawn():
    layout = TemporalState(hidden=3, shares=4, cables=2, joints=2)
    state = np.arange(1.0, layout.size + 1)[None]
    hidden, shares, lengths, set_point, shares_then, set_point_then, known = np.split(
        layout.tared(state)[0], np.cumsum(layout.parts)[:-1]
    )
    assert (hidden == 0.0).all()
    np.testing.assert_array_equal(shares, [4, 5, 6, 7])
    np.testing.assert_array_equal(lengths, [8, 9])
    np.testing.assert_array_equal(shares_then, shares)
    np.testing.assert_array_equal(set_point_then, set_point)
    assert known == state[0, -1]
