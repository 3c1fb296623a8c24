"""What a study gives."""

import pytest

from cablesense_gap.report.style import style
from cablesense_paper.study import PRINT_DPI, Agreement, picture


@pytest.mark.parametrize(
    ("ours", "theirs", "agreement"),
    [(1.0, 1.1, Agreement.YES), (1.0, 1.2, Agreement.NO), (float("nan"), 1.0, Agreement.NO)],
)
def test_two_numbers_agree_within_a_tolerance(ours, theirs, agreement):
    assert Agreement.within(ours, theirs, 0.1001) is agreement


def test_a_picture_is_a_png_in_a_resolution_for_print():
    with style():
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(3.0, 2.0))
        made = picture("name", figure, "caption", "alt")
    assert made.png.startswith(b"\x89PNG")
    assert int.from_bytes(made.png[16:20], "big") == round(3.0 * PRINT_DPI)
    assert plt.get_fignums() == []
