"""The page of a study: one bar for all replays."""

import pytest

from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.presets import ablate

TIMES = "Math.max(...viewer.animator.actions.map((action) => action.time))"


@pytest.fixture(scope="module")
def page_path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ablation")
    scenario = load_scenario("line", ["simulation_duration=1.0"])
    ablate(scenario, {"printed": ["phase=PaperPhase"]}, folder)
    return folder / "index.html"


@pytest.mark.nightly("browsers")
def test_the_bar_drives_both_replays(watched, page_path):
    page = watched.page
    page.set_viewport_size({"width": 900, "height": 900})
    page.goto(page_path.as_uri())
    page.locator("#cards").scroll_into_view_if_needed()
    replays = [frame for frame in page.frames if frame.url.endswith("#embedded")]
    assert len(replays) == 2
    for frame in replays:
        frame.wait_for_function("viewer.animator.actions.length > 0 && !viewer.animator.playing")
    page.locator("#time").fill("0.6")
    for frame in replays:
        frame.wait_for_function(f"Math.abs({TIMES} - 0.6) < 1e-6")
        assert not frame.locator("#play").is_visible()  # the page has the one for all
    page.locator("#restart").click()
    for frame in replays:
        frame.wait_for_function(f"{TIMES} > 0.9")  # to the end, where all wait
    assert page.locator("#clock").inner_text().startswith("1.00")
    assert watched.errors == []
    assert all(request.startswith(("file:", "data:", "blob:")) for request in watched.requests)
