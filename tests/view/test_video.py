"""Moving pictures of a run; those that a browser takes are made at night."""

import asyncio
import io
import itertools
import shutil

import numpy as np
import pytest
from helpers import circling_run
from PIL import Image, ImageSequence

from drake_nonstop.cli.main import main
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.results_folder import write_results
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.video import encode_gif, record_video


def pictures(count):
    """Pictures in PNG: a column of pixels, further to the right in each, is orange."""
    for k in range(count):
        file = io.BytesIO()
        shown = np.zeros((8, 64, 3), dtype=np.uint8)
        shown[:, k] = 240, 120, 0
        Image.fromarray(shown).save(file, format="PNG")
        yield file.getvalue()


@pytest.mark.parametrize("rate", [7.0, 12.0, 50.0])
def test_a_gif_has_all_pictures_and_their_time_to_the_rounding_of_a_frame(rate):
    with Image.open(io.BytesIO(encode_gif([*pictures(24)], rate))) as made:
        assert made.info["loop"] == 0
        frames = [
            (np.asarray(frame.convert("RGB"))[0], frame.info["duration"])
            for frame in ImageSequence.Iterator(made)
        ]
    rows, durations = zip(*frames, strict=True)
    assert [int(row[:, 0].argmax()) for row in rows] == [*range(24)]
    np.testing.assert_array_equal(rows[5][5], [240, 120, 0])
    np.testing.assert_allclose(np.cumsum(durations), 1000 * np.arange(1, 25) / rate, atol=5)


@pytest.mark.parametrize(
    ("given", "field", "value", "remedy"),
    [
        ({"start": 0.4, "stop": 0.4}, "stop", "0.4", "0 s to 0.5 s"),
        ({"stop": 9.0}, "stop", "9.0", "0 s to 0.5 s"),
        ({"frame_rate": 60.0}, "frame_rate", "60.0", "1 to 50"),
        ({"speed": 1e-7}, "speed", "1e-07", "at least 0.001"),
        ({"size": (640, 20)}, "height", "20", "64 to 4096"),
    ],
)
def test_arguments_out_of_range_are_refused(given, field, value, remedy):
    with pytest.raises(ScenarioError) as refused:
        record_video(circling_run(duration=0.5), **given)
    assert str(refused.value).startswith(f"{field} = {value}: ")
    assert remedy in str(refused.value)


def test_without_a_browser_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setenv("PLAYWRIGHT_BROWSERS_PATH", "/nowhere")
    with pytest.raises(ScenarioError, match=r"^browser = none: install one .*`playwright install"):
        record_video(circling_run(duration=0.5))


@pytest.mark.nightly("browsers")
@pytest.mark.usefixtures("needs_browser")
def test_a_notebook_with_its_running_event_loop_takes_a_gif():
    async def cell():
        return record_video(circling_run(duration=0.1), size=(64, 64))

    assert asyncio.run(cell()).startswith(b"GIF")


@pytest.mark.nightly("browsers")
@pytest.mark.usefixtures("needs_browser")
def test_the_command_takes_a_gif_of_a_part_of_a_stored_run(tmp_path, capsys):
    run = simulate(load_scenario("quintic", ["simulation_duration=2"]))
    write_results(run, tmp_path / "run", figures=False, replay=False)
    times = ["--start", "0.5", "--stop", "1.5", "--speed", "2", "--frame-rate", "10"]
    command = ["video", str(tmp_path / "run"), "--size", "320x240", *times]
    assert main(command) == 0
    assert "written: " in capsys.readouterr().out
    with Image.open(tmp_path / "run" / "video.gif") as made:
        assert made.size == (320, 240)
        assert made.n_frames == 6  # 1 s at twice the speed, with both ends
        frames = [np.asarray(f.convert("RGB")).astype(int) for f in ImageSequence.Iterator(made)]
    moved = [(np.abs(a - b).max(axis=2) > 60).sum() for a, b in itertools.pairwise(frames)]
    assert min(moved) > 20  # pixels
    assert not list((tmp_path / "run").glob(".new-*"))
