"""How notebooks show scenarios, runs and loops; `drake_nonstop` imports it in them."""

import base64
import html
import io

from pydrake.systems.framework import Diagram

from drake_nonstop.run.metrics import compute_metrics, metrics_table
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import automatic_gains
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.energy import LoopDiagram
from drake_nonstop.view.drawing import draw_diagram
from drake_nonstop.view.run_figures import make_figure

_FIGURES = ("snapshots", "carrier_speeds")


def run_html(run: Run) -> str:
    """A run's table of metrics, and figures of its motion and of its carriers' speeds."""
    if len(run.time) == 0:
        return _preformatted(repr(run))
    table = "\n".join(filter(None, (metrics_table(compute_metrics(run)), automatic_gains(run))))
    pictures = "".join(_picture(run, name) for name in _FIGURES)
    told = _preformatted("record_replay(run) shows it move; run.plot(...) draws more")
    return f"{_preformatted(repr(run))}{_preformatted(table)}{pictures}{told}"


def _picture(run: Run, name: str) -> str:
    file = io.BytesIO()
    make_figure(run, name).savefig(file, format="png", dpi=180)
    content = base64.b64encode(file.getvalue()).decode()
    label = name.replace("_", " ").capitalize()
    return f'<img alt="{label}" src="data:image/png;base64,{content}"/>'


def scenario_html(scenario: Scenario) -> str:
    """A scenario in a line, which opens to its YAML."""
    text = _preformatted(dump_scenario(scenario))
    return f"<details><summary>{html.escape(repr(scenario))}</summary>{text}</details>"


def diagram_html(diagram: Diagram) -> str:
    """A loop's diagram as it is drawn."""
    drawing = draw_diagram(diagram)
    return drawing[drawing.index("<svg") :]


def _preformatted(text: str) -> str:
    return f'<pre style="font-size: 85%; line-height: 1.3">{html.escape(text)}</pre>'


for _shown, _html in (
    (Scenario, scenario_html),
    (Run, run_html),
    (LoopDiagram, diagram_html),
):
    setattr(_shown, "_repr_html_", _html)  # noqa: B010 - for type checkers it is no attribute
