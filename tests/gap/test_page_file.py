"""The frame that all pages share: one style."""

from cablesense_gap.report.style import page_css, rendered


def test_the_style_is_in_every_page():
    assert "figure img" in page_css()
    content = {"quick": False, "outcomes": [], "failed": [], "seconds": 0.0, "agreements": []}
    content |= {"with_paper": {}, "otherwise": {"yes": 0}}
    page = rendered("cablesense_paper", "paper.html", content, {"figure": str})
    assert page_css() in page
