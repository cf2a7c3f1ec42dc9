"""A browser without a window, for pictures of pages and tests of them."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import Any

from drake_nonstop.validation import ScenarioError, require_installed

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def find_browser() -> str:
    """The path of Chromium; raises ScenarioError where it or Playwright is not installed."""
    require_installed("browser", playwright="playwright")
    path = next(filter(None, map(shutil.which, _NAMES)), None)
    if path is None:
        raise ScenarioError(
            f"browser = none: install Chromium, so that one of {', '.join(_NAMES)} can be found"
        )
    return path


@contextlib.contextmanager
def open_browser(width: int, height: int) -> Iterator[Any]:
    """A page (Playwright's) of a headless Chromium that renders 3D without a GPU.

    Raises:
        ScenarioError: Playwright or Chromium is not installed, or does not start.
    """
    path = find_browser()
    from playwright.sync_api import Error, sync_playwright

    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")  # it does not run as root with one
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=path, args=options)
        except Error as error:
            cause = error.message.splitlines()[0]
            raise ScenarioError(f"browser = {path}: install one that starts ({cause})") from None
        try:
            yield browser.new_page(viewport={"width": width, "height": height})
        finally:
            browser.close()
