"""The pictures of Fig. 10 to 12 are drawn for settings with and without every estimator."""

import pytest

from cablesense_gap.report.style import style
from cablesense_paper.contact_tests import (
    all_settings,
    answered_setting,
    confusion_grid_picture,
    confusion_picture,
    direction_picture,
    error_picture,
    magnitude_picture,
    shown_accuracy,
)
from cablesense_training.baselines import BoostingSettings

pytestmark = pytest.mark.slow  # draws


@pytest.fixture(scope="module")
def tests():
    none = BoostingSettings()
    chosen = [s for s in all_settings() if s.name in ("straight", "tensions_only")]
    return [answered_setting(setting, 128, 0, none) for setting in chosen]


@pytest.mark.parametrize(
    ("draw", "figure"),
    [
        (lambda tests: confusion_picture(tests[0]), "Fig. 10"),
        (lambda tests: confusion_grid_picture(tests[1:]), "Fig. 10"),
        (direction_picture, "Fig. 11"),
        (magnitude_picture, "Fig. 12"),
        (error_picture, "Fig. 12"),
    ],
)
def test_a_picture_names_the_papers_figure(draw, figure, tests):
    with style():
        drawn = draw(tests)
    assert figure in drawn.caption
    assert drawn.png.startswith(b"\x89PNG")
    assert drawn.alt


def test_accuracy_is_said_in_percent():
    assert shown_accuracy(0.99934) == "99.93 %"
