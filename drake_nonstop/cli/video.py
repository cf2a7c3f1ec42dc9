"""`drake-nonstop video`: make a GIF or MP4 of a run."""

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
        help="make a GIF or MP4 of a run",
        description="Takes a run's replay frame by frame with Chromium, which opens no window. "
        "Needs pip install 'drake-nonstop[video]', and Chromium, of the system or by "
        "`playwright install chromium`; an MP4 needs ffmpeg.",
    )
    parser.set_defaults(action=_video)
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder with a run's results")
    about = "with a name in .gif or .mp4 (RUN/video.gif)"
    parser.add_argument("--out", type=Path, metavar="FILE", help=about)
    for name, default, about in (
        ("start", None, "s, the first instant shown (the run's)"),
        ("stop", None, "s, the last (the run's)"),
        ("speed", 1.0, "simulated s per s of the video (1)"),
        ("frame-rate", FRAME_RATE, f"pictures per s of the video ({FRAME_RATE:g})"),
    ):
        parser.add_argument(f"--{name}", type=float, default=default, metavar="X", help=about)
    size = "{}x{}".format(*SIZE)
    parser.add_argument("--size", default=size, metavar="WxH", help=f"in pixels ({size})")
    parser.add_argument("--no-strip", action="store_true", help="without the plot below the scene")
    add_trust(parser)


def _video(options: argparse.Namespace) -> int:
    file: Path = options.out or options.run / "video.gif"
    require(file.suffix in (".gif", ".mp4"), "--out", file, "give a name in .gif or .mp4")
    size = re.fullmatch(r"(\d{1,6})x(\d{1,6})", options.size)
    require(size, "--size", options.size, "give width and height in pixels, such as 640x480")
    assert size is not None
    run = Run.load(options.run, trust=options.trust)
    require_writable_file(file)
    names = ("start", "stop", "speed", "frame_rate")
    with TaskProgress() as progress:
        content = record_video(
            run,
            file.suffix[1:],
            **{name: getattr(options, name) for name in names},
            size=(int(size[1]), int(size[2])),
            has_strip=not options.no_strip,
            progress=progress,
        )
    with replacing_file(file) as opened:
        opened.write(content)
    print(f"written: {file}")
    return 0
