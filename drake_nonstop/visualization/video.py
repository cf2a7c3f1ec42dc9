"""Moving pictures of a run: its replay, taken frame by frame by a browser."""

import io
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.simulation.run import Run
from drake_nonstop.validation import ScenarioError, require, require_positive, require_whole
from drake_nonstop.visualization.browser import open_browser
from drake_nonstop.visualization.replay import record_replay

FORMATS = ("gif", "mp4")
FRAME_RATE = 20.0  # 1/s of the video
_MOST_RATE = {"gif": 50.0, "mp4": 120.0}  # 1/s; browsers slow down faster GIFs
SIZE = 640, 480  # pixels
_LEAST_SIZE, _MOST_SIZE = 64, 4096  # pixels
_PALETTE_FRAMES = 6  # whose colours a GIF has

# A replay without its controls, in the time of the run; at most the strip stays below the scene.
_PREPARE = """(has_strip) => {
  viewer.animator.pause();
  viewer.gui.domElement.style.display = "none";
  if (!has_strip) {
    document.getElementById("overlay").style.display = "none";
  }
  window.dispatchEvent(new Event("resize"));
}"""
# The viewer draws in the next frame of the page, before what is called here.
_SEEK = """(time) => new Promise((drawn) => {
  viewer.animator.seek(time);
  requestAnimationFrame(drawn);
})"""


def replay_pictures(
    page: Any, run: Run, times: Iterable[float], *, has_strip: bool = False
) -> Iterator[bytes]:
    """Pictures of a run's replay at times in s, as PNG; the browser's page is as large as they.

    With `has_strip` they have the plot of the replay below the scene.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "replay.html"
        path.write_text(record_replay(run), encoding="utf-8")
        page.goto(f"{path.as_uri()}#embedded")
        page.wait_for_function("viewer.animator.actions.length > 0")
        page.evaluate(_PREPARE, has_strip)
        for time in times:
            page.evaluate(_SEEK, float(time - run.time[0]))
            yield page.screenshot()


def record_video(
    run: Run,
    kind: str = "gif",
    *,
    start: float | None = None,
    stop: float | None = None,
    speed: float = 1.0,
    frame_rate: float = FRAME_RATE,
    size: tuple[int, int] = SIZE,
    has_strip: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> bytes:
    """The content of a file with a moving picture of the run's replay.

    Args:
        run: what is shown.
        kind: of file, "gif" or "mp4"; the latter needs ffmpeg.
        start: s, the first instant shown (the run's).
        stop: s, the last (the run's).
        speed: simulated s per s of the video.
        frame_rate: pictures per s of the video.
        size: width and height in pixels, even numbers for an mp4.
        has_strip: whether the plot of the slowest carrier's speed and ε is below the scene.
        progress: called with what is being done and the share of it that is done.

    Raises:
        ScenarioError: an argument is out of range, or Chromium, Playwright or ffmpeg is missing.
    """
    times = _frame_times(run, kind, start, stop, speed, frame_rate)
    for name, pixels in zip(("width", "height"), size, strict=True):
        require_whole(name, pixels, _LEAST_SIZE, _MOST_SIZE)
        require(kind == "gif" or pixels % 2 == 0, name, pixels, "give an even number for an mp4")
    encode = encode_gif if kind == "gif" else encode_mp4
    if kind == "mp4":
        _find_ffmpeg()
    pictures = []
    with open_browser(*size) as page:
        for picture in replay_pictures(page, run, times, has_strip=has_strip):
            pictures.append(picture)
            if progress is not None:
                progress("video", len(pictures) / len(times))
    return encode(pictures, frame_rate)


def _frame_times(
    run: Run, kind: str, start: float | None, stop: float | None, speed: float, frame_rate: float
) -> NDArray:
    """Instants of the frames, s; raises ScenarioError where there can be none."""
    require(kind in FORMATS, "kind", kind, f"give {' or '.join(FORMATS)}")
    require_positive("speed", speed)
    require_positive("frame_rate", frame_rate)
    most = _MOST_RATE[kind]
    require(frame_rate <= most, "frame_rate", frame_rate, f"give at most {most:g} for {kind}")
    require(len(run.time) > 0, "run", run, "give one that has flown")
    first, last = float(run.time[0]), float(run.time[-1])
    start, stop = first if start is None else start, last if stop is None else stop
    within = f"from {first:g} s to {last:g} s, which the run has"
    require(first <= start < last, "start", start, f"give a time {within}")
    require(start < stop <= last, "stop", stop, f"give a later time than the start, {within}")
    count = math.floor((stop - start) * frame_rate / speed + 1e-6) + 1
    return start + np.arange(count) * speed / frame_rate


def encode_gif(pictures: Sequence[bytes], frame_rate: float) -> bytes:
    """A GIF that repeats, of pictures in any format of Pillow's."""
    from PIL import Image  # imported here: nothing else needs it

    def opened(some: Sequence[bytes]) -> Iterator[Image.Image]:
        return (Image.open(io.BytesIO(picture)).convert("RGB") for picture in some)

    some = pictures[:: max(len(pictures) // _PALETTE_FRAMES, 1)]
    several = np.concatenate([np.asarray(picture) for picture in opened(some)])
    palette = Image.fromarray(several).quantize(256)  # one for all, or colours would flicker
    frames = (
        picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in opened(pictures)
    )
    # A GIF counts in 1/100 s: rounded frame by frame, the video would be too fast or too slow.
    ends = np.round(np.arange(len(pictures) + 1) * 100 / frame_rate).astype(int)
    file = io.BytesIO()
    next(frames).save(
        file,
        format="GIF",
        save_all=True,
        append_images=frames,
        duration=(10 * np.diff(ends)).tolist(),
        loop=0,
    )
    return file.getvalue()


def _find_ffmpeg() -> str:
    path = shutil.which("ffmpeg")
    remedy = "install it (`apt install ffmpeg`, `brew install ffmpeg`), or write a .gif"
    require(path is not None, "ffmpeg", "none", remedy)
    return str(path)


def encode_mp4(pictures: Sequence[bytes], frame_rate: float) -> bytes:
    """An MP4 (H.264) of pictures in PNG.

    Raises:
        ScenarioError: there is no ffmpeg, or it has no H.264.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"  # of which a pipe could not be
        rate = ["-framerate", f"{frame_rate:g}", "-i", "-"]
        command = [_find_ffmpeg(), "-loglevel", "error", "-f", "image2pipe", "-c:v", "png", *rate]
        # What all players show.
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
        done = subprocess.run(command, input=b"".join(pictures), capture_output=True, check=False)
        if done.returncode != 0:
            cause = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise ScenarioError(f"ffmpeg = {command[0]}: install one with libx264 {cause}")
        return path.read_bytes()
