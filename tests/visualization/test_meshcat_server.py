"""The port of a Meshcat."""

import pytest

from drake_nonstop.validation import ScenarioError
from drake_nonstop.visualization.meshcat_server import start_meshcat


def test_a_taken_port_is_refused():
    first = start_meshcat()
    with pytest.raises(ScenarioError, match=f"--port = {first.port()}: give a free port"):
        start_meshcat(first.port())


@pytest.mark.parametrize("port", [-1, 80, 65536])
def test_bad_port(port):
    with pytest.raises(ScenarioError, match=f"^--port = {port}: give a free port"):
        start_meshcat(port)
