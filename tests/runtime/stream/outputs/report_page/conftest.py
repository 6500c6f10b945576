"""A page as a test reads it."""

from html.parser import HTMLParser

import pytest


class Page(HTMLParser):
    """Texts of a page, and whatever it would load."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.links, self.tags = [], [], []
        self.feed(text)
        assert self.tags == [], "every tag is closed"

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "link", "img", "br"):
            self.tags.append(tag)
        for name, value in attributes:
            if name in ("src", "href", "srcset", "data", "xlink:href", "action"):
                self.links.append(value)

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.tags.pop() == tag

    def handle_data(self, data):
        if text := data.strip():
            self.texts.append(text)

    def after(self, label):
        """The text that follows a label."""
        return self.texts[self.texts.index(label) + 1]


@pytest.fixture
def read_page():
    """Read the source of a page."""
    return Page
