"""Live runs whose controls are set as the page would; test_live_page.py uses a browser."""

import threading
import time

import numpy as np
import pytest

from drake_nonstop.blocks.optimization_layer import ConstantParameters
from drake_nonstop.run.run_quantities import carrier_speeds
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view import live
from drake_nonstop.view.live import run_live
from drake_nonstop.view.meshcat_server import start_meshcat


class Page:
    """A Meshcat whose buttons a test can press."""

    def __init__(self):
        self._meshcat = start_meshcat()
        self._clicks = dict.fromkeys((live.PAUSE, live.STOP), 0)
        self.steps = []  # simulated time and wall time of each `after_step`

    def press(self, name):
        self._clicks[name] += 1

    def GetButtonClicks(self, name):  # noqa: N802
        return self._clicks[name]

    def __getattr__(self, name):
        return getattr(self._meshcat, name)


def live_run(scenario, actions, monkeypatch, *, page=None, realtime_rate=0.0, **replacements):
    """The live run of a scenario, with actions (time in s, function of the page) on time."""
    page = page or Page()
    page.AddButton("of a user")

    def simulate_with_actions(scenario, *, after_step, **options):
        def act(simulator, nonstop):
            now = simulator.get_context().get_time()
            while actions and actions[0][0] <= now + 1e-9:
                actions.pop(0)[1](page)
            page.steps.append((now, time.perf_counter()))
            return after_step(simulator, nonstop)

        return simulate(scenario, after_step=act, **options)

    monkeypatch.setattr(live, "simulate", simulate_with_actions)
    run = run_live(scenario, page, realtime_rate=realtime_rate, **replacements)
    assert page.GetSliderNames() == []  # all controls are gone
    assert page.GetButtonNames() == ["of a user"]
    return run


def short(duration, name="quintic"):
    return load_scenario(name, [f"simulation_duration={duration}"])


def test_a_run_that_is_not_changed_equals_one_without_a_page_until_it_is_stopped(monkeypatch):
    run = live_run(short(5.0), [(0.3, lambda page: page.press(live.STOP))], monkeypatch)
    assert not run.is_steered
    assert run.time[-1] == pytest.approx(0.3, abs=0.011)
    for name, values in simulate(short(5.0), engine="diagram").signals.items():
        np.testing.assert_array_equal(values[: len(run.time)], run.signals[name], err_msg=name)


@pytest.mark.nightly("flights")
def test_a_raised_bound_is_kept_with_the_next_plans(monkeypatch):
    change = (0.5, lambda page: page.SetSliderValue(live.BOUND, 0.88))
    run = live_run(short(4.5), [change], monkeypatch)
    assert run.is_steered
    bound = run.signal("speed_bound")[:, 0]
    np.testing.assert_allclose(bound[run.time < 0.49], 0.55)
    np.testing.assert_allclose(bound[run.time > 0.52], 0.88)
    slowest = carrier_speeds(run.signal("carrier_state")).min(axis=1)
    assert slowest[run.time < 0.5].min() < 0.88
    assert slowest[run.time > 2.51].min() >= 0.88


def test_pause_holds_the_time_and_the_pace_is_kept_afterwards(monkeypatch):
    page = Page()

    def resume_later():
        while len([step for step in page.steps if step[0] == page.steps[-1][0]]) < 25:
            time.sleep(0.01)
        page.press(live.PAUSE)

    def pause(page):
        page.press(live.PAUSE)
        threading.Thread(target=resume_later).start()

    start = time.perf_counter()
    run = live_run(short(1.0), [(0.5, pause)], monkeypatch, page=page, realtime_rate=1.0)
    took = time.perf_counter() - start
    times, walls = np.array(page.steps).T
    held = walls[times == times[np.argmin(np.diff(times))]]
    assert len(held) >= 25
    assert run.time[-1] == pytest.approx(1.0)
    assert run.wall_time > 0.9  # s, 1 s of running: the pause is not made up for
    assert run.wall_time < took - (held[-1] - held[1])  # nor counted


def test_the_bound_of_constant_parameters_has_a_slider(monkeypatch):
    change = (0.1, lambda page: page.SetSliderValue(live.BOUND, 0.11))
    run = live_run(short(0.2), [change], monkeypatch, optimization_layer=ConstantParameters)
    assert run.signal("speed_bound")[-1] == pytest.approx(0.11)


@pytest.mark.parametrize("rate", [-1.0, float("nan"), float("inf")])
def test_bad_rate(rate):
    with pytest.raises(ScenarioError, match="--realtime = "):
        run_live(short(0.1), start_meshcat(), realtime_rate=rate)
