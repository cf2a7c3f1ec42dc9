"""Live runs whose controls are set as the page would; tests/browser has a page do it."""

import threading
import time

import numpy as np
import pytest

from drake_nonstop.blocks.optimization_layer import ConstantParameters
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.validation import ScenarioError
from drake_nonstop.visualization import live
from drake_nonstop.visualization.live import run_live
from drake_nonstop.visualization.scene import start_meshcat


class Page:
    """A Meshcat, where a test can press buttons and be a viewer."""

    def __init__(self):
        self._meshcat = start_meshcat()
        self._clicks = dict.fromkeys((live.PAUSE, live.RESTART, live.STOP), 0)
        self.viewers = 0

    def press(self, name):
        self._clicks[name] += 1

    def GetButtonClicks(self, name):  # noqa: N802
        return self._clicks[name]

    def GetNumActiveConnections(self):  # noqa: N802
        return self.viewers

    def __getattr__(self, name):
        return getattr(self._meshcat, name)


def acted(scenario, acts, monkeypatch, *, realtime_rate=0.0, **replacements):
    """The live runs of a scenario, with `acts` (time in s, function of the page) done on time.

    What is simulated is the plain Meshcat's, as in every run.
    """
    page = Page()
    acts = sorted(acts, key=lambda act: act[0])
    after_step = live._Controls.after_step

    def acting(controls, simulator, nonstop):
        while acts and acts[0][0] <= simulator.get_context().get_time() + 1e-9:
            acts.pop(0)[1](page)
        return after_step(controls, simulator, nonstop)

    monkeypatch.setattr(live._Controls, "after_step", acting)
    monkeypatch.setattr(
        live,
        "simulate",
        lambda scenario, viewers, **options: simulate(
            scenario, viewers=[viewer._meshcat for viewer in viewers], **options
        ),
    )
    runs = list(run_live(scenario, page, realtime_rate=realtime_rate, **replacements))
    assert page.GetSliderNames() == []  # all controls are gone
    return runs


def short(duration, name="quintic"):
    return load_scenario(name, [f"duration={duration}"])


def test_a_run_that_nobody_touches_is_that_without_a_page(monkeypatch):
    (run,) = acted(short(0.5), [], monkeypatch)
    for name, values in simulate(short(0.5)).signals.items():
        np.testing.assert_array_equal(values, run.signals[name], err_msg=name)


# m, in a sample. A may step by 1.2 N / 2 s x 10 ms = 6 mN, on a cable of 0.8 m under 2.5 N by
# 1.9 mm along either of the two edges at its attachment; samples themselves make up to 0.6 mm.
_JUMP = np.sqrt(2) * 1.9e-3 + 0.7e-3


def commanded_jumps(run):
    """By how much (m) the carriers' commanded positions leave their own velocity in a sample."""
    commands = run.signal("carrier_reference")
    half = commands.shape[1] // 2
    moved = np.diff(commands[:, :half], axis=0)
    flown = (commands[1:, half:] + commands[:-1, half:]) / 2 * np.diff(run.time)[:, None]
    return np.abs(moved - flown).max(axis=1)


def test_a_raised_bound_is_kept_after_its_time_and_reached_smoothly(monkeypatch):
    (run,) = acted(
        short(6.0), [(1.0, lambda page: page.SetSliderValue(live.BOUND, 0.88))], monkeypatch
    )
    bound = run.signal("speed_bound")[:, 0]
    np.testing.assert_allclose(bound[run.time < 0.99], 0.55)
    np.testing.assert_allclose(bound[run.time > 1.02], 0.88)
    assert run.steps["speed_bound"][-1] == pytest.approx(0.88)
    speeds = np.linalg.norm(run.signal("carrier_state")[:, 12:].reshape(-1, 4, 3), axis=2)
    slowest = speeds.min(axis=1)
    assert slowest[run.time < 1.0].min() < 0.88
    assert slowest[run.time > 3.0 + 0.01].min() >= 0.88
    assert run.steps["diagnostics"][-1, 5] == 0  # none held; those cut short count as relaxed
    untouched = commanded_jumps(simulate(short(6.0))).max()
    assert commanded_jumps(run).max() < _JUMP
    assert untouched < _JUMP


@pytest.mark.parametrize("constraint", ["min_separation=0.9", "max_speed=1.3", "min_tension=2.5"])
def test_with_other_constraints_the_commands_do_not_jump_either(monkeypatch, constraint):
    scenario = load_scenario("quintic", ["duration=4", f"optimization_layer.{constraint}"])
    acts = [
        (0.3, lambda page: page.SetSliderValue(live.ENABLED, 0.0)),
        (1.0, lambda page: page.SetSliderValue(live.BOUND, 1.5)),
        (1.8, lambda page: page.SetSliderValue(live.ENABLED, 1.0)),
    ]
    (run,) = acted(scenario, acts, monkeypatch)
    assert commanded_jumps(run).max() < _JUMP
    assert run.is_steered
    bound = run.signal("speed_bound")[-1, 0]
    assert bound == pytest.approx(1.5 if "max_speed" not in constraint else 1.3, rel=0.03)


