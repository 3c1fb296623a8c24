"""Shares in a confusion matrix are rounded so that only all is 100."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_gap.report.style import style
from cablesense_paper.drawing import draw_confusion, shown_share


@pytest.mark.parametrize(
    ("percent", "text"),
    [(100.0, "100"), (99.99, "99.9"), (98.34, "98.3"), (1.66, "1.7"), (0.049, "0.05")],
)
def test_a_share_is_short(percent, text):
    assert shown_share(percent) == text


@given(st.floats(0.01, 100.0, exclude_max=True))
def test_only_all_is_100(percent):
    assert shown_share(percent) != "100"
    assert float(shown_share(percent)) == pytest.approx(percent, rel=0.05, abs=0.1)


def test_cells_have_the_share_of_their_row_and_empty_ones_no_text():
    with style():
        figure, axes = plt.subplots()
        draw_confusion(axes, np.array([[8, 0], [1, 3]]), ("no", "yes"))
    texts = {text.get_position(): text.get_text() for text in axes.texts}
    assert texts == {(0, 0): "100", (0, 1): "25.0", (1, 1): "75.0"}
    plt.close(figure)
