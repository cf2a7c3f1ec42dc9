"""Every figure over every kind of run: drawn in the paper's style, with nothing over the data."""

import copy
import re

import matplotlib
import numpy as np
import pytest
from helpers import circling_run, nightly_beyond
from matplotlib.figure import Figure
from PIL import Image

from drake_nonstop import ScenarioError, write_results
from drake_nonstop.cli.main import main
from drake_nonstop.run.run_quantities import load_errors
from drake_nonstop.scenario.loading import load_scenario

COLUMN = 3.5  # inch
ALWAYS = {"carrier_paths_from_above", "snapshots", "load_errors", "carrier_speeds", "tensions"}
ALWAYS |= {"internal_force_parameters"}
KINDS = {  # a flight of the fleet, and the figures that some runs have
    "quintic_over_tower": set(),
    "seven_gusty": set(),
    "that_diverges": set(),
    "that_stalls": {"aircraft"},
    "with_bowed_cables": {"aircraft"},
    "quintic": {"limits"},
}


def assert_legends_cover_no_data(figure):
    figure.draw_without_rendering()
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1 + 1
        assert box.y1 <= figure.bbox.y1 + 1
        assert not any(box.overlaps(axes.bbox) for axes in figure.axes)


@pytest.mark.parametrize("kind", nightly_beyond(2, "studies", reversed(KINDS)))
def test_every_figure_of_every_kind_of_run(kind, fleet):
    limit = ["simulation_duration=1", "optimization_layer.max_tension=9"]
    run = fleet.run(load_scenario(kind, limit) if "limits" in KINDS[kind] else kind)
    shown = ALWAYS | KINDS[kind]
    for name in {"aircraft", "limits"} - shown:
        with pytest.raises(ScenarioError, match=rf"^figure = {name}: this run has .*snapshots"):
            run.plot(name)
    for name in shown:
        with matplotlib.rc_context({"font.family": "monospace", "xtick.labelsize": 30}):
            figure = run.plot(name)
            assert_legends_cover_no_data(figure)
        assert figure.get_figwidth() == COLUMN
        assert figure.get_suptitle() == figure.axes[0].get_title() == ""
        assert {text.get_fontsize() for text in figure.axes[-1].get_xticklabels()} <= {7}
        assert any(axes.lines and axes.get_ylabel() for axes in figure.axes) or name == "snapshots"


def changed_run(run, **signals):
    """A copy of a run, some of whose signals are other functions of their values."""
    made = copy.copy(run)
    made.signals = {name: np.array(values) for name, values in run.signals.items()}
    for name, values in made.signals.items():
        change = signals.get(name.partition(".")[2], signals.get("every"))
        if change is not None:
            made.signals[name] = change(values)
    return made


@pytest.mark.parametrize("rows", [slice(-1, None), slice(None)])
def test_figures_are_drawn_of_a_run_that_stopped_at_numbers_that_are_none(rows, fleet):
    def broken(values):
        values[rows] = np.nan
        return values

    run = changed_run(fleet.run("quintic"), every=broken)
    for name in ALWAYS:
        run.plot(name).draw_without_rendering()


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
    ("part", "largest", "factor", "unit"),
    [
        *(("position.y", 2.5e-6, 1e6, "µm"), ("position.y", 2.5e-3, 1e3, "mm")),
        *(("position.y", 0.5, 1, "m"), ("position.y", 0, 1, "m")),
        *(("angular_velocity.y", 0.02, 1e3, "mrad/s"), ("quaternion.y", 1e-6, 1, "")),
    ],
)
def test_values_are_drawn_in_a_unit_that_fits_and_that_their_axis_names(
    part, largest, factor, unit, fleet
):
    run = fleet.run("quintic")
    values = np.linspace(-1, 0.3, len(run.time))[:, None] * np.full(13, largest)
    values[20] = np.nan
    run = changed_run(run, load_state=lambda _: values)
    (axes,) = run.plot(f"load_state.{part}").axes
    name = f"load_state.{part.partition('.')[0]}"
    assert axes.get_ylabel() == (f"{name}\n({unit})" if unit else name)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), factor * values[:, 0])


def test_errors_are_drawn_with_their_norm(fleet):
    run = fleet.run("quintic")
    axes = run.plot("load_errors").axes[0]
    norms = np.linalg.norm(load_errors(run)[0], axis=1)
    assert axes.get_ylabel().endswith("(µm)")
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), 1e6 * norms)


def test_a_long_curve_has_few_samples_with_the_ends_and_all_extremes_and_gaps(fleet, rng):
    run = copy.copy(fleet.run("quintic"))
    run.time, values = 0.01 * np.arange(40_001), rng.normal(size=(40_001, 13))
    gap = int(rng.integers(len(values)))
    values[gap] = np.nan
    run = changed_run(run, load_state=lambda _: values)
    for line, column in zip(run.plot("load_state.position").axes[0].lines, (4, 5, 6), strict=True):
        times, shown = line.get_data()
        assert len(shown) <= 20_000 < len(values)
        rows = np.searchsorted(run.time, times)
        np.testing.assert_array_equal(shown, values[rows, column])
        assert np.all(np.diff(rows) > 0)
        assert (rows[0], rows[-1]) == (0, len(values) - 1)
        assert gap in rows
        extremes = np.nanmin(shown), np.nanmax(shown)
        assert extremes == (np.nanmin(values[:, column]), np.nanmax(values[:, column]))


