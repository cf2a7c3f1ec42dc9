"""The pictures of the pages: the line task, patterns of orbits, obstacles, aircraft."""

import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from drake_nonstop import Run, load_scenario, record_video, simulate
from drake_nonstop.cli.main import main as command
from drake_nonstop.run.run_quantities import RunQuantities

FRAME_RATE = 12  # 1/s
SPAN = 6.0, 11.0  # s, of the animation: the load sets off, and comes to its speed
FLIGHT = 30.0, 60.0  # s, of the aircraft: the load is fastest in the middle
TURN = 23.0  # s, of the patterns


def make_pictures(folder: Path) -> list[Path]:
    """Writes the pictures to a folder, and returns where they are.

    Raises:
        ScenarioError: there is no browser to take them with.
    """
    made = []
    pictures = {"real_scale.png": _patterns(), "obstacles.png": _obstacles()}
    for name, frames in (_line() | pictures | _aircraft()).items():
        duration = {"duration": 1000 // FRAME_RATE, "loop": 0} if name.endswith(".gif") else {}
        frames[0].save(
            folder / name, save_all=len(frames) > 1, append_images=frames[1:], **duration
        )
        made.append(folder / name)
    return made


def _line() -> dict[str, list[Image.Image]]:
    """The line task without and with optimization, and the instant of the slowest carrier."""
    runs = []
    for overrides in (["optimization_layer=ConstantParameters"], []):
        task = load_scenario("line", [f"simulation_duration={SPAN[1] + 1}", *overrides])
        runs.append(simulate(task))
    films = [_frames(run, *SPAN) for run in runs]
    moving = [_beside(*pair) for pair in zip(*films, strict=True)]
    quantities = RunQuantities(runs[0])
    shown = (quantities.time >= SPAN[0]) & (quantities.time <= SPAN[1])
    slowest = quantities.time[shown][quantities.speeds[shown].min(axis=1).argmin()]
    still = moving[min(round((slowest - SPAN[0]) * FRAME_RATE), len(moving) - 1)]
    colours, plain = moving[len(moving) // 2].quantize(), Image.Dither.NONE
    film = [frame.quantize(palette=colours, dither=plain) for frame in moving]
    return {"line.gif": film, "line.png": [still]}


def _patterns() -> list[Image.Image]:
    """The real-scale scenarios' patterns above a resting load, from above, for a turn."""
    resting = [f"simulation_duration={TURN}", "load_trajectory.start_time=30"]
    patterns = ("cycle", "carousel", "spread")
    runs = [simulate(load_scenario(f"real_scale_{name}", resting)) for name in patterns]
    return [_beside(*(_drawn(run.plot("carrier_paths_from_above")) for run in runs))]


def _obstacles() -> list[Image.Image]:
    """A load over a tower, beside a balloon."""
    return _frames(simulate(load_scenario("quintic_over_tower")), 5.5, 5.51, (960, 540))


def _aircraft() -> dict[str, list[Image.Image]]:
    """The aircraft when one is closest to its largest lift, their flight, and its margins."""
    scenario = load_scenario("aircraft_transfer", [f"simulation_duration={FLIGHT[1]}"])
    run = simulate(scenario)
    quantities = RunQuantities(run)
    lift = np.where(quantities.time < FLIGHT[0], 0.0, quantities.aircraft_state.lift.max(axis=1))
    hardest = min(quantities.time[lift.argmax()], FLIGHT[1] - 0.1)
    drawn = _drawn(run.plot("aircraft"))
    scene = _frames(run, hardest, hardest + 0.01, (drawn.width, drawn.height))[0]
    with tempfile.TemporaryDirectory() as folder:
        command(["check", "aircraft_transfer", "--out", folder])
        margins = Image.open(Path(folder) / "check.png").copy()
    return {"aircraft.png": [_beside(scene, drawn)], "aircraft_check.png": [margins]}


def _frames(
    run: Run, start: float, stop: float, size: tuple[int, int] = (440, 440)
) -> list[Image.Image]:
    """A run's replay between two times in s, with that width and height in pixels."""
    content = record_video(run, start=start, stop=stop, frame_rate=FRAME_RATE, size=size)
    video: Any = Image.open(io.BytesIO(content))
    frames = []
    for k in range(video.n_frames):
        video.seek(k)
        frames.append(video.convert("RGB"))
    return frames


def _drawn(figure: Any) -> Image.Image:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=130)
    return Image.open(file).convert("RGB")


def _beside(*pictures: Image.Image) -> Image.Image:
    """Pictures side by side, on white."""
    size = sum(each.width for each in pictures), max(each.height for each in pictures)
    whole, left = Image.new("RGB", size, "white"), 0
    for each in pictures:
        whole.paste(each, (left, 0))
        left += each.width
    return whole
