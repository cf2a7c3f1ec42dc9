"""Fixtures and tiers; this file also makes `helpers` importable from the folders below."""

import os
from pathlib import Path

import numpy as np
import pytest
from pages import WatchedPage, page_or_skip
from shared_runs import SharedRuns

# What `make quick` leaves out: whole runs, commands in processes of their own, and browsers.
SLOW = (
    "benchmarks",
    "evals",
    "studies",
    "simulation/test_faults.py",
    "test_examples.py",
    "visualization/test_live.py",
    "visualization/test_live_page.py",
    "visualization/test_replay_page.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = [Path(__file__).parent / path for path in SLOW]
    for item in items:
        if any(item.path.is_relative_to(path) for path in slow):
            item.add_marker("slow")


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run and for every test."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def shared_runs(tmp_path_factory) -> SharedRuns:
    """Runs that all tests of all workers share."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each worker has a folder of its own in it
    return SharedRuns(folder / "shared_runs")


@pytest.fixture
def watched():
    """A new page of a headless Chromium."""
    with page_or_skip() as page:
        yield WatchedPage(page)


@pytest.fixture
def needs_browser():
    """For a test whose subject opens a browser of its own."""
    with page_or_skip():
        pass
