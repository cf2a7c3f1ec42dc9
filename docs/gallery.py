"""Replays of the first page, flown as the pages are built, and of notebooks: one viewer for all."""

import html
import re
from pathlib import Path
from typing import Any

import drake_nonstop

# Seconds of flight that each shows, and frames per second: the viewer interpolates.
REPLAYS = {
    "aircraft_transfer": (50.0, 10.0),
    "aircraft_three": (40.0, 10.0),
    "aircraft_co_rotating_gusty": (40.0, 10.0),
    "line": (20.0, 25.0),
    "line_without_optimization": (20.0, 25.0),
    "three_carriers": (15.0, 25.0),
}
_LARGEST = 1_000_000  # bytes
_VIEWER = "replays/viewer.js"


def on_files(files: Any, config: Any) -> Any:
    """Flies and adds the replays."""
    from mkdocs.structure.files import File

    viewer = ""
    for name, (duration, rate) in REPLAYS.items():
        scenario = drake_nonstop.load_scenario(name, [f"simulation_duration={duration}"])
        run = drake_nonstop.simulate(scenario)
        replay = drake_nonstop.record_replay(run, frame_rate=rate, has_figure=False)
        page, viewer = without_viewer(replay)
        if len(page.encode()) > _LARGEST:
            raise ValueError(f"the replay of {name} has {len(page)} bytes: show less of it")
        files.append(File.generated(config, f"replays/{name}.html", content=page))
    files.append(File.generated(config, _VIEWER, content=viewer))
    return files


def on_post_page(output: str, page: Any, config: Any) -> str:
    """A notebook with its replays in files of their own."""

    def framed(frame: re.Match[str]) -> str:
        name = f"replays/{Path(page.file.src_uri).stem}_{frame.start()}.html"
        text, _ = without_viewer(html.unescape(frame[1]))
        (Path(config["site_dir"]) / name).write_text(text, encoding="utf-8")
        return f'src="../{name}"'

    return re.sub(r'\bsrcdoc="([^"]*)"', framed, output)


def without_viewer(replay: str) -> tuple[str, str]:
    """A replay that loads Meshcat's viewer from the file beside it, and this file's content."""
    script = re.search(r"<script[^>]*>(.*?)</script>", replay, re.DOTALL)
    if script is None or len(script[1]) < _LARGEST:
        raise ValueError("the replay does not begin with Meshcat's viewer")
    tag = f'<script src="{_VIEWER.rpartition("/")[2]}"></script>'
    return replay[: script.start()] + tag + replay[script.end() :], script[1]
