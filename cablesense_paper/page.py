"""The report as a page that needs nothing beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from cablesense_gap.report.figure_style import WIDTH_IN, image_uri
from cablesense_gap.report.page_file import rendered
from cablesense_paper.running import Outcome
from cablesense_paper.study_result import PAPER, PRINT_DPI, Agreement, Picture


def paper_page(outcomes: Sequence[Outcome], quick: bool) -> str:
    """The report as HTML text."""
    return rendered("cablesense_paper", "paper.html", _content(outcomes, quick), {"figure": shown})


def shown(value: float | str) -> str:
    """A number to four digits, with a true minus sign; words as they are."""
    if isinstance(value, str):
        return value
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.4g}"
    else:
        mantissa, _, exponent = f"{value:.3e}".partition("e")
        text = f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
    return text.replace("-", "−")


def _content(outcomes: Sequence[Outcome], quick: bool) -> dict[str, Any]:
    comparisons = [
        comparison
        for outcome in outcomes
        if outcome.result
        for comparison in outcome.result.comparisons
    ]
    with_paper = Counter(c.agreement for c in comparisons if c.source == PAPER)
    otherwise = Counter(c.agreement for c in comparisons if c.source != PAPER)
    return {
        "quick": quick,
        "outcomes": [(outcome, _pictures(outcome)) for outcome in outcomes],
        "failed": [outcome.study for outcome in outcomes if outcome.failure],
        "seconds": sum(outcome.seconds for outcome in outcomes),
        "agreements": list(Agreement),
        "with_paper": with_paper,
        "otherwise": otherwise,
    }


def _pictures(outcome: Outcome) -> list[tuple[Picture, str, int]]:
    """Each with its data, and how much of the page's width it takes, in percent."""
    if outcome.result is None:
        return []
    return [
        (
            picture,
            image_uri(picture.png, "png"),
            min(100, round(100.0 * _width_in(picture) / WIDTH_IN)),
        )
        for picture in outcome.result.pictures
    ]


def _width_in(picture: Picture) -> float:
    """Width on paper; a PNG has its width in pixels after 16 bytes of signature and header."""
    return int.from_bytes(picture.png[16:20], "big") / PRINT_DPI
