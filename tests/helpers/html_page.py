"""A page as a reader of HTML sees it."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Text, tags and sources of a page, and whether every tag is closed."""

    VOID = ("meta", "img", "source", "br", "!doctype")

    def __init__(self, html):
        super().__init__()
        self.text = ""
        self.sources = []
        self.open = []
        self.h1 = ""
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "srcset", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text += data
        if "h1" in self.open:
            self.h1 += data


def draw_no_pictures(monkeypatch):
    """Reports of diagnoses have empty pictures, which would take seconds to draw."""
    for name in ("arm", "overlay", "time"):
        monkeypatch.setattr(f"cablesense_gap.report.page.{name}_picture", lambda *_: "data:")


def show_no_film(monkeypatch):
    """Reports of robots have a line in place of a film, which would take seconds to render."""
    from cablesense_gap.report.film import FilmError

    def refused(_diagnosis):
        raise FilmError("none is wanted")

    monkeypatch.setattr("cablesense_gap.report.film.robot_film", refused)
