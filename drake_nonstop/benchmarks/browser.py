"""A browser without a window, for pictures of pages and tests of them."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import Any

from drake_nonstop.validation import ScenarioError

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextlib.contextmanager
def open_browser(width: int, height: int) -> Iterator[Any]:
    """A page (Playwright's) of a headless Chromium that renders 3D without a GPU.

    Raises:
        ScenarioError: Playwright or Chromium is not installed.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise ScenarioError(
            "browser = none: install Playwright, `pip install playwright`"
        ) from None
    path = next(filter(None, map(shutil.which, _NAMES)), None)
    if path is None:
        raise ScenarioError(
            f"browser = none: install Chromium, so that one of {', '.join(_NAMES)} can be found"
        )
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")  # it does not run as root with one
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=options)
        try:
            yield browser.new_page(viewport={"width": width, "height": height})
        finally:
            browser.close()
