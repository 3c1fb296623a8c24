"""The frame that all pages share: one style, written whole or not at all."""

import pytest

from cablesense_gap.report.style import ReportError, page_css, rendered, write_whole


def test_the_style_is_in_every_page():
    assert "figure img" in page_css()
    content = {"quick": False, "outcomes": [], "failed": [], "seconds": 0.0, "agreements": []}
    content |= {"with_paper": {}, "otherwise": {"yes": 0}}
    page = rendered("cablesense_paper", "paper.html", content, {"figure": str})
    assert page_css() in page


def test_a_page_is_written_whole(tmp_path):
    write_whole(tmp_path / "page.html", "<p>µ</p>")
    write_whole(tmp_path / "page.html", "<p>θ</p>")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == "<p>θ</p>"


def test_a_place_that_cannot_be_written_to_is_told(tmp_path):
    with pytest.raises(ReportError, match="cannot be written"):
        write_whole(tmp_path / "none" / "page.html", "")
