"""Variants of a scenario, compared: grids of variants, their runs, tables and a page."""

from drake_nonstop.studies.ablation.grids import Grid, grid_names, name_overrides, read_grid
from drake_nonstop.studies.ablation.rows import BASE, Row, ordered
from drake_nonstop.studies.ablation.runs import ablate, ablation_settings
from drake_nonstop.studies.ablation.tables import as_csv, as_markdown, as_text

__all__ = [
    "BASE",
    "Grid",
    "Row",
    "ablate",
    "ablation_settings",
    "as_csv",
    "as_markdown",
    "as_text",
    "grid_names",
    "name_overrides",
    "ordered",
    "read_grid",
]
