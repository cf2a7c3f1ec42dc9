"""Every figure over every kind of run: drawn in the paper's style, with nothing over the data."""

import copy
import re

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.run.run_quantities import load_errors
from drake_nonstop.studies.results_folder import write_data
from drake_nonstop.view.figure_style import extreme_samples, fitting_unit
from drake_nonstop.view.path_figures import instants_along, view_beside
from drake_nonstop.view.run_figures import FIGURES, figure_names, make_figure, make_signal_figure

COLUMN = 3.5  # inch
KINDS = {  # a flight of the fleet, and the figures that some runs have
    "quintic_over_tower": set(),
    "seven_gusty": set(),
    "that_diverges": set(),
    "that_stalls": {"aircraft"},
    "with_bowed_cables": {"aircraft"},
}


def assert_legends_cover_no_data(figure):
    figure.draw_without_rendering()
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1 + 1
        assert box.y1 <= figure.bbox.y1 + 1
        assert not any(box.overlaps(axes.bbox) for axes in figure.axes)


@pytest.mark.parametrize("kind", KINDS)
def test_every_figure_of_every_kind_of_run(kind, fleet):
    run = fleet.run(kind)
    shown = set(figure_names(run))
    assert shown >= set(FIGURES) - {"aircraft", "limits"} | KINDS[kind]
    assert ("aircraft" in shown) == ("aircraft" in KINDS[kind])
    for name in shown:
        with matplotlib.rc_context({"font.family": "monospace", "xtick.labelsize": 30}):
            figure = make_figure(run, name)
            assert_legends_cover_no_data(figure)
        assert figure.get_figwidth() == COLUMN
        assert figure.get_suptitle() == figure.axes[0].get_title() == ""
        assert {text.get_fontsize() for text in figure.axes[-1].get_xticklabels()} <= {7}
        assert any(axes.lines and axes.get_ylabel() for axes in figure.axes) or name == "snapshots"


@pytest.mark.parametrize("rows", [slice(-1, None), slice(None)])
def test_figures_are_drawn_of_a_run_that_stopped_at_numbers_that_are_none(rows, fleet):
    broken = copy.copy(fleet.run("quintic"))
    broken.signals = {name: np.array(values) for name, values in broken.signals.items()}
    for values in broken.signals.values():
        values[rows] = np.nan
    for name in figure_names(broken):
        make_figure(broken, name).draw_without_rendering()


def test_a_pdf_has_its_width_and_fonts_embedded_as_truetype_wherever_it_is_saved(fleet, tmp_path):
    figure = fleet.run("quintic").plot("carrier_speeds")
    with matplotlib.rc_context({"pdf.fonttype": 3}):
        figure.savefig(tmp_path / "a.pdf")
    text = (tmp_path / "a.pdf").read_bytes()
    (width,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ", text)
    assert float(width) == pytest.approx(COLUMN * 72)
    assert re.search(rb"/BaseFont /[A-Z]{6}\+STIXGeneral", text)
    assert b"/FontFile2" in text
    assert b"/Type3" not in text


@pytest.mark.parametrize(
    ("unit", "largest", "factor", "fitting"),
    [
        *(("m", 2.5e-6, 1e6, "µm"), ("m", 2.5e-3, 1e3, "mm"), ("m", 0.5, 1, "m")),
        *(("rad/s", 0.02, 1e3, "mrad/s"), ("m²", 1e-6, 1, "m²"), ("kg", 1e-6, 1, "kg")),
        *(("", 1e-6, 1, ""), ("m", 0, 1, "m")),
    ],
)
def test_units_fit_the_size_of_the_values(unit, largest, factor, fitting):
    values = np.array([np.nan, -largest, 0.3 * largest])
    assert fitting_unit(unit, values, [0.0]) == (pytest.approx(factor), fitting)


def test_values_are_drawn_in_the_unit_that_their_axis_names(fleet):
    run = fleet.run("quintic")
    axes = run.plot("load_errors").axes[0]
    norms = np.linalg.norm(load_errors(run)[0], axis=1)
    assert 1e-7 < norms.max() < 1e-4
    assert axes.get_ylabel().endswith("(µm)")
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), 1e6 * norms)


