"""A live run, controlled from a browser."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.view import live

pytestmark = pytest.mark.nightly("browsers")


@pytest.fixture
def flight(tmp_path):
    """A live run in a process of its own: (process, address, results)."""
    options = ["--live", "--quiet", "--no-figures", "--no-replay"]
    options += ["--set", "simulation_duration=60"]
    command = [sys.executable, "-m", "drake_nonstop.cli", "run", "quintic", *options]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        address = re.search(r"http://\S+", process.stdout.readline())[0]
        yield process, address, tmp_path
    finally:
        process.kill()
        process.communicate()


def opened(watched, address):
    page = watched.page
    page.goto(address)
    page.wait_for_function(f"{live.BOUND!r} in viewer.gui_controllers", timeout=60_000)
    return page


def slide(page, name, value):
    """Moves a slider as dragging it would."""
    page.evaluate("([name, value]) => viewer.gui_controllers[name].setValue(value)", [name, value])


def shown(page, name):
    return page.evaluate("(name) => viewer.gui_controllers[name].getValue()", name)


def test_sliders_and_stop_do_what_they_say(watched, flight):
    process, address, results = flight
    page = opened(watched, address)
    page.wait_for_function(
        "viewer.scene_tree.find(['nonstop', 'carriers']).object.children.length == 4"
    )
    assert shown(page, live.BOUND) == pytest.approx(0.55)
    page.evaluate("viewer.gui.open()")
    slide(page, live.BOUND, 0.66)
    page.wait_for_timeout(1000)
    page.get_by_text(live.STOP, exact=True).click()
    assert process.wait(timeout=60) == 0
    with np.load(results / "signals.npz") as signals:
        bound = signals["optimization_layer.speed_bound"][:, 0]
        updates = signals["optimization_layer.diagnostics"][:, 1]
        time = signals["time"]
    assert time[-1] < 59
    assert bound[0] == 0.55
    assert bound[-1] == pytest.approx(0.66, abs=0.006)
    assert updates[80] - updates[0] == 2  # plans, at 0.39 s and 0.78 s
    assert [error for error in watched.errors if "WebSocket" not in error] == []


def test_viewers_that_come_and_leave_do_not_change_a_run(watched, flight):
    process, address, results = flight
    page = opened(watched, address)
    second = page.context.browser.new_page()
    second.goto(address)
    second.wait_for_timeout(500)
    second.close()
    page.evaluate("viewer.gui.open()")
    page.get_by_text(live.STOP, exact=True).click()
    assert process.wait(timeout=60) == 0
    with np.load(results / "signals.npz") as signals:
        count, duration = len(signals["time"]), signals["time"][-1]
        scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
        for name, values in simulate(scenario, engine="diagram").signals.items():
            np.testing.assert_array_equal(signals[name], values[:count], err_msg=name)
