"""`drake-nonstop video`: make a GIF of a run."""

import argparse
import re
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.run.run import Run
from drake_nonstop.studies.files import replacing_file, require_writable_file
from drake_nonstop.validation import require
from drake_nonstop.view.progress import TaskProgress
from drake_nonstop.view.video import FRAME_RATE, SIZE, record_video


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "video",
        description="Takes a run's replay frame by frame with Chromium, which opens no window. "
        "Needs pip install 'drake-nonstop[video]', and Chromium, of the system or by "
        "`playwright install chromium`.",
    )
    parser.set_defaults(action=_video)
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder with a run's results")
    parser.add_argument("--out", type=Path, metavar="FILE", help="a name in .gif (RUN/video.gif)")
    for name, default, about in (
        ("start", None, "s, the first instant shown (the run's)"),
        ("stop", None, "s, the last (the run's)"),
        ("speed", 1.0, "simulated s per s of the video (1)"),
        ("frame-rate", FRAME_RATE, f"pictures per s of the video ({FRAME_RATE:g})"),
    ):
        parser.add_argument(f"--{name}", type=float, default=default, metavar="X", help=about)
    size = "{}x{}".format(*SIZE)
    parser.add_argument("--size", default=size, metavar="WxH", help=f"in pixels ({size})")
    add_trust(parser)


def _video(options: argparse.Namespace) -> int:
    file: Path = options.out or options.run / "video.gif"
    require(file.suffix == ".gif", "--out", file, "give a name in .gif")
    size = re.fullmatch(r"(\d{1,6})x(\d{1,6})", options.size)
    require(size, "--size", options.size, "give width and height in pixels, such as 640x480")
    assert size is not None
    run = Run.load(options.run, trust=options.trust)
    require_writable_file(file)
    names = ("start", "stop", "speed", "frame_rate")
    chosen = {name: getattr(options, name) for name in names}
    with TaskProgress() as progress:
        content = record_video(run, **chosen, size=(int(size[1]), int(size[2])), progress=progress)
    with replacing_file(file) as opened:
        opened.write(content)
    print(f"written: {file}")
    return 0
