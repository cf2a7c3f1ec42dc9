"""The page of a replay; test_replay_page.py plays it in a browser."""

import base64
import gzip
import re

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from helpers import circling_run

from drake_nonstop.run.run import Run
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.obstacles import GroundConfig
from drake_nonstop.view import replay
from drake_nonstop.view.replay import record_replay

MEGABYTE = 1e6


@pytest.fixture(scope="module")
def simulated():
    scenario = load_scenario("quintic")
    scenario.simulation_duration = 0.5
    return simulate(scenario)


def shortened(run, samples):
    signals = {name: values[:samples].copy() for name, values in run.signals.items()}
    return Run(**{**vars(run), "time": run.time[:samples], "signals": signals})


def commands(html):
    """What the page tells the viewer, each in msgpack."""
    for kind, text in re.findall(r"application/(octet-binary|gzip);base64,([\w+/=]+)", html):
        content = base64.b64decode(text)
        yield gzip.decompress(content) if kind == "gzip" else content


def paths(html):
    """The scene's bodies that have an object in the page."""
    objects = [content for content in commands(html) if b"set_object" in content]
    path = rb"/nonstop/(load|reference|carriers/\d+|cables/\d+)\b"
    return {found.decode() for content in objects for found in re.findall(path, content)}


def expected_paths(n):
    return {"load", "reference"} | {f"{k}/{i}" for k in ("carriers", "cables") for i in range(n)}


def polyline(html, index):
    points = re.findall(r'points="([^"]*)"', html)[index]
    return np.array([pair.split(",") for pair in points.split()], dtype=float)


def test_page_refers_to_nothing_outside(simulated):
    html = record_replay(simulated)
    assert "<script" in html
    tags = re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", html)
    assert not [tag for tag in tags if re.search(r"\b(src|href)\s*=", tag)]
    addresses = re.findall(r"""fetch\(["'](.{0,40})""", html)
    assert addresses
    assert all(address.startswith("data:") for address in addresses)


@pytest.mark.parametrize("n", [3, 6])
def test_page_shows_all_bodies(n):
    assert paths(record_replay(circling_run(n))) == expected_paths(n)


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("n", [4, 12])
def test_a_long_replay_has_fewer_frames_and_stays_below_twenty_megabytes(n, monkeypatch):
    part = 20  # of a run of 2,000 s
    empty = len(record_replay(circling_run(n, duration=0.01)))
    assert len(record_replay(circling_run(n, duration=30.0))) < n / 4 * 5 * MEGABYTE
    monkeypatch.setattr(replay, "_MOST_POSES", replay._MOST_POSES // part)
    run = circling_run(n, duration=2000.0 / part)
    run.signal("carrier_state")[5003, 3 * n :] *= 0.1  # a sample between two frames
    html = record_replay(run)
    assert empty + part * (len(html) - empty) < 20 * MEGABYTE
    slowest = polyline(html, 1)
    assert len(slowest) < len(run.time)
    assert slowest[slowest[:, 1].argmin(), 0] == 50.03


def slowest_speeds(run, end):
    velocities = run.signal("carrier_state")[:end, 12:].reshape(-1, 4, 3)
    return np.linalg.norm(velocities, axis=2).min(axis=1)


def test_page_compares_the_slowest_carrier_with_the_bound(simulated):
    html = record_replay(simulated)
    bound, slowest = polyline(html, 0), polyline(html, 1)
    speeds = slowest_speeds(simulated, 49)  # to the last frame, of 12.5 Hz
    np.testing.assert_allclose(bound[:, 1], 0.55)
    np.testing.assert_allclose(slowest[:, 0], simulated.time[:49], atol=1e-6)
    np.testing.assert_allclose(slowest[:, 1], speeds, rtol=1e-3)
    text = re.search(r"least margin (\S+) m/s at (\S+) s", html)
    assert float(text[1]) == pytest.approx(speeds.min() - 0.55, rel=5e-3)
    assert float(text[2]) == pytest.approx(simulated.time[speeds.argmin()])
    for part in (b"/nonstop/paths/flown", b"/nonstop/paths/desired", b"/nonstop/goal/bar0"):
        assert any(part in text and b"set_object" in text for text in commands(html)), part


def test_the_name_is_escaped_and_the_legend_has_what_there_is():
    run = circling_run()
    assert ">obstacle<" not in record_replay(run)
    run.scenario.name = "<b>&"
    run.scenario.obstacles = [GroundConfig(height=-3.0)]
    html = record_replay(run)
    assert "&lt;b&gt;&amp;" in html
    assert ">obstacle<" in html


@pytest.mark.parametrize(("samples", "broken", "shown"), [(1, 1, 1), (2, 2, 1), (51, 40, 33)])
def test_samples_from_the_first_that_is_not_finite_are_left_out(simulated, samples, broken, shown):
    run = shortened(simulated, samples)
    run.signal("carrier_state")[broken : broken + 1, 2] = np.nan
    run.signal("load_state")[45:, 4] = np.inf
    html = record_replay(run)
    assert len(polyline(html, 1)) == shown
    assert paths(html) == expected_paths(4)


@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0])
def test_run_without_a_usable_sample_gives_an_empty_page(simulated, broken):
    run = shortened(simulated, 1)
    run.signal("load_state")[:] = broken
    assert paths(record_replay(run)) == set()


def test_page_of_aircraft_compares_the_nearest_with_its_stall():
    run = aircraft_run(2.0, wind=(2.0, 0.0, 0.0))
    html = record_replay(run)
    stall, nearest = polyline(html, 0), polyline(html, 1)
    np.testing.assert_array_equal(stall[:, 1], 1)
    state = run.signal("aircraft_state")
    shares = np.maximum(state[:, :4] / 1.4, (8.369 / state[:, 12:]) ** 2).max(axis=1)
    np.testing.assert_allclose(nearest[:, 1], shares, rtol=1e-3)
    (animation,) = (each for each in commands(html) if b"set_animation" in each)
    assert b"carriers/0/wing/<object>" in animation
    assert b"mark" not in animation
