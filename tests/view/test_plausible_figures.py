"""Figures of a run that diverged show what came before, with a mark where they are cut off."""

import copy

import numpy as np
import pytest

from drake_nonstop.view.figure_style import keep_plausible, single
from drake_nonstop.view.run_figures import FIGURES, figure_names, make_figure, make_signal_figure


@pytest.fixture(scope="module")
def diverged(fleet):
    """A run whose last samples are far beyond all others."""
    run = copy.copy(fleet.run("quintic"))
    run.stopped = "it diverged"
    run.signals = {name: np.array(values) for name, values in run.signals.items()}
    run.steps = {name: np.array(values) for name, values in run.steps.items()}
    moved = [values for name, values in run.signals.items() if not name.endswith("reference")]
    for values in (*moved, run.steps["tensions"], run.steps["carrier_state"]):
        values[-3:] += 1e8
    return run


def test_one_value_that_diverged_does_not_hide_a_figure(diverged, fleet):
    whole = fleet.run("quintic")
    for name in figure_names(diverged):
        pairs = zip(make_figure(diverged, name).axes, make_figure(whole, name).axes, strict=True)
        for axes, other in pairs:
            assert np.ptp(axes.get_ylim()) < 12 * max(np.ptp(other.get_ylim()), 1)
            assert np.ptp(axes.get_xlim()) < 12 * np.ptp(other.get_xlim())
            marks = [text.get_text() for text in axes.texts if text.get_text().startswith("to ")]
            assert marks or name in ("snapshots", "carrier_paths_from_above"), name
    assert {*figure_names(diverged)} == {*FIGURES} - {"aircraft", "limits"}
    (axes,) = make_signal_figure({"a": diverged, "b": whole}, ["tensions"]).axes
    assert axes.get_ylim()[1] < 40
    for name in figure_names(whole):
        texts = [text.get_text() for axes in make_figure(whole, name).axes for text in axes.texts]
        assert not [text for text in texts if text.startswith("to ")]


def test_marks_stand_where_the_curve_leaves_the_panel():
    _, axes = single("time (s)", "y")
    times = np.linspace(0, 1, 101)
    values = np.sin(9 * times)
    values[[70, 90]] = -300, 200
    axes.plot(times, values)
    keep_plausible(axes)
    low, high = axes.get_ylim()
    assert -12 < low < -0.9 < 0.9 < high < 12
    places = [line.get_xydata()[0] for line in axes.lines[1:]]
    np.testing.assert_allclose(places, [[0.7, low], [0.9, high]])
    assert [text.get_text() for text in axes.texts] == ["to -3e+02", "to 2e+02"]
