"""Moving pictures of a run: its replay, taken frame by frame by a browser."""

import io
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.run.run import Run
from drake_nonstop.validation import require, require_positive, require_whole
from drake_nonstop.view.browser import open_browser, outside_event_loop
from drake_nonstop.view.replay import record_replay

FRAME_RATE, SIZE = 20.0, (640, 480)  # 1/s of the video; pixels
_MOST_RATE = 50.0  # 1/s; browsers slow down faster GIFs
_MOST_PICTURES = 10_000
_PALETTE_FRAMES = 6  # whose colours a GIF has

_PREPARE = """() => {
  viewer.animator.pause();
  viewer.gui.domElement.style.display = "none";
  window.dispatchEvent(new Event("resize"));
}"""
# The viewer draws in the next frame of the page, before what is called here.
_SEEK = """(time) => new Promise((drawn) => {
  viewer.animator.seek(time);
  requestAnimationFrame(drawn);
})"""


def _replay_pictures(page: Any, run: Run, times: Iterable[float]) -> Iterator[bytes]:
    """Pictures of a run's replay at times in s, as PNG; the browser's page is as large as they."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "replay.html"
        path.write_text(record_replay(run, has_figure=False), encoding="utf-8")
        page.goto(f"{path.as_uri()}#embedded")
        page.wait_for_function("viewer.animator.actions.length > 0")
        page.evaluate(_PREPARE)
        for time in times:
            page.evaluate(_SEEK, float(time - run.time[0]))
            yield page.screenshot()


def record_video(
    run: Run,
    *,
    start: float | None = None,
    stop: float | None = None,
    speed: float = 1.0,
    frame_rate: float = FRAME_RATE,
    size: tuple[int, int] = SIZE,
    progress: Callable[[str, float], None] | None = None,
) -> bytes:
    """The content of a GIF of the run's replay.

    Args:
        run: the run.
        start: s, the first instant shown (default: of the run).
        stop: s, the last instant shown (default: of the run).
        speed: simulated s per s of the video.
        frame_rate: pictures per s of the video.
        size: width and height in pixels.
        progress: called with a description of the task and the share of it that is done.

    Raises:
        ScenarioError: an argument is out of range, or Chromium or Playwright is missing.
    """
    require_positive("speed", speed)
    remedy = f"give 1 to {_MOST_RATE:g} pictures per s"
    require(1 <= frame_rate <= _MOST_RATE, "frame_rate", frame_rate, remedy)
    for name, pixels in zip(("width", "height"), size, strict=True):
        require_whole(name, pixels, 64, 4096)
    require(len(run.time) > 0, "run", run, "give one that has flown")
    first, last = float(run.time[0]), float(run.time[-1])
    start, stop = first if start is None else start, last if stop is None else stop
    span = f"give times from {first:g} s to {last:g} s, which the run has"
    require(first <= start < last, "start", start, span)
    require(start < stop <= last, "stop", stop, f"{span}, later than the start")
    count = (stop - start) * frame_rate / speed
    remedy = f"give at least {speed * count / _MOST_PICTURES:.3g}, for {_MOST_PICTURES} pictures"
    require(count <= _MOST_PICTURES, "speed", speed, remedy)
    times = np.arange(start, stop + 1e-6, speed / frame_rate)

    def take() -> list[bytes]:
        pictures: list[bytes] = []
        with open_browser(*size) as page:
            for picture in _replay_pictures(page, run, times):
                pictures.append(picture)
                if progress is not None:
                    progress("video", len(pictures) / len(times))
        return pictures

    return encode_gif(outside_event_loop(take), frame_rate)


def encode_gif(pictures: Sequence[bytes], frame_rate: float) -> bytes:
    """A GIF that repeats, of pictures in any format of Pillow's."""
    from PIL import Image  # imported here: nothing else needs it

    def opened(some: Sequence[bytes]) -> Iterator[Image.Image]:
        return (Image.open(io.BytesIO(picture)).convert("RGB") for picture in some)

    some = pictures[:: max(len(pictures) // _PALETTE_FRAMES, 1)]
    several = np.concatenate([np.asarray(picture) for picture in opened(some)])
    palette = Image.fromarray(several).quantize(256)  # one for all, or colours would flicker
    plain = Image.Dither.NONE
    frames = (picture.quantize(palette=palette, dither=plain) for picture in opened(pictures))
    # A GIF counts in 1/100 s: rounded frame by frame, the video would be too fast or too slow.
    ends = np.round(np.arange(len(pictures) + 1) * 100 / frame_rate).astype(int)
    times = (10 * np.diff(ends)).tolist()  # ms
    file, options = io.BytesIO(), {"save_all": True, "loop": 0, "duration": times}
    next(frames).save(file, format="GIF", append_images=frames, **options)
    return file.getvalue()
