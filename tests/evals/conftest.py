import pytest


@pytest.fixture(scope="session")
def evaluated(fleet):
    """A function from the name of a flight of the fleet to its run and metrics."""
    return fleet.evaluated
