"""Compositions as data: boxes, wires, scenarios, grids, and where loops start; no equations."""

from pathlib import Path

FOLDER = Path(__file__).parent  # of the scenarios and grids that come with the package
