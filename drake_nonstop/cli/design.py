"""`drake-nonstop design`: find formations of aircraft for a load, and scenarios that fly."""

import argparse
import os
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_changes
from drake_nonstop.cli.ending import BAD_INPUT, FAILED

_REQUEST, _DATA = "request.yaml", "design.json"
_MOST = 100  # formations, of 10 numbers of carriers


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "design",
        description="Looks for formations of aircraft that hold a load, at rest and on a way, in a "
        "wind, with margins to stall, bank and thrust: for each number of carriers and kind of "
        "orbit the ones of the least power at rising margins. Writes a scenario for "
        "each. Takes about a minute, or several on a busy machine.",
        epilog=f"Exit codes: 0 where there is a formation, {FAILED} where there is none, "
        f"{BAD_INPUT} for bad input.",
    )
    parser.set_defaults(action=_design)
    parser.add_argument(
        "request",
        metavar="REQUEST.yaml",
        nargs="?",
        type=Path,
        help="fields of a DesignRequest (a load of 10 kg for 3 to 6 rascal_110)",
    )
    parser.add_argument(
        "--print-request",
        action="store_true",
        help="print the request with every field, unit and meaning, to save and change",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="results' folder (out/design/NAME)")
    about = 'change the request: load_mass=5 "wind=[3, 0, 0]" aircraft.mass=7'
    add_changes(parser, "--set", about, metavar="FIELD=VALUE")


def _design(options: argparse.Namespace) -> int:
    from drake_nonstop.scenario.loading import dump_scenario
    from drake_nonstop.studies import design
    from drake_nonstop.studies.design_request import dump_request, read_request
    from drake_nonstop.studies.files import (
        free_folder,
        replacing_files,
        require_writable,
        write_json,
    )
    from drake_nonstop.view.progress import TaskProgress

    request = read_request(options.request, options.set)
    text = dump_request(request)
    if options.print_request:
        print(text, end="")
        return 0

    place = Path("out") / "design" / request.name
    folder: Path = options.out or free_folder(place, _REQUEST, text)
    files = (_REQUEST, _DATA, *(f"{request.name}_{k + 1}.yaml" for k in range(_MOST)))
    require_writable(folder, files)
    count = len(request.carriers) * len(request.kinds)
    print(
        f"{count} kinds and numbers of carriers, {min(count, os.cpu_count() or 1)} at a time, up "
        "to a minute each, several with lumped cables: formations are optimized, then flown",
        flush=True,
    )
    with TaskProgress() as progress:
        found = design.design(request, progress)
    with replacing_files(folder, files) as new:
        (new / _REQUEST).write_text(text, encoding="utf-8")
        write_json(new / _DATA, found.dictionary)
        for formation in found.formations:
            path = new / f"{formation.scenario.name}.yaml"
            path.write_text(dump_scenario(formation.scenario), encoding="utf-8")
    print(found, found.verdict, f"results: {folder}", sep="\n")
    return 0 if found.formations else FAILED
