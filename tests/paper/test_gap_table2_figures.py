"""The pictures of Table II's gap: one panel a load, axes with units."""

import matplotlib.pyplot as plt
import pytest
from table2_diagnosis import diagnosed

from cablesense_gap.report.style import style
from cablesense_paper.table_2_text import gap_figure, paper_figure, proportion_figure

pytestmark = pytest.mark.slow  # the diagnosis behind them


@pytest.mark.parametrize(
    ("draw", "panels"), [(gap_figure, 6), (proportion_figure, 1), (paper_figure, 1)]
)
def test_a_picture_shows_the_numbers_with_their_unit(draw, panels):
    with style():
        figure = draw(diagnosed())
        labels = [axes.get_ylabel() for axes in figure.axes] + [figure.get_supylabel()]
    assert len(figure.axes) == panels
    assert any(label.endswith("N") for label in labels)
    plt.close(figure)


def test_bars_are_the_gap():
    with style():
        figure = gap_figure(diagnosed())
    drawn = [bar.get_height() for axes in figure.axes for bar in axes.patches]
    assert drawn == pytest.approx(list(diagnosed().gap_n.ravel()))
    plt.close(figure)
