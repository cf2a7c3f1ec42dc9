"""Compositions as data: the boxes and wires of the figure, scenarios, grids; no equations."""

from pathlib import Path

FOLDER = Path(__file__).parent  # of the scenarios and grids that come with the package
