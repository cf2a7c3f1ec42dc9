"""The page of a comparison: the table, plots over time, and all replays side by side."""

import html
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from urllib.parse import quote

import numpy as np

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.metrics import value_at
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.run_quantities import RunQuantities
from drake_nonstop.studies.ablation_tables import (
    COLUMNS,
    OUTCOME,
    POSITION_ERROR,
    SLOWEST_SPEED,
    TIME_BELOW_BOUND,
    Row,
    effects_on_bound,
    labelled,
    problems_of,
    shown,
)
from drake_nonstop.studies.figures import make_overlay_figure
from drake_nonstop.studies.run_all import COMPLETED
from drake_nonstop.visualization.figure_style import extreme_samples
from drake_nonstop.visualization.replay import legend

PAGE = "index.html"
PLOTS = ("position_error.png", "slowest_speed.png", "tension_min.png")
_MOST_POINTS = 4000  # of a curve: those of all runs are in memory at once
Curves = Mapping[str, Sequence[float]]  # by the names that `curves_of` has


def curves_of(run: Run) -> dict[str, list[float]]:
    """The curves of a run in the plots; of a long run its extreme values only."""
    quantities = RunQuantities(run)
    errors, speeds = quantities.position_error, quantities.speeds.min(axis=1)
    tensions = quantities.tensions.min(axis=1)
    sampled = extreme_samples(errors, _MOST_POINTS)
    stepped = extreme_samples(
        np.column_stack([speeds, quantities.speed_bounds, tensions]), _MOST_POINTS
    )
    return {
        "sample_times": run.time[sampled].tolist(),  # s, at 100 Hz
        "position_error": POSITION_ERROR.shown(errors[sampled]).tolist(),
        "step_times": quantities.time[stepped].tolist(),  # s, of the integrator
        "slowest_speed": speeds[stepped].tolist(),  # m/s
        "speed_bound": quantities.speed_bounds[stepped].tolist(),  # m/s
        "least_tension": tensions[stepped].tolist(),  # N
    }


def write_page(
    folder: Path,
    title: str,
    scenario: Scenario,
    rows: Sequence[Row],
    curves: Mapping[str, Curves],
    *,
    has_replays: bool,
) -> None:
    """Writes the plots and the page to the folder; `curves` are by the rows' folders."""
    _draw(folder, rows, curves)
    page = _page(title, scenario, rows, has_replays=has_replays)
    (folder / PAGE).write_text(page, encoding="utf-8")


def _draw(folder: Path, rows: Sequence[Row], curves: Mapping[str, Curves]) -> None:
    """Writes the plots, whose axes are scaled to the completed runs."""
    drawn = {row.variant: curves[row.folder] for row in rows if row.folder in curves}
    whole = {row.variant for row in rows if row.ending == COMPLETED} or set(drawn)
    longest = max(drawn.values(), key=lambda c: c["step_times"][-1])
    errors, speeds, tensions = (
        {name: (np.array(c[times]), np.array(c[curve])) for name, c in drawn.items()}
        for times, curve in (
            ("sample_times", "position_error"),
            ("step_times", "slowest_speed"),
            ("step_times", "least_tension"),
        )
    )
    label = f"position error ({POSITION_ERROR.quantity.unit})"
    bound = np.array(longest["step_times"]), np.array(longest["speed_bound"])
    title = "Speed of the slowest carrier"
    for name, figure in zip(
        PLOTS,
        (
            make_overlay_figure(
                "Load position error", label, errors, framed=whole, is_logarithmic=True
            ),
            make_overlay_figure(title, "speed (m/s)", speeds, framed=whole, bound=bound),
            make_overlay_figure(
                "Least tension of the cables", "tension (N)", tensions, framed=whole
            ),
        ),
        strict=True,
    ):
        figure.savefig(folder / name, dpi=150)


def _page(title: str, scenario: Scenario, rows: Sequence[Row], *, has_replays: bool) -> str:
    """The table, the plots and the replays as HTML that refers to files of its folder only."""
    base = rows[0]
    headings = "".join(f"<th>{html.escape(column.heading)}</th>" for column in COLUMNS)
    body = "".join(_table_row(row, base) for row in rows)
    effects, unaffected = effects_on_bound(rows)
    effect = "".join(
        f"<li><b>{html.escape(row.variant)}</b> {html.escape(text)}</li>" for row, text in effects
    )
    replayed = [row for row in rows if row.metrics is not None] if has_replays else []
    template = resources.files("drake_nonstop.studies").joinpath("ablation_page.html")
    return Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        description=html.escape(scenario.description),
        headings=headings,
        body=body,
        effects=f"<ol>{effect}</ol>" if effects else "",
        unaffected=html.escape(", ".join(unaffected) or "none"),
        problems="".join(f"<p class=problem>{html.escape(text)}</p>" for text in problems_of(rows)),
        plots="".join(f'<a href="{name}"><img src="{name}" alt="{name}"></a>' for name in PLOTS),
        hidden="" if replayed else "hidden",
        legend=legend(scenario.scene, has_aircraft=scenario.system.aircraft is not None),
        duration=max([value_at(row.metrics, "simulated_s") for row in replayed], default=0.0),
        cards="".join(_card(row) for row in replayed),
    )


def _table_row(row: Row, base: Row) -> str:
    """A row of the page's table, with changes for the worse and for the better marked."""
    cells = ""
    for column in COLUMNS:
        is_better = column.is_better(row, base)
        kind = "" if is_better is None else f" class={'better' if is_better else 'worse'}"
        cells += f"<td{kind}>{column.cell(row, base)}</td>"
    overrides = "<br>".join(html.escape(override) for override in row.overrides)
    name = html.escape(labelled(row))
    if row.metrics is not None:
        name = f'<a href="{quote(row.folder)}/">{name}</a>'
    details = f"<details><summary>{name}</summary><code>{overrides}</code></details>"
    return f"<tr><th>{details if row.overrides else name}</th>{cells}</tr>"


def _card(row: Row) -> str:
    """The place of a replay, with some metrics."""
    figures = (
        f"{shown(OUTCOME, row)} · error {shown(POSITION_ERROR, row)} mm · "
        f"slowest {shown(SLOWEST_SPEED, row)} m/s · below ε for {shown(TIME_BELOW_BOUND, row)} s"
    )
    page = f"{quote(row.folder)}/replay.html"
    return (
        f'<figure data-page="{page}"><div class="screen"></div><figcaption>'
        f'<a href="{page}">{html.escape(labelled(row))}</a> {figures}</figcaption></figure>'
    )