def test_snapshots_are_at_equal_lengths_of_the_loads_way_or_at_equal_times():
    time = np.linspace(0, 1, 1001)
    way = np.stack([time**3, 2 * time**3, np.zeros_like(time)], axis=1)
    expected = np.linspace(0, 1, 5)
    np.testing.assert_allclose(time[instants_along(way, 5)], expected ** (1 / 3), atol=2e-3)
    np.testing.assert_allclose(time[instants_along(0 * way, 5)], expected, atol=2e-3)


def test_snapshots_are_seen_in_parallel_from_the_right_of_the_loads_way():
    way = np.array([[0, 0, 0], [-1.0, 2.0, 0.5]])
    right, up = view_beside(way)
    np.testing.assert_allclose([right @ right, up @ up, right @ up], [1, 1, 0], atol=1e-12)
    towards_camera = np.cross(right, up)
    assert towards_camera[2] == pytest.approx(np.sin(np.radians(28)))
    assert right[2] == 0 < up[2]
    assert right @ way[1] > 0  # the load moves to the right of the page
    assert towards_camera @ np.cross(way[1], [0, 0, 1.0]) > 0


@settings(max_examples=50, deadline=None)
@given(
    count=st.integers(0, 3000),
    columns=st.integers(0, 5),
    spare=st.integers(0, 300),
    seed=st.integers(0, 2**32 - 1),
)
def test_few_samples_have_the_ends_and_all_extremes_and_gaps(count, columns, spare, seed):
    random = np.random.default_rng(seed)
    values = random.normal(size=(count, columns) if columns else (count,))
    most = 2 + 4 * max(columns, 1) + spare
    chosen = extreme_samples(values, most)
    assert len(chosen) <= max(most, 0)
    assert np.all(np.diff(chosen) > 0)
    if count <= most:
        assert len(chosen) == count
        return
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    np.testing.assert_array_equal(values[chosen].min(axis=0), values.min(axis=0))
    np.testing.assert_array_equal(values[chosen].max(axis=0), values.max(axis=0))
    gap = random.integers(count)
    values[gap] = np.nan
    assert gap in extreme_samples(values, most)


def test_signals_have_a_panel_for_each_quantity_and_a_line_for_each_entry_and_run(fleet):
    names = ("quintic", "three_carriers")
    runs = {name: fleet.run(name) for name in names}
    figure = make_signal_figure(
        runs, ["tensions", "carrier_state.velocities.2", "load_state.position.x"]
    )
    assert [axes.get_ylabel() for axes in figure.axes] == [
        *("tensions\n(N)", "carrier_state.velocities\n(m/s)", "load_state.position\n(m)")
    ]
    assert [len(axes.lines) for axes in figure.axes] == [4 + 3, 2 * 3, 2]
    assert figure.axes[0].lines[0].get_label() == "1 quintic"
    looks = {(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert len(looks) == 7
    assert_legends_cover_no_data(figure)


def test_the_command_writes_the_picture_and_refuses_what_it_cannot_draw(fleet, tmp_path, capsys):
    write_data(fleet.run("quintic"), tmp_path / "run")
    place, picture = str(tmp_path / "run"), str(tmp_path / "a.png")
    assert main(["plot", place, place, "--signal", "tensions", "--out", picture]) == 0
    with Image.open(picture) as image:
        assert image.width == COLUMN * 300
    figure = ["plot", place, "--figure", "snapshots", "--out", str(tmp_path / "b.pdf")]
    assert main(figure) == 0
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")
    for call, told in (
        (["--signal", "tensions", "--out", "a.txt"], ("--out", "a.txt", ".png")),
        (["--signal", "tension", "--out", picture], ("signal", "tension", "give a port")),
        (["--figure", "aircraft", "--out", picture], ("figure", "aircraft", "snapshots")),
        ([place, "--figure", "tensions", "--out", picture], ("RUN", "2 runs", "one run")),
    ):
        assert main(["plot", place, *call]) == 2
        error = capsys.readouterr().err
        assert all(part in error for part in told), error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.pdf", "run"]
