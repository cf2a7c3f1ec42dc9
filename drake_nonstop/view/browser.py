"""A browser without a window, which takes pictures of replays and other pages."""

import asyncio
import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from drake_nonstop.validation import ScenarioError, require_installed

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def outside_event_loop(use_browser: Callable[[], Any]) -> Any:
    """The result of a function that opens a browser, also in a notebook.

    A thread with a running event loop, as a notebook's, cannot wait for a browser: another does.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return use_browser()
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(use_browser).result()


@contextlib.contextmanager
def open_browser(width: int, height: int) -> Iterator[Any]:
    """A page (Playwright's), in pixels, of a headless Chromium that renders 3D without a GPU.

    It is the machine's, or where there is none the one that Playwright has installed.

    Raises:
        ScenarioError: Playwright or Chromium is not installed, or does not start.
    """
    require_installed("browser", playwright="drake-nonstop[video]")
    from playwright.sync_api import Error, sync_playwright

    path = next(filter(None, map(shutil.which, _NAMES)), None)
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")  # it does not run as root with one
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=path, args=options)
        except Error as error:
            remedy = "install one that starts, `playwright install chromium`"
            cause = error.message.splitlines()[0]
            raise ScenarioError(f"browser = {path or 'none'}: {remedy} ({cause})") from None
        try:
            yield browser.new_page(viewport={"width": width, "height": height})
        finally:
            browser.close()
