"""The Meshcat server that a scene is shown by."""

import logging

from pydrake.geometry import Meshcat, MeshcatParams

from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import ScenarioError, require


def start_meshcat(port: int | None = None) -> Meshcat:
    """Starts a Meshcat that only this machine can reach, without a line in the log.

    Args:
        port: where it is served; 0 for any free port, None for the first free one from 7000 on.

    Raises:
        ScenarioError: the port is taken, or is not a port number.
    """
    remedy = "give a free port from 1024 to 65535, or 0 for any"
    # Drake ends the process at any other number.
    require(port is None or port == 0 or 1024 <= port <= 65535, "--port", port, remedy)
    with drake_log_level(logging.WARNING):
        try:
            return Meshcat(MeshcatParams(host="localhost", port=port))
        except RuntimeError:
            raise ScenarioError(f"--port = {port}: {remedy}") from None
