import pytest

from drake_nonstop import load_scenario


@pytest.fixture(scope="session")
def evaluated(shared_runs):
    """A function from a shipped scenario's name to its run and metrics."""
    return lambda name: shared_runs.evaluated(load_scenario(name))
