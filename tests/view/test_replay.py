"""The page of a replay, decoded by msgpack, and by night played by a browser without network."""

import base64
import copy
import gzip
import html
import io
import json
import re

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from helpers import circling_run, rotation
from PIL import Image
from scenes import Recording, Screen, instant, watch

from drake_nonstop import Run, make_nonstop, record_replay
from drake_nonstop.run.run_quantities import carrier_speeds
from drake_nonstop.scenario.loading import load_scenario

STRIDE, RATE = 8, 12.5  # samples of a frame, frames per s
BODIES = r"/nonstop/(load|reference|carriers/\d+|cables/\d+)\b"
CAMERA = "/Cameras/default/rotated/<object>"


@pytest.fixture(scope="module")
def quintic(fleet):
    return shortened(fleet.run("quintic"), 51)


def shortened(run, samples):
    signals = {name: values[:samples].copy() for name, values in run.signals.items()}
    return Run(**{**vars(run), "time": run.time[:samples], "signals": signals})


def expected_bodies(n):
    return {"load", "reference"} | {f"{k}/{i}" for k in ("carriers", "cables") for i in range(n)}


def polyline(page, index):
    points = re.findall(r'points="([^"]*)"', page)[index]
    return np.array([pair.split(",") for pair in points.split()], dtype=float)


