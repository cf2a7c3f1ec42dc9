"""Live runs whose controls are set as the page would, and by night from a browser."""

import os
import re
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from drake_nonstop import ConstantParameters, run_live, simulate, start_meshcat
from drake_nonstop.scenario.loading import load_scenario

PAUSE, STOP, BOUND = "pause / resume", "stop", "bound, m/s"  # the labels of the controls


class Page:
    """A Meshcat whose buttons a test can press."""

    def __init__(self):
        self._meshcat = start_meshcat()
        self._clicks = dict.fromkeys((PAUSE, STOP), 0)

    def press(self, name):
        self._clicks[name] += 1

    def GetButtonClicks(self, name):  # noqa: N802
        return self._clicks[name]

    def __getattr__(self, name):
        return getattr(self._meshcat, name)


def live_run(scenario, at, act, *, realtime_rate=0.0, **replacements):
    """The live run of a scenario, and when something was done to its page, from a time in s."""
    page, done = Page(), []
    page.AddButton("of a user")

    def progress(now):
        if not done and now >= at - 1e-9:
            act(page)
            done.append(now)

    options = {"realtime_rate": realtime_rate, "progress": progress}
    run = run_live(scenario, page, **options, **replacements)
    assert page.GetSliderNames() == []  # all controls are gone
    assert page.GetButtonNames() == ["of a user"]
    return run, done[0]


def short(duration, name="quintic"):
    return load_scenario(name, [f"simulation_duration={duration}"])


def test_a_run_that_is_not_changed_equals_one_without_a_page_until_it_is_stopped():
    run, stop = live_run(short(5.0), 0.3, lambda page: page.press(STOP))
    assert not run.is_steered
    assert run.time[-1] == pytest.approx(stop, abs=0.011)
    for name, values in simulate(short(5.0), engine="diagram").signals.items():
        np.testing.assert_array_equal(values[: len(run.time)], run.signals[name], err_msg=name)


@pytest.mark.nightly("processes")
def test_pause_holds_the_time_and_the_pace_is_kept_afterwards():
    held = 0.5  # s

    def pause(page):
        page.press(PAUSE)
        threading.Timer(held, page.press, [PAUSE]).start()

    start = time.perf_counter()
    run, *_ = live_run(short(1.0), 0.5, pause, realtime_rate=1.0)
    took = time.perf_counter() - start
    assert run.time[-1] == pytest.approx(1.0)
    assert run.wall_time > 0.9  # s, 1 s of running: the pause is not made up for
    assert run.wall_time < took - 0.9 * held  # nor counted


def test_the_bound_of_constant_parameters_has_a_slider():
    given = {"realtime_rate": 1.0, "optimization_layer": ConstantParameters}
    run, *_ = live_run(short(0.8), 0.1, lambda page: page.SetSliderValue(BOUND, 0.11), **given)
    assert run.signal("speed_bound")[-1] == pytest.approx(0.11)


@pytest.fixture
def flight(tmp_path):
    """A live run in a process of its own: (process, address, results)."""
    options = ["--live", "--quiet", "--no-figures", "--no-replay", "--out", str(tmp_path)]
    options += ["--set", "simulation_duration=60"]
    process = subprocess.Popen(
        [sys.executable, "-m", "drake_nonstop.cli", "run", "quintic", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        yield process, re.search(r"http://\S+", process.stdout.readline())[0], tmp_path
    finally:
        process.kill()
        process.communicate()


@pytest.mark.nightly("browsers")
def test_in_a_browser_sliders_and_stop_do_what_they_say_and_viewers_change_nothing(watched, flight):
    process, address, results = flight
    page = watched.page
    page.goto(address)
    page.wait_for_function(f"{BOUND!r} in viewer.gui_controllers", timeout=60_000)
    page.wait_for_function(
        "viewer.scene_tree.find(['nonstop', 'carriers']).object.children.length == 4"
    )
    second = page.context.browser.new_page()
    second.goto(address)
    second.wait_for_timeout(500)
    second.close()
    slider = f"viewer.gui_controllers[{BOUND!r}]"
    assert page.evaluate(f"{slider}.getValue()") == pytest.approx(0.55)
    page.evaluate(f"viewer.gui.open(); {slider}.setValue(0.66)")  # as dragging it would
    page.wait_for_timeout(1000)
    page.get_by_text(STOP, exact=True).click()
    assert process.wait(timeout=60) == 0
    with np.load(results / "signals.npz") as signals:
        time, bound = signals["time"], signals["optimization_layer.speed_bound"][:, 0]
        updates = signals["optimization_layer.diagnostics"][:, 1]
        before = int(np.argmax(bound > 0.56)) - 1
        scenario = load_scenario("quintic", [f"simulation_duration={time[before]}"])
        for name, values in simulate(scenario, engine="diagram").signals.items():
            np.testing.assert_array_equal(signals[name][:before], values[:before], err_msg=name)
    assert time[-1] < 59
    assert bound[0] == 0.55
    assert bound[-1] == pytest.approx(0.66, abs=0.006)
    assert updates[80] - updates[0] == 2  # plans, at 0.39 s and 0.78 s
    assert [error for error in watched.errors if "WebSocket" not in error] == []
