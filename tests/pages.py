"""A real browser for tests of pages; without one they are skipped, or fail in CI."""

import contextlib
import os

import pytest

from drake_nonstop.benchmarks.browser import open_browser
from drake_nonstop.validation import ScenarioError


class Watched:
    """A page with its errors and its requests."""

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
    """A new page of a headless Chromium."""
    try:
        with open_browser(480, 320) as page:
            yield page
    except ScenarioError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))
