"""Errors are drawn for every architecture, as means and seed by seed."""

import matplotlib.pyplot as plt
import pytest
from network_findings import made_up

from cablesense_gap.report.style import style
from cablesense_paper import network_trials
from cablesense_paper.network_findings import ARCHITECTURES
from cablesense_paper.network_trials import compared_picture, cost_picture, depth_picture

pytestmark = pytest.mark.slow  # draws


@pytest.fixture
def drawn(monkeypatch):
    """Draws a picture and gives its figure, before it is made a file of."""

    def figure_of(draw):
        kept = []
        monkeypatch.setattr(
            network_trials, "picture", lambda name, figure, *texts: kept.append(figure)
        )
        with style():
            draw(made_up(1.0))
        (figure,) = kept
        return figure

    yield figure_of
    plt.close("all")


def _names(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("draw", [compared_picture, cost_picture])
def test_every_architecture_is_in_the_legend_once(draw, drawn):
    assert _names(drawn(draw)) == list(ARCHITECTURES)


def test_every_depth_is_in_the_legend_beside_the_papers_figure(drawn):
    assert _names(drawn(depth_picture)) == ["1 layer", "2 layers", "the paper’s figure"]


def test_the_line_is_the_mean_of_the_seeds_which_are_its_dots(drawn):
    direction = drawn(depth_picture).axes[1]
    paper, line, *dots = direction.lines[:6]
    assert set(paper.get_ydata()) == {5.96}
    assert list(line.get_xdata()) == [4, 8]
    assert list(line.get_ydata()) == pytest.approx([4.2, 2.1])
    assert [tuple(dot.get_xydata()[0]) for dot in dots] == [
        pytest.approx(at) for at in ((4, 4.0), (4, 4.4), (8, 2.0), (8, 2.2))
    ]


def test_a_picture_becomes_a_file():
    before = plt.get_fignums()
    with style():
        picture = cost_picture(made_up(1.0))
    assert picture.png.startswith(b"\x89PNG")
    assert "at 2 layers" in picture.caption
    assert plt.get_fignums() == before
