"""The port of a Meshcat."""

import pytest

from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.meshcat_server import start_meshcat


def test_a_taken_port_is_refused():
    meshcat = start_meshcat()
    taken = int(meshcat.web_url().rsplit(":", 1)[1])
    with pytest.raises(ScenarioError, match=f"--port = {taken}: give a free port"):
        start_meshcat(taken)


@pytest.mark.parametrize("port", [-1, 80, 65536])
def test_bad_port(port):
    with pytest.raises(ScenarioError, match=f"^--port = {port}: give a free port"):
        start_meshcat(port)
