"""How notebooks show runs, sweeps and loops."""

import html
import re

from drake_nonstop import (
    load_scenario,
    make_nonstop,
    parse_scenario,
    record_replay,
    simulate,
)
from drake_nonstop.view import rich_display  # noqa: F401 - as in a notebook

BRIEF = ["simulation_duration=0.2"]


def test_a_run_shows_its_metrics_and_two_figures_and_its_replay_where_it_is_asked_for():
    run = simulate(load_scenario("quintic", BRIEF))
    shown = run._repr_html_()
    assert "&lt;Run of quintic: 0.2 s, 31 signals&gt;" in shown
    assert "carrier speed" in shown
    assert len(re.findall(r'src="data:image/png;base64,[A-Za-z0-9+/]{5000,}', shown)) == 2
    assert len(shown) < 200_000
    replay = record_replay(run)
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', replay._repr_html_())[1]) == replay


def test_a_scenario_is_a_line_that_opens_to_its_yaml():
    scenario = load_scenario("quintic")
    line = "<Scenario quintic: 4 carriers, 15.0 s, RecedingHorizonOptimizerConfig>"
    assert repr(scenario) == line
    shown = html.unescape(scenario._repr_html_())
    assert line in shown
    assert parse_scenario(re.search("<pre[^>]*>(.*)</pre>", shown, re.DOTALL)[1]) == scenario


def test_a_loop_shows_its_drawing():
    shown = make_nonstop(load_scenario("quintic"))._repr_html_()
    assert shown.startswith("<svg")
    assert 'data-block="optimization_layer"' in shown
