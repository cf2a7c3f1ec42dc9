"""Fixtures; this file also makes `helpers` importable from the folders below."""

import numpy as np
import pytest
from pages import Watched, page_or_skip


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run and for every test."""
    return np.random.default_rng(20240607)


@pytest.fixture
def watched():
    """A page of a headless browser, with its errors and requests."""
    with page_or_skip() as page:
        yield Watched(page)


@pytest.fixture
def needs_browser():
    """For a test of what opens a browser itself."""
    with page_or_skip():
        pass
