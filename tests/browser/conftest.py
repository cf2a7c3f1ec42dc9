"""A real browser for the pages; where there is none the tests are skipped, or in CI fail."""

import contextlib
import os

import pytest

from drake_nonstop.benchmarks.browser import open_browser
from drake_nonstop.validation import ScenarioError


class Watched:
    """A page, and what it complained of or asked others for."""

    def __init__(self, page):
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))

    def _note(self, message):
        if message.type == "error":
            self.errors.append(message.text)


@contextlib.contextmanager
def page_or_skip():
    try:
        with open_browser(480, 320) as page:
            yield page
    except ScenarioError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))


@pytest.fixture
def watched():
    """A new page of a headless Chromium."""
    with page_or_skip() as page:
        yield Watched(page)


@pytest.fixture
def needs_browser():
    """For a test whose subject opens a browser of its own."""
    with page_or_skip():
        pass
