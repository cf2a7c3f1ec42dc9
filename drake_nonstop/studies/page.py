"""The page of a study: its table, its figures, and replays side by side."""

import html
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template
from urllib.parse import quote

from drake_nonstop.run.metrics import Metric
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.changes import labels
from drake_nonstop.studies.summary import Summary
from drake_nonstop.view.replay import legend

PAGE = "index.html"


def make_page(
    title: str,
    scenario: Scenario,
    summary: Summary,
    metrics: Sequence[Metric],
    figures: Sequence[str],
    replays: Mapping[int, str],
) -> str:
    """The page as HTML that refers to files of its folder only.

    `figures` are names without their endings, `replays` the folders of settings that have one.
    """

    def name(k: int) -> str:
        """The first cell of a setting, with its changes, and a link to its results."""
        setting = summary.settings[k]
        told = html.escape(str(next(iter(setting.factors.values()), setting.name)))
        link = f'<a href="{quote(replays[k])}/">{told}</a>' if k in replays else told
        changes = "<br>".join(map(html.escape, labels(setting.changes)))
        if not changes:
            return link
        return f"<details><summary>{link}</summary><code>{changes}</code></details>"

    def card(k: int, place: str) -> str:
        page, told = f"{quote(place)}/replay.html", html.escape(summary.settings[k].name)
        return (
            f'<figure data-page="{page}"><div class="screen"></div><figcaption>'
            f'<a href="{page}">{told}</a> {html.escape(outcomes[k])}</figcaption></figure>'
        )

    outcomes = summary.outcomes()
    picture = '<a href="{0}.pdf"><img src="{0}.png" alt="{0}"></a>'
    note = "Changes are those from the first row."
    if summary.seeds > 1:
        note = (
            f"Means over {summary.seeds} seeds with their 95 % intervals. Changes are those from "
            "the first row over the same seeds."
        )
    template = resources.files("drake_nonstop.studies").joinpath("study.html")
    return Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        factors=len(summary.factors),
        description=html.escape(scenario.description),
        table=summary.html(metrics, name),
        note=note,
        problems="".join(
            f"<p class=problem>{html.escape(text)}</p>" for text in summary.problems()
        ),
        plots="".join(map(picture.format, figures)),
        hidden="" if replays else "hidden",
        legend=legend(scenario, has_aircraft=scenario.system.aircraft is not None),
        duration=scenario.simulation_duration,
        cards="".join(card(k, place) for k, place in replays.items()),
    )
