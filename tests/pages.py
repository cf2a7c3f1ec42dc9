"""A page of a real browser, which records its errors; tests are skipped where there is none."""

import contextlib
import os

import pytest

from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.browser import open_browser


class WatchedPage:
    """A page, its errors, and the addresses that it asked for."""

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
    """A new page of a headless Chromium; without one the test is skipped, or in CI fails."""
    try:
        with open_browser(480, 320) as page:
            yield page
    except ScenarioError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))