def linear(colour):
    """The linear values of sRGB's channels."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def test_a_recording_shows_in_every_frame_what_a_visualizer_does():
    run = circling_run(duration=3.0)
    recording, frames = Recording(record_replay(run)), range(0, len(run.time), STRIDE)
    instants = [instant(run, row) for row in frames]
    for frame, screen in enumerate(watch(run.scenario, instants, Screen())):
        for path in screen.colours.keys() & screen.matrices.keys() | {"/nonstop/load"}:
            matrix = screen.matrices[path]
            if f"{path}.position" not in recording.tracks:
                continue
            if recording.tracks[f"{path}.position"][0][0] <= frame:  # it is there already
                place = recording.at(frame, f"{path}.position")
                np.testing.assert_allclose(place, matrix[:3, 3], atol=1e-12)
                turned = rotation(np.roll(recording.at(frame, f"{path}.quaternion"), 1))
                length = np.linalg.norm(matrix[:3, 2])
                np.testing.assert_allclose(turned[:, 2] * length, matrix[:3, 2], atol=1e-9)
                if f"{path}.scale" in recording.tracks:
                    scale = recording.at(frame, f"{path}.scale")
                    np.testing.assert_allclose(scale, [1, 1, length], rtol=5e-3)
        for path, colour in screen.colours.items():
            found = recording.at(frame, f"{path}/<object>.material.color")
            np.testing.assert_allclose(found, linear(colour[:3]), atol=1e-12, err_msg=path)
            opacity = recording.at(frame, f"{path}/<object>.material.opacity")
            step = 1 / 8 if "/trails/" in path else 1e-12  # that fades meanwhile
            assert opacity == pytest.approx(colour[3], abs=step)
    last = {times[-1] for times, _ in recording.tracks.values()}
    assert last == {len(frames) - 1}  # shorter tracks would start again early
    counts = [len(times) for times, _ in recording.tracks.values()]
    assert np.mean(counts) < len(frames) / 4  # values that do not change are left out


def projected(recording, points):
    """Points (k, 3) in shares of a window of the aspect ratio 1, from -1 to 1, right and up."""
    points = points @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # y is up in the viewer
    eye = np.array(recording.value(CAMERA, "position"))
    (target,) = (np.array(each["value"]) for each in recording.of_type("set_target"))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 1, 0]) / np.linalg.norm(np.cross(ahead, [0, 1, 0]))
    slope = np.tan(np.radians(recording.value(CAMERA, "fov") / 2))
    depth = (points - eye) @ ahead
    return (
        (points - eye) @ np.column_stack([right, np.cross(right, ahead)]) / depth[:, None] / slope
    )


@pytest.mark.parametrize(("duration", "follows"), [(3.0, False), (20.0, True)])
def test_the_camera_sees_all_and_on_a_long_way_only_follows_the_reference(duration, follows):
    run = circling_run(duration=duration)
    page = record_replay(run)
    recording = Recording(page)
    assert ("/nonstop.position" in recording.tracks) == follows
    assert ("/Grid.position" in recording.tracks) == follows
    loads, seen = [], []
    for frame in range(len(range(0, len(run.time), STRIDE))):
        shift = recording.at(frame, "/nonstop.position") if follows else np.zeros(3)
        bodies = [f"/nonstop/carriers/{i}.position" for i in range(4)]
        places = [recording.at(frame, path) + shift for path in ("/nonstop/load.position", *bodies)]
        across = projected(recording, np.array(places))
        seen += [*across]
        loads.append(across[0])
    right, up = np.abs(seen).max(axis=0)
    aspect = float(re.search(r"aspect / ([\d.]+)\)", page)[1])
    assert 0.6 < max(right / 1.5, up) < 1
    assert 0.7 < right / aspect < 1
    way = loads[-1] - loads[0]
    assert np.abs(way).max() < 1e-9 if follows else way[0] > 5 * abs(way[1])  # to the right


def test_the_camera_disregards_carriers_far_from_the_load():
    run = circling_run()
    near = Recording(record_replay(run))
    run.signal("carrier_state")[:, 6] = 1e5
    far = Recording(record_replay(run))
    assert far.value(CAMERA, "far") < 2 * near.value(CAMERA, "far")


def test_the_paths_and_the_goal_are_drawn(quintic):
    objects = Recording(record_replay(quintic)).objects()
    assert "/nonstop/goal/bar0" in objects
    radii = []
    for name, port in (("flown", "load_state"), ("desired", "reference")):
        (geometry,) = objects[f"/nonstop/paths/{name}"]["geometries"]
        data = geometry["data"]["attributes"]["position"]["array"].data
        vertices = np.frombuffer(data, dtype=np.float32).reshape(-1, 3)
        path = quintic.signal(port)[:49, 4:7]
        distances = np.linalg.norm(vertices[:, None] - path[::STRIDE], axis=2).min(axis=1)
        radii.append(distances.max())
        np.testing.assert_allclose(distances, distances.max(), rtol=1e-2)
    assert radii[1] > 2 * radii[0]  # the desired path encloses the flown one


def test_the_page_refers_to_nothing_outside(quintic):
    page = record_replay(quintic)
    assert "<script" in page
    tags = re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", page)
    assert not [tag for tag in tags if re.search(r"\b(src|href)\s*=", tag)]
    addresses = re.findall(r"""fetch\(["'](.{0,40})""", page)
    assert addresses
    assert all(address.startswith("data:") for address in addresses)
    (frame,) = re.findall(r'srcdoc="([^"]*)"', page._repr_html_())
    assert html.unescape(frame) == page


@pytest.mark.nightly("flights")
def test_a_long_replay_has_fewer_frames_and_stays_below_twenty_megabytes():
    assert len(record_replay(circling_run(4, duration=30.0))) < 5e6
    run = circling_run(12, duration=2000.0)
    run.signal("carrier_state")[5003, 36:] *= 0.1  # a sample between two frames
    page = record_replay(run)
    assert len(page) < 20e6
    slowest = polyline(page, 1)
    assert len(slowest) < len(run.time)
    assert slowest[slowest[:, 1].argmin(), 0] == 50.03


def test_the_page_compares_the_slowest_carrier_with_the_bound(quintic):
    page = record_replay(quintic)
    bound, slowest = polyline(page, 0), polyline(page, 1)
    speeds = carrier_speeds(quintic.signal("carrier_state")).min(axis=1)[:49]  # to the last frame
    np.testing.assert_allclose(bound[:, 1], 0.55)
    np.testing.assert_allclose(slowest[:, 0], quintic.time[:49], atol=1e-6)
    np.testing.assert_allclose(slowest[:, 1], speeds, rtol=1e-3)
    text = re.search(r"least margin (\S+) m/s at (\S+) s", page)
    assert float(text[1]) == pytest.approx(speeds.min() - 0.55, rel=5e-3)
    assert float(text[2]) == pytest.approx(quintic.time[speeds.argmin()])


def test_the_page_of_aircraft_compares_the_nearest_with_its_stall():
    run = aircraft_run(2.0, wind=(2.0, 0.0, 0.0))
    page = record_replay(run)
    stall, nearest = polyline(page, 0), polyline(page, 1)
    np.testing.assert_array_equal(stall[:, 1], 1)
    state = run.signal("aircraft_state")
    shares = np.maximum(state[:, :4] / 1.4, (8.369 / state[:, 12:]) ** 2).max(axis=1)
    np.testing.assert_allclose(nearest[:, 1], shares, rtol=1e-3)
    tracks = Recording(page).tracks
    assert "/nonstop/carriers/0/wing/<object>.material.color" in tracks
    assert not [track for track in tracks if "mark" in track]


def test_the_name_is_escaped_and_the_legend_has_what_there_is():
    run = circling_run()
    assert ">obstacle<" not in record_replay(run)
    run.scenario.name = "<b>&"
    ground = load_scenario("quintic", ["obstacles=[!Ground {height: -3.0}]"]).obstacles
    run.scenario.obstacles = ground
    page = record_replay(run)
    assert "&lt;b&gt;&amp;" in page
    assert ">obstacle<" in page


@pytest.mark.parametrize(
    ("samples", "broken", "shown"), [(1, 1, 1), (2, 2, 1), (51, 40, 33), (51, 99, 41), (1, 0, 0)]
)
def test_samples_from_the_first_that_cannot_be_shown_are_left_out(quintic, samples, broken, shown):
    run = shortened(quintic, samples)
    run.signal("carrier_state")[broken : broken + 1, 2] = np.nan
    run.signal("load_state")[45:, :4] = 0.0
    page = record_replay(run)
    bodies = {match[1] for path in Recording(page).objects() if (match := re.match(BODIES, path))}
    assert bodies == (expected_bodies(4) if shown else set())
    assert not shown or len(polyline(page, 1)) == shown


browsers = pytest.mark.nightly("browsers")
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
PLAY_SLOWLY = """(time) => {
  viewer.animator.pause();
  viewer.animator.actions.forEach((action) => (action.timeScale = 0.02));
  viewer.animator.seek(time);
  viewer.animator.play();
}"""  # so that a busy machine sees it long before its end
LOOK = """() => {
  const material = (path) => viewer.scene_tree.find(["nonstop", ...path]).object.material;
  return [
    material(["carriers", "0", "mark", "<object>"]).color.toArray(),
    material(["cables", "0", "<object>"]).color.toArray(),
    [material(["trails", "1", "0", "<object>"]).opacity],
  ];
}"""
SEEN = """() => {
  viewer.camera.updateMatrixWorld(true);
  return viewer.scene_tree.find(["nonstop", "carriers"]).object.children.map((carrier) => {
    carrier.updateWorldMatrix(true, true);
    return carrier.position.clone().setFromMatrixPosition(carrier.matrixWorld)
      .project(viewer.camera).toArray();
  });
}"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The page of a flight of 2 s, in which all that a scene shows changes."""
    path = tmp_path_factory.mktemp("page") / "replay.html"
    path.write_text(record_replay(circling_run(duration=2.0)), encoding="utf-8")
    return path


def opened(watched, path):
    """The page, paused."""
    watched.page.context.set_offline(True)
    watched.page.goto(path.as_uri())
    watched.page.wait_for_function("viewer.animator.actions.length > 0")
    watched.page.evaluate("viewer.animator.pause()")
    return watched.page


def seek(page, time):
    page.evaluate("(time) => { viewer.animator.seek(time); viewer.render(); }", time)


@browsers
def test_it_plays_offline_and_all_of_it_moves_in_its_colours(watched, flown):
    page = opened(watched, flown)
    seek(page, 0.2)
    looks = page.evaluate(LOOK)
    seek(page, 1.0)
    for before, after in zip(looks, page.evaluate(LOOK), strict=True):  # also a fading trail's
        assert np.ptp([before, after], axis=0).max() > 0.05
    before = page.evaluate(POSES)
    assert before.keys() == expected_bodies(4)
    page.evaluate(PLAY_SLOWLY, 1.0)
    page.wait_for_function("Math.min(...viewer.animator.actions.map((a) => a.time)) > 1.02")
    page.get_by_label("play or pause").click()
    assert page.evaluate("viewer.animator.playing") is False
    for name, matrix in page.evaluate(POSES).items():
        assert not np.allclose(before[name], matrix, rtol=0, atol=1e-6), name
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    background = np.abs(picture - [247, 247, 250]).max(axis=2) < 12
    assert 0.3 < background.mean() < 0.97
    for colour in ("30343b", "0072b2", "d55e00"):  # the load, two of the carriers
        close = np.abs(picture - [*bytes.fromhex(colour)]).max(axis=2) < 60
        assert close.sum() > 30, colour
    page.get_by_label("time").fill("1.25")
    page.wait_for_function("document.getElementById('clock').textContent === '1.25 s'")
    times = page.evaluate("viewer.animator.actions.map((a) => a.time)")
    np.testing.assert_allclose(times, 1.25)
    page.get_by_label("play or pause").click()
    page.wait_for_function("document.getElementById('clock').textContent > '1.25 s'")
    assert watched.errors == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in watched.requests)


