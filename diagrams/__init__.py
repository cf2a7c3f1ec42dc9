"""The figure as data: boxes, wires and `make_nonstop`; scenarios and grids."""

from pathlib import Path

FOLDER = Path(__file__).parent  # of the scenarios and grids that come with the package
