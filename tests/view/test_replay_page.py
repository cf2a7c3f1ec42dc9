"""The replay, played by a browser that has no network."""

import io

import numpy as np
import pytest
from helpers import circling_run
from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.view.replay import record_replay

pytestmark = pytest.mark.nightly("browsers")

POSES = """() => {
  const found = {};
  const root = viewer.scene_tree.find(["nonstop"]).object;
  root.updateMatrixWorld(true);
  for (const group of ["carriers", "cables"])
    for (const child of root.getObjectByName(group).children)
      found[group + "/" + child.name] = [...child.matrixWorld.elements];
  for (const name of ["load", "reference"])
    found[name] = [...root.getObjectByName(name).matrixWorld.elements];
  return found;
}"""


def seek(page, time):
    page.evaluate("(time) => { viewer.animator.seek(time); viewer.render(); }", time)


def play_slowly(page, time):
    """From time on, so slow that a busy machine sees it long before its end (when time is 0)."""
    page.evaluate(
        """(time) => {
          viewer.animator.pause();
          viewer.animator.actions.forEach((action) => (action.timeScale = 0.02));
          viewer.animator.seek(time);
          viewer.animator.play();
        }""",
        time,
    )


def opened(watched, path):
    page = watched.page
    page.goto(path.as_uri())
    page.wait_for_function("viewer.animator.actions.length > 0")
    return page


@pytest.fixture(scope="module", params=["quintic", "three_carriers"])
def replay(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    options = ["--quiet", "--no-figures", "--set", "simulation_duration=2.0"]
    assert main(["run", request.param, "--out", str(folder), *options]) == 0
    return folder / "replay.html", {"quintic": 4, "three_carriers": 3}[request.param]


def test_it_plays_offline_and_all_of_it_moves(watched, replay):
    path, n = replay
    watched.page.context.set_offline(True)
    page = opened(watched, path)
    page.evaluate("viewer.animator.pause()")
    seek(page, 1.0)
    before = page.evaluate(POSES)
    kinds = ["load", "reference"]
    kinds += [f"{kind}/{i}" for kind in ("carriers", "cables") for i in range(n)]
    assert sorted(before) == sorted(kinds)
    play_slowly(page, 1.0)
    page.wait_for_function("Math.min(...viewer.animator.actions.map((a) => a.time)) > 1.02")
    page.evaluate("viewer.animator.pause()")
    after = page.evaluate(POSES)
    for name in kinds:
        assert not np.allclose(before[name], after[name], rtol=0, atol=1e-6), name
    assert watched.errors == []
    assert [
        url for url in watched.requests if not url.startswith(("file:", "data:", "blob:"))
    ] == []


def test_the_picture_has_the_load_and_the_carriers_in_it(watched, replay):
    page = opened(watched, replay[0])
    page.evaluate("viewer.animator.pause()")
    seek(page, 1.5)
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    background = np.abs(picture - [247, 247, 250]).max(axis=2) < 12
    assert 0.3 < background.mean() < 0.97
    for colour in ("#30343b", "#0072b2", "#d55e00"):  # the load, two of the carriers
        wanted = np.frombuffer(bytes.fromhex(colour[1:]), dtype=np.uint8).astype(int)
        close = np.abs(picture - wanted).max(axis=2) < 60
        assert close.sum() > 30, colour


def test_colours_switch_and_trails_fade(watched, tmp_path):
    (tmp_path / "replay.html").write_text(record_replay(circling_run(duration=2.0)))
    page = opened(watched, tmp_path / "replay.html")
    page.evaluate("viewer.animator.pause()")
    mark = """(time) => {
      viewer.animator.seek(time);
      const material = (path) => viewer.scene_tree.find(["nonstop", ...path]).object.material;
      return [
        material(["carriers", "0", "mark", "<object>"]).color.toArray(),
        material(["cables", "0", "<object>"]).color.toArray(),
        material(["trails", "1", "0", "<object>"]).opacity,
        material(["trails", "1", "0", "<object>"]).color.toArray(),
        material(["carriers", "0", "fuselage", "<object>"]).color.toArray(),
      ];
    }"""
    instants = [page.evaluate(mark, time) for time in (0.0, 0.2, 0.8, 1.9)]
    marks, cables, opacities, trails, carriers = zip(*instants, strict=True)
    np.testing.assert_allclose(trails, carriers, atol=0.01)
    assert np.ptp(marks, axis=0).max() > 0.05
    assert np.ptp(cables, axis=0).max() > 0.05
    assert opacities[0] == 0
    assert opacities[1] > opacities[2] > opacities[3] > 0


def test_the_play_bar_pauses_seeks_and_plays(watched, replay):
    page = opened(watched, replay[0])
    play_slowly(page, 0.0)
    page.get_by_label("play or pause").click()
    assert page.evaluate("viewer.animator.playing") is False
    page.get_by_label("time").fill("1.25")
    page.wait_for_function("document.getElementById('clock').textContent === '1.25 s'")
    times = page.evaluate("viewer.animator.actions.map((a) => a.time)")
    np.testing.assert_allclose(times, 1.25)
    page.get_by_label("play or pause").click()
    page.wait_for_function("document.getElementById('clock').textContent > '1.25 s'")
    assert watched.errors == []


SEEN = """() => {
  viewer.camera.updateMatrixWorld(true);
  return viewer.scene_tree.find(["nonstop", "carriers"]).object.children.map((carrier) => {
    carrier.updateWorldMatrix(true, true);
    return carrier.position.clone().setFromMatrixPosition(carrier.matrixWorld)
      .project(viewer.camera).toArray();
  });
}"""


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1360, 900)])
def test_all_carriers_are_in_view_in_any_window(watched, replay, width, height):
    watched.page.set_viewport_size({"width": width, "height": height})
    page = opened(watched, replay[0])
    page.evaluate("viewer.animator.pause()")
    for time in (0.0, 1.0, 2.0):
        seek(page, time)
        page.wait_for_function(f"document.getElementById('clock').textContent === '{time:.2f} s'")
        across, up, _ = np.transpose(page.evaluate(SEEN))
        assert np.abs([across, up]).max() < 1
        assert np.ptp(across) > 0.3  # of 2
    boxes = {name: page.locator(name).bounding_box() for name in ("#meshcat-pane", "#overlay")}
    assert boxes["#meshcat-pane"]["height"] + boxes["#overlay"]["height"] == pytest.approx(height)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#margin").text_content().startswith("margin 0.")
    assert watched.errors == []
