"""Figures for papers: width, units, legends beside the data, embedded fonts, styles, snapshots."""

import copy
import re

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import same_color

from drake_nonstop import ScenarioError, load_scenario, simulate
from drake_nonstop.cli.main import main
from drake_nonstop.run.run_quantities import load_errors
from drake_nonstop.view.figure_style import (
    COLOURS,
    fitting_unit,
)
from drake_nonstop.view.path_figures import instants_along, view_beside
from drake_nonstop.view.run_figures import make_signal_figure


@pytest.fixture(scope="module")
def run():
    return simulate(load_scenario("quintic", ["simulation_duration=0.2"]))


def test_a_pdf_has_its_width_and_fonts_embedded_as_truetype_wherever_it_is_saved(run, tmp_path):
    figure = run.plot("carrier_speeds", width="double")
    with matplotlib.rc_context({"pdf.fonttype": 3, "xtick.labelsize": 30}):
        figure.savefig(tmp_path / "a.pdf")
    text = (tmp_path / "a.pdf").read_bytes()
    (width,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ", text)
    assert float(width) == pytest.approx(7.16 * 72)
    assert b"/FontFile2" in text
    assert re.search(rb"/BaseFont /[A-Z]{6}\+STIXGeneral", text)
    assert b"/Type3" not in text
    assert figure.axes[0].get_xticklabels()[0].get_fontsize() == 7


@pytest.mark.parametrize(
    ("unit", "largest", "factor", "fitting"),
    [
        ("m", 2.5e-6, 1e6, "µm"),
        ("m", 2.5e-3, 1e3, "mm"),
        ("m", 0.5, 1, "m"),
        ("rad/s", 0.02, 1e3, "mrad/s"),
        ("m²", 1e-6, 1, "m²"),
        ("kg", 1e-6, 1, "kg"),
        ("", 1e-6, 1, ""),
        ("m", 0, 1, "m"),
    ],
)
def test_units_fit_the_size_of_the_values(unit, largest, factor, fitting):
    values = np.array([np.nan, -largest, 0.3 * largest])
    assert fitting_unit(unit, values, [0.0]) == (pytest.approx(factor), fitting)


def test_values_are_drawn_in_the_unit_that_their_axis_names(run):
    (axes,) = run.plot("load_position_error").axes
    norms = np.linalg.norm(load_errors(run)[0], axis=1)
    assert 1e-9 < norms.max() < 1e-7
    assert axes.get_ylabel() == "position error (nm)"
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), 1e9 * norms)


def _legends(figure):
    return [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]


@pytest.mark.parametrize(
    ("name", "style"),
    [("carrier_speeds", "classic"), ("signals", None)],
)
def test_legends_are_inside_the_figure_and_cover_no_line(run, name, style):
    if name == "signals":
        runs = {f"a run of the name {k}": run for k in range(2)}
        figure = make_signal_figure(runs, ["tensions", "load_state.position"])
    else:
        figure = run.plot(name, style=style)
    figure.draw_without_rendering()
    assert _legends(figure)
    for legend in _legends(figure):
        box = legend.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1 + 1
        assert box.y1 <= figure.bbox.y1 + 1
        for axes in figure.axes:
            assert not box.overlaps(axes.bbox)
            for line in axes.lines:
                points = line.get_transform().transform(line.get_xydata())
                inside = (points > box.p0) & (points < box.p1)
                assert not np.any(inside.all(axis=1))


def test_a_figure_has_no_title_and_takes_a_style_by_name_or_as_a_file(run, tmp_path):
    sheet = tmp_path / "mine.mplstyle"
    sheet.write_text("axes.prop_cycle: cycler(color=['red'])\nlines.linewidth: 4\n")
    for style, colour in ((None, COLOURS[0]), (sheet, "red"), ("ggplot", "#E24A33")):
        figure = run.plot("tensions", style=style, width="double")
        line = figure.axes[0].lines[0]
        assert same_color(line.get_color(), colour)
        assert line.get_linewidth() == (4 if style == sheet else 1)
        assert figure.get_figwidth() == 7.16
        assert figure.get_suptitle() == figure.axes[0].get_title() == ""


def test_unknown_styles_and_widths_are_refused_before_a_flight(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "")  # without LaTeX
    (tmp_path / "tex.mplstyle").write_text("text.usetex: True\n")
    with pytest.raises(ScenarioError, match=r"tex.mplstyle: its text.usetex needs LaTeX"):
        run.plot("tensions", style=tmp_path / "tex.mplstyle")
    with pytest.raises(ScenarioError, match=r"style = nonsense: give a file or one of"):
        run.plot("tensions", style="nonsense")
    with pytest.raises(ScenarioError, match=r"width = triple: give single or double"):
        run.plot("tensions", width="triple")
    out = str(tmp_path / "out")
    assert main(["run", "quintic", "--figures", "pdf", "--style", "none", "--out", out]) == 2
    assert "style = none: give a file" in capsys.readouterr().err
    assert main(["plot", "a", "b", "--figure", "tensions", "--out", str(tmp_path / "a.png")]) == 2
    assert "RUN = 2 runs: give one run with --figure" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rows", [slice(-1, None), slice(None)])
def test_paths_are_drawn_of_a_run_that_stopped_at_numbers_that_are_none(run, rows):
    broken = copy.copy(run)
    broken.signals = {name: np.array(values, dtype=float) for name, values in run.signals.items()}
    for values in broken.signals.values():
        values[rows] = np.nan
    for name in ("carrier_paths_from_above", "snapshots"):
        broken.plot(name).draw_without_rendering()


def test_snapshots_are_at_equal_lengths_of_the_loads_way_or_at_equal_times():
    time = np.linspace(0, 1, 1001)
    way = np.stack([time**3, 2 * time**3, np.zeros_like(time)], axis=1)
    np.testing.assert_allclose(
        time[instants_along(way, 5)], np.linspace(0, 1, 5) ** (1 / 3), atol=2e-3
    )
    np.testing.assert_allclose(time[instants_along(0 * way, 5)], np.linspace(0, 1, 5), atol=2e-3)


def test_snapshots_are_seen_in_parallel_from_the_right_of_the_loads_way():
    rng = np.random.default_rng(1)
    for _ in range(20):
        way = np.vstack([np.zeros(3), rng.normal(size=3)])
        right, up = view_beside(way)
        np.testing.assert_allclose([right @ right, up @ up, right @ up], [1, 1, 0], atol=1e-12)
        towards_camera = np.cross(right, up)
        assert towards_camera[2] == pytest.approx(np.sin(np.radians(28)))
        assert right[2] == 0 < up[2]
        assert right @ way[1] > 0  # the load moves to the right of the page
        assert towards_camera @ np.cross(way[1], [0, 0, 1.0]) > 0
