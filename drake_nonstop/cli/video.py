"""`drake-nonstop video`: a moving picture of a run."""

import argparse
import re
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.simulation.run import Run
from drake_nonstop.studies.files import replacing_file, require_writable_file
from drake_nonstop.studies.run_all import no_progress
from drake_nonstop.validation import require
from drake_nonstop.visualization.progress import TaskProgress
from drake_nonstop.visualization.video import FORMATS, FRAME_RATE, SIZE, record_video


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "video",
        help="make a GIF or MP4 of a run",
        description="Takes the replay of a run, frame by frame, with Chromium, which opens no "
        "window.",
        epilog="Needs an extra, pip install 'drake-nonstop[video]', and Chromium, of the system or "
        "by `playwright install chromium`; an MP4 needs ffmpeg.",
    )
    parser.set_defaults(action=_video)
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder with a run's results")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="with a name in .gif or .mp4 (RUN/video.gif)"
    )
    for name, about in (("start", "the first instant shown"), ("stop", "the last")):
        parser.add_argument(f"--{name}", type=float, metavar="S", help=f"{about} (the run's)")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="RATE", help="simulated s per s of video (1)"
    )
    parser.add_argument(
        "--frame-rate",
        type=float,
        default=FRAME_RATE,
        metavar="HZ",
        help=f"pictures per s of video ({FRAME_RATE:g})",
    )
    size = "{}x{}".format(*SIZE)
    parser.add_argument("--size", default=size, metavar="WxH", help=f"in pixels ({size})")
    parser.add_argument("--no-strip", action="store_true", help="without the plot below the scene")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    add_trust(parser)


def _video(options: argparse.Namespace) -> int:
    file: Path = options.out or options.run / "video.gif"
    kind = file.suffix.removeprefix(".")
    endings = " or ".join(f".{each}" for each in FORMATS)
    require(kind in FORMATS, "--out", file, f"give a name in {endings}")
    size = re.fullmatch(r"(\d{1,6})x(\d{1,6})", options.size)
    require(size, "--size", options.size, "give width and height in pixels, such as 640x480")
    assert size is not None
    run = Run.load(options.run, trust=options.trust)
    require_writable_file(file)
    with TaskProgress() as progress:
        content = record_video(
            run,
            kind,
            start=options.start,
            stop=options.stop,
            speed=options.speed,
            frame_rate=options.frame_rate,
            size=(int(size[1]), int(size[2])),
            has_strip=not options.no_strip,
            progress=no_progress if options.quiet else progress,
        )
    with replacing_file(file) as opened:
        opened.write(content)
    if not options.quiet:
        print(f"written: {file}")
    return 0
