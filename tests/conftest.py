"""Fixtures for all tests, and which tests are slow."""

import os
from pathlib import Path

import numpy as np
import pytest
from pages import WatchedPage, page_or_skip
from shared_runs import SharedRuns

# What `make quick` leaves out: whole runs, commands, processes and browsers. Each entry is what
# the paths of tests begin with, from this folder on.
SLOW = (
    "adversary/",
    "benchmarks/",
    "blocks/test_carrier_dynamics.py::test_with_the_cables_reaction",
    "blocks/test_cables.py::test_a_cable_that_goes_slack",
    "cli/",
    "diagrams/test_compiled_loop.py::test_shipped_scenarios",
    "diagrams/test_compiled_loop.py::test_other_blocks",
    "diagrams/test_compiled_loop.py::test_drawn_loops",
    "evals/",
    "optimization/test_update_solver.py::test_carriers_stay_apart_over_a_whole_orbit",
    "simulation/test_faults.py",
    "simulation/test_flight_of_plan.py",
    "studies/",
    "test_examples.py",
    "test_notebooks.py",
    "visualization/test_live.py",
    "visualization/test_live_page.py",
    "visualization/test_replay_page.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    found = set()
    for item in items:
        path = f"{item.path.relative_to(here).as_posix()}::{item.name}"
        prefixes = [prefix for prefix in SLOW if path.startswith(prefix)]
        if prefixes:
            item.add_marker("slow")
        found.update(prefixes)
    is_whole_suite = {item.path for item in items} >= {*here.rglob("test_*.py")}
    stale = [prefix for prefix in SLOW if prefix not in found]
    if is_whole_suite and stale:
        raise pytest.UsageError(f"SLOW = {', '.join(stale)}: no test has such a path; remove it")


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
