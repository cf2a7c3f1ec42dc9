"""The control figure of a replay: every wire has the values of its signal at the time shown."""

import base64
import copy
import gzip
import json
import re

import numpy as np
import pytest

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.view.replay import record_replay


@pytest.fixture(scope="module")
def run(fleet):
    flown = copy.copy(fleet.run("quintic"))
    flown.diagram = make_nonstop(flown.scenario)
    return flown


def numbers_of(html):
    """Each signal's numbers (samples, size) in a page, and their times."""
    (data,) = re.findall(r'id="signals">(.*?)</script>', html)
    told = json.loads(data)
    planes = np.frombuffer(gzip.decompress(base64.b64decode(_packed(html))), np.uint8)
    table = planes.reshape(4, -1).T.copy().view("<f4").reshape(-1, len(told["times"])).T
    signals = {
        name: table[:, each["first"] : each["first"] + len(each["entries"])]
        for name, each in told["signals"].items()
    }
    return np.array(told["times"]), signals


def _packed(html):
    return re.findall(r'fetch\("data:application/gzip;base64,([\w+/=]+)"\)\n *\.then\(\(', html)[0]


def test_a_page_has_the_numbers_of_all_signals_at_the_frames_of_its_scene(run):
    times, signals = numbers_of(record_replay(run, frame_rate=10))
    np.testing.assert_allclose(times, run.time[::10])
    assert [*signals] == [*run.signals]
    for name, values in run.signals.items():
        np.testing.assert_allclose(signals[name], values[::10], rtol=3e-4, atol=1e-30)
    assert 'id="signals"' not in record_replay(run, has_figure=False)


@pytest.mark.nightly("browsers")
def test_wires_show_their_values_at_the_time_of_the_scene(watched, run, tmp_path):
    (tmp_path / "replay.html").write_text(record_replay(run))
    page = watched.page
    page.set_viewport_size({"width": 1360, "height": 900})
    page.goto((tmp_path / "replay.html").as_uri())
    page.wait_for_function("viewer.animator.actions.length > 0")
    page.get_by_label("time").fill("4")
    tension = run.signal("tensions")[400]
    wire = page.locator('[data-signal="cables.tensions"]')
    page.wait_for_function("document.getElementById('clock').textContent === '4.00 s'")
    assert wire.locator(".value").text_content() == f"{min(tension):.2g} … {max(tension):.2g} N"
    wire.locator("path").dispatch_event("click")
    shown = page.locator("#values b").all_text_contents()
    assert shown == [f"{value:.3g} N" for value in tension]
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.get_by_label("rate").select_option("2")
    assert page.evaluate("viewer.animator.actions.every((action) => action.timeScale === 2)")
    page.get_by_role("button", name="control figure").click()
    assert not page.locator("#figure").is_visible()
    assert watched.errors == []