def test_values_that_diverged_hide_nothing(fleet):
    whole = fleet.run("quintic")

    def diverged(values):
        values[-3:] += 1e8
        return values

    run = changed_run(whole, every=diverged, reference=lambda values: values)
    run.stopped, run.steps = "it diverged", {k: np.array(v) for k, v in whole.steps.items()}
    for name in ("tensions", "carrier_state"):
        diverged(run.steps[name])
    for name in ALWAYS:
        for axes, other in zip(run.plot(name).axes, whole.plot(name).axes, strict=True):
            assert np.ptp(axes.get_ylim()) < 12 * max(np.ptp(other.get_ylim()), 1)
            assert np.ptp(axes.get_xlim()) < 12 * np.ptp(other.get_xlim())
            marks = [text for text in axes.texts if text.get_text().startswith("to ")]
            crosses = [line for line in axes.lines if line.get_label() == "path goes on"]
            assert marks or crosses, name
            assert not [text for text in other.texts if text.get_text().startswith("to ")]
    (axes,) = run.plot("tensions", "tensions").axes
    assert axes.get_ylim()[1] < 40


def test_marks_stand_where_the_curve_leaves_the_panel(fleet):
    def waves(values):
        values[:, 4] = np.sin(9 * np.linspace(0, 1, len(values)))
        values[[70, 90], 4] = -300, 200
        return values

    run = changed_run(fleet.run("quintic"), load_state=waves)
    run.stopped = "it diverged"
    (axes,) = run.plot("load_state.position.x").axes
    low, high = axes.get_ylim()
    assert -12 < low < -0.9 < 0.9 < high < 12
    places = [line.get_xydata()[0] for line in axes.lines[1:]]
    np.testing.assert_allclose(places, [[run.time[70], low], [run.time[90], high]])
    assert [text.get_text() for text in axes.texts] == ["to -3e+02", "to 2e+02"]


@pytest.mark.parametrize("rests", [False, True])
def test_snapshots_are_at_equal_lengths_of_the_loads_way_or_at_equal_times(rests):
    run = circling_run(duration=10.0)
    share, way = run.time / run.time[-1], np.array([-1.0, 2.0, 0.5])

    def moved(state):
        state[:, 4:7] = share[:, None] ** 3 * (1e-3 * way if rests else way)
        return state

    (axes,) = changed_run(run, load_state=moved).plot("snapshots").axes
    (load,) = (line for line in axes.lines if line.get_label().startswith("load, at "))
    times = [float(text) for text in re.findall(r"[\d.]+(?=,| s)", load.get_label())]
    expected = np.linspace(0, 1, 5) ** (1 if rests else 1 / 3)
    np.testing.assert_allclose(times, 10 * expected, atol=0.02)
    if not rests:  # seen in parallel, from 28° above and 65° to the right of the way
        across, climb, (side, fore) = np.hypot(1, 2), np.radians(28), np.radians([65, 65])
        up = 0.5 * np.cos(climb) - across * np.cos(fore) * np.sin(climb)
        (x, y), found = (across * np.sin(side), up), np.transpose(load.get_data())
        np.testing.assert_allclose(found[-1] - found[0], [x, y], rtol=1e-9)


@pytest.mark.usefixtures("undrawn")
def test_signals_have_a_panel_for_each_quantity_and_a_line_for_each_entry_and_run(
    fleet, tmp_path, monkeypatch
):
    figures, folders = [], [tmp_path / name for name in ("quintic", "three_carriers")]
    save = Figure.savefig

    def savefig(figure, *arguments, **options):
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    for folder in folders:
        write_results(fleet.run(folder.name), folder, figures=False, replay=False)
    names = ["tensions", "carrier_state.velocities.2", "load_state.position.x"]
    signals = [word for name in names for word in ("--signal", name)]
    call = ["plot", *map(str, folders), *signals, "--out", str(tmp_path / "a.png")]
    assert main(call) == 0
    (figure,) = figures
    assert [axes.get_ylabel() for axes in figure.axes] == [
        *("tensions\n(N)", "carrier_state.velocities\n(m/s)", "load_state.position\n(m)")
    ]
    assert [len(axes.lines) for axes in figure.axes] == [4 + 3, 2 * 3, 2]
    assert figure.axes[0].lines[0].get_label() == "1 quintic"
    looks = {(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert len(looks) == 7
    assert_legends_cover_no_data(figure)
    with Image.open(tmp_path / "a.png") as image:
        assert image.width == COLUMN * 300
    figure = ["--figure", "snapshots", "--out", str(tmp_path / "b.pdf")]
    assert main(["plot", str(folders[0]), *figure]) == 0
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")
