"""A report as a browser reads it."""

import re
from html.parser import HTMLParser

VOID = {"br", "circle", "image", "line", "link", "meta", "path", "use", "rect"}


class Page(HTMLParser):
    """Text, ids and addresses of a page; complains about tags that do not match."""

    def __init__(self, html: str):
        super().__init__()
        self.open, self.text, self.ids, self.addresses = [], "", [], []
        self.feed(html)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        for key, value in attrs:
            if key == "id":
                self.ids.append(value)
            elif key in ("src", "href", "xlink:href"):
                self.addresses.append(value)

    def handle_startendtag(self, tag, attrs):
        if tag not in VOID:
            return
        self.handle_starttag(tag, attrs)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag, tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text += data


def read(html: str) -> Page:
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    # One file: everything it refers to is inside.
    assert all(a.startswith(("#", "data:")) for a in page.addresses)
    assert {a[1:] for a in page.addresses if a.startswith("#")} <= set(page.ids)
    assert "<script" not in html and "http" not in re.sub(r"base64,[\w+/=\s]*", "", html)
    assert "nan" not in page.text.replace("nances", "").lower().split() and "None" not in page.text
    assert len(html) < 2e6
    return page


def undraw(monkeypatch) -> None:
    """Figures of reports are laid out but not drawn, which takes most of a page's time: where nothing looks at them."""
    monkeypatch.setattr("bayesid.report.figures.to_svg", lambda figure, name: f"<svg><text>{name}</text></svg>")
