"""Each shipped scenario is run once for all evals."""

from functools import cache

import pytest

from drake_nonstop import Run, compute_metrics, load_scenario, simulate


@cache
def _run(name: str) -> tuple[Run, dict]:
    run = simulate(load_scenario(name))
    return run, compute_metrics(run)


@pytest.fixture(scope="session")
def evaluated():
    """A function from a scenario's name to its run and metrics."""
    return _run