def test_the_switch_leads_to_the_nominal_parameters_and_back(monkeypatch):
    acts = [
        (0.5, lambda page: page.SetSliderValue(live.ENABLED, 0.0)),
        (5.0, lambda page: page.SetSliderValue(live.ENABLED, 1.0)),
    ]
    (run,) = acted(short(9.0), acts, monkeypatch)
    diagnostics = run.signal("diagnostics")
    off = (run.time > 0.52) & (run.time < 4.98)
    assert np.ptp(diagnostics[off, 1]) == 0  # no updates
    config = short(1.0).optimization_layer
    np.testing.assert_allclose(
        run.signal("parameters")[run.time < 4.98][-1],
        [config.frequency, config.amplitude],
        rtol=2e-3,
    )
    assert diagnostics[-1, 1] > diagnostics[off, 1][0] + 390
    slowest = np.linalg.norm(run.signal("carrier_state")[:, 12:].reshape(-1, 4, 3), axis=2).min(1)
    assert slowest[off].min() < 0.55  # without the layer this scenario falls below its bound
    assert slowest[run.time > 7.01].min() >= 0.55
    assert commanded_jumps(run).max() < _JUMP


def test_stop_ends_the_run_and_yields_it(monkeypatch):
    (run,) = acted(short(5.0), [(0.3, lambda page: page.press(live.STOP))], monkeypatch)
    assert not run.is_steered
    assert run.time[-1] == pytest.approx(0.3, abs=0.011)


def test_stop_wins_over_a_restart_at_the_same_instant(monkeypatch):
    acts = [(0.3, lambda page: page.press(live.RESTART)), (0.3, lambda page: page.press(live.STOP))]
    (run,) = acted(short(5.0), acts, monkeypatch)
    assert run.time[-1] == pytest.approx(0.3, abs=0.011)


def test_a_users_own_controls_stay():
    meshcat = start_meshcat()
    meshcat.AddButton("mine")
    assert len(list(run_live(short(0.05), meshcat, realtime_rate=0.0))) == 1
    assert list(meshcat.GetButtonNames()) == ["mine"]


def test_restart_drops_what_ran_and_begins_anew_with_the_sliders_as_they_are(monkeypatch):
    acts = [
        (0.2, lambda page: page.SetSliderValue(live.BOUND, 0.66)),
        (0.3, lambda page: page.press(live.RESTART)),
    ]
    (run,) = acted(short(0.5), acts, monkeypatch)
    assert run.time[-1] == pytest.approx(0.5)
    np.testing.assert_allclose(run.signal("speed_bound")[1:], 0.66)


def test_after_its_time_a_run_waits_for_its_viewers_to_restart_stop_or_leave(monkeypatch):
    def come(page):
        page.viewers = 1
        threading.Timer(1.0, page.press, [live.RESTART]).start()
        threading.Timer(2.0, page.press, [live.STOP]).start()

    assert len(acted(short(0.2), [(0.1, come)], monkeypatch)) == 2

    def look_in(page):
        page.viewers = 1
        threading.Timer(1.0, setattr, [page, "viewers", 0]).start()

    start = time.perf_counter()
    assert len(acted(short(0.2), [(0.1, look_in)], monkeypatch)) == 1
    assert time.perf_counter() - start > 0.9


def test_pause_holds_the_time_and_the_pace_goes_on_from_there(monkeypatch):
    paused = []

    def pause(page):
        paused.append(time.perf_counter())
        page.press(live.PAUSE)
        threading.Timer(2.0, page.press, [live.PAUSE]).start()

    start = time.perf_counter()
    (run,) = acted(short(1.0), [(0.5, pause)], monkeypatch, realtime_rate=1.0)
    took = time.perf_counter() - start
    assert run.time[-1] == pytest.approx(1.0)
    assert 0.9 < run.wall_time < 2.5  # 1 s of running: the pause is neither counted nor made up for
    assert took - (paused[0] - start) > 2.4  # s: the pause, and the rest of the run


def test_the_pace_can_be_changed(monkeypatch):
    slow = [(0.0, lambda page: page.SetSliderValue(live.RATE, 0.5))]
    (run,) = acted(short(0.4), slow, monkeypatch, realtime_rate=0.0)
    assert run.wall_time > 0.75
    (free,) = acted(short(4.0), [], monkeypatch, realtime_rate=0.0)
    assert free.wall_time < 3.0


def test_a_layer_without_a_switch_has_none_in_the_page(monkeypatch):
    names = []
    acts = [
        (0.1, lambda page: names.extend(page.GetSliderNames())),
        (0.1, lambda page: page.SetSliderValue(live.BOUND, 0.11)),
    ]
    (run,) = acted(short(0.2), acts, monkeypatch, optimization_layer=ConstantParameters)
    assert live.ENABLED not in names
    assert live.BOUND in names
    assert run.signal("speed_bound")[-1] == pytest.approx(0.11)


def test_the_page_shows_the_slowest_speed(monkeypatch):
    shown = []
    acts = [(0.3, lambda page: shown.append(page.GetSliderValue(live.SLOWEST)))]
    (run,) = acted(short(0.3), acts, monkeypatch, realtime_rate=1.0)
    slowest = np.linalg.norm(run.signal("carrier_state")[:, 12:].reshape(-1, 4, 3), axis=2).min(1)
    assert slowest.min() - 0.01 < shown[0] < slowest.max() + 0.01


@pytest.mark.parametrize("rate", [-1.0, float("nan"), float("inf")])
def test_bad_rate(rate):
    with pytest.raises(ScenarioError, match="--realtime = "):
        next(run_live(short(0.1), start_meshcat(), realtime_rate=rate))


def test_a_taken_port_is_told():
    first = start_meshcat()
    with pytest.raises(ScenarioError, match=f"--port = {first.port()}: give a free port"):
        start_meshcat(first.port())