@browsers
@pytest.mark.parametrize(("width", "height"), [(390, 844), (1360, 900)])
def test_all_carriers_are_in_view_in_any_window(watched, flown, width, height):
    watched.page.set_viewport_size({"width": width, "height": height})
    page = opened(watched, flown)
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


@pytest.fixture(scope="module")
def with_figure(fleet):
    flown = copy.copy(fleet.run("quintic"))
    flown.diagram = make_nonstop(flown.scenario)
    return flown


def numbers_of(page):
    """Each signal's numbers (samples, size) in a page, and their times."""
    told = json.loads(re.search(r'id="signals">(.*?)</script>', page)[1])
    packed = re.search(r'"data:application/gzip;base64,([\w+/=]+)"\)\n *\.then\(\(', page)[1]
    planes = np.frombuffer(gzip.decompress(base64.b64decode(packed)), np.uint8)
    table = planes.reshape(4, -1).T.copy().view("<f4").reshape(-1, len(told["times"])).T
    signals = {
        name: table[:, each["first"] : each["first"] + len(each["entries"])]
        for name, each in told["signals"].items()
    }
    return np.array(told["times"]), signals


def test_a_page_has_the_numbers_of_all_signals_at_the_frames_of_its_scene(with_figure):
    times, signals = numbers_of(record_replay(with_figure, frame_rate=10))
    np.testing.assert_allclose(times, with_figure.time[::10])
    assert [*signals] == [*with_figure.signals]
    for name, values in with_figure.signals.items():
        np.testing.assert_allclose(signals[name], values[::10], rtol=3e-4, atol=1e-30)
    assert 'id="signals"' not in record_replay(with_figure, has_figure=False)


@browsers
def test_wires_show_their_values_at_the_time_of_the_scene(watched, with_figure, tmp_path):
    (tmp_path / "replay.html").write_text(record_replay(with_figure))
    page = watched.page
    page.set_viewport_size({"width": 1360, "height": 900})
    page.goto((tmp_path / "replay.html").as_uri())
    page.wait_for_function("viewer.animator.actions.length > 0")
    page.get_by_label("time").fill("4")
    tension = with_figure.signal("tensions")[400]
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
