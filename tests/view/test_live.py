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
    """A Meshcat whose buttons a test can press.

    `polls` says what happens each time that a run which is over asks for the number of browsers:
    the number, or a function that returns it. Afterwards there is none.
    """

    def __init__(self):
        self._meshcat = start_meshcat()
        self._clicks = dict.fromkeys((live.PAUSE, live.RESTART, live.STOP), 0)
        self.polls = []
        self.steps = []  # simulated time, wall time and target rate, all those of `after_step`

    def press(self, name):
        self._clicks[name] += 1

    def GetButtonClicks(self, name):  # noqa: N802
        return self._clicks[name]

    def GetNumActiveConnections(self):  # noqa: N802
        poll = self.polls.pop(0) if self.polls else 0
        return poll() if callable(poll) else poll

    def __getattr__(self, name):
        return getattr(self._meshcat, name)


def live_runs(scenario, actions, monkeypatch, *, page=None, realtime_rate=0.0, **replacements):
    """The live runs of a scenario, with actions (time in s, function of the page) on time."""
    page = page or Page()
    actions = sorted(actions, key=lambda action: action[0])

    def simulate_with_actions(scenario, *, after_step, **options):
        def act(simulator, nonstop):
            now = simulator.get_context().get_time()
            while actions and actions[0][0] <= now + 1e-9:
                actions.pop(0)[1](page)
            start = time.perf_counter()
            then = after_step(simulator, nonstop)
            page.steps.append((now, start, simulator.get_target_realtime_rate()))
            return then

        return simulate(scenario, after_step=act, **options)

    monkeypatch.setattr(live, "simulate", simulate_with_actions)
    runs = list(run_live(scenario, page, realtime_rate=realtime_rate, **replacements))
    assert page.GetSliderNames() == []  # all controls are gone
    return runs


def short(duration, name="quintic"):
    return load_scenario(name, [f"simulation_duration={duration}"])


def test_a_run_that_is_not_changed_equals_one_without_a_page(monkeypatch):
    (run,) = live_runs(short(0.5), [], monkeypatch)
    for name, values in simulate(short(0.5), engine="diagram").signals.items():
        np.testing.assert_array_equal(values, run.signals[name], err_msg=name)


# m, in a sample. A may step by 1.2 N / 2 s x 10 ms = 6 mN, on a cable of 0.8 m under 2.5 N by
# 1.9 mm along either of the two edges at its attachment; samples themselves make up to 0.6 mm.
_JUMP = np.sqrt(2) * 1.9e-3 + 0.7e-3


def slowest_speeds(run):
    """The speed (m/s) of the slowest carrier at each sample."""
    return carrier_speeds(run.signal("carrier_state")).min(axis=1)


def commanded_jumps(run):
    """By how much (m) the carriers' commanded positions leave their own velocity in a sample."""
    commands = run.signal("carrier_reference")
    half = commands.shape[1] // 2
    moved = np.diff(commands[:, :half], axis=0)
    flown = (commands[1:, half:] + commands[:-1, half:]) / 2 * np.diff(run.time)[:, None]
    return np.abs(moved - flown).max(axis=1)


@pytest.mark.nightly("flights")
def test_a_raised_bound_is_kept_after_its_time_and_reached_smoothly(monkeypatch, fleet):
    (run,) = live_runs(
        short(4.5), [(0.5, lambda page: page.SetSliderValue(live.BOUND, 0.88))], monkeypatch
    )
    bound = run.signal("speed_bound")[:, 0]
    np.testing.assert_allclose(bound[run.time < 0.49], 0.55)
    np.testing.assert_allclose(bound[run.time > 0.52], 0.88)
    assert run.steps["speed_bound"][-1] == pytest.approx(0.88)
    slowest = slowest_speeds(run)
    assert slowest[run.time < 0.5].min() < 0.88
    assert slowest[run.time > 2.5 + 0.01].min() >= 0.88
    assert run.steps["diagnostics"][-1, 5] == 0  # none held; those cut short count as relaxed
    assert commanded_jumps(run).max() < _JUMP
    assert commanded_jumps(fleet.run("quintic")).max() < _JUMP  # untouched


def test_stop_ends_the_run_and_yields_it(monkeypatch):
    (run,) = live_runs(short(5.0), [(0.3, lambda page: page.press(live.STOP))], monkeypatch)
    assert not run.is_steered
    assert run.time[-1] == pytest.approx(0.3, abs=0.011)


def test_a_users_own_controls_stay():
    meshcat = start_meshcat()
    meshcat.AddButton("mine")
    assert len(list(run_live(short(0.05), meshcat, realtime_rate=0.0))) == 1
    assert list(meshcat.GetButtonNames()) == ["mine"]


@pytest.mark.nightly("flights")
def test_restart_discards_the_run_and_keeps_the_sliders(monkeypatch):
    actions = [
        (0.2, lambda page: page.SetSliderValue(live.BOUND, 0.66)),
        (0.3, lambda page: page.press(live.RESTART)),
    ]
    (run,) = live_runs(short(0.5), actions, monkeypatch)
    assert run.time[-1] == pytest.approx(0.5)
    np.testing.assert_allclose(run.signal("speed_bound")[1:], 0.66)


@pytest.mark.nightly("flights")
def test_after_its_time_a_run_waits_for_restart_stop_or_the_last_browser(monkeypatch):
    page = Page()

    def press(name):
        page.press(name)
        return 1

    page.polls = [1, 1, lambda: press(live.RESTART), 1, lambda: press(live.STOP)]
    assert len(live_runs(short(0.05), [], monkeypatch, page=page)) == 2
    assert page.polls == []
    page = Page()
    page.polls = [1, 1, 1]
    assert len(live_runs(short(0.05), [], monkeypatch, page=page)) == 1
    assert page.polls == []


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
    (run,) = live_runs(short(1.0), [(0.5, pause)], monkeypatch, page=page, realtime_rate=1.0)
    took = time.perf_counter() - start
    times, walls, _ = np.array(page.steps).T
    held = walls[times == times[np.argmin(np.diff(times))]]
    assert len(held) >= 25
    assert run.time[-1] == pytest.approx(1.0)
    assert run.wall_time > 0.9  # s, 1 s of running: the pause is not made up for
    assert run.wall_time < took - (held[-1] - held[1])  # nor counted


def test_the_bound_of_constant_parameters_has_a_slider(monkeypatch):
    names = []
    actions = [
        (0.1, lambda page: names.extend(page.GetSliderNames())),
        (0.1, lambda page: page.SetSliderValue(live.BOUND, 0.11)),
    ]
    (run,) = live_runs(short(0.2), actions, monkeypatch, optimization_layer=ConstantParameters)
    assert live.BOUND in names
    assert run.signal("speed_bound")[-1] == pytest.approx(0.11)


def test_the_page_shows_the_slowest_speed(monkeypatch):
    shown = []
    actions = [(0.3, lambda page: shown.append(page.GetSliderValue(live.SLOWEST)))]
    (run,) = live_runs(short(0.3), actions, monkeypatch, realtime_rate=1.0)
    slowest = slowest_speeds(run)
    assert slowest.min() - 0.01 < shown[0] < slowest.max() + 0.01


@pytest.mark.parametrize("rate", [-1.0, float("nan"), float("inf")])
def test_bad_rate(rate):
    with pytest.raises(ScenarioError, match="--realtime = "):
        next(run_live(short(0.1), start_meshcat(), realtime_rate=rate))
