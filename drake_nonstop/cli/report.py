"""`drake-nonstop report`: the numbers that the README marks as measured, measured again."""

import argparse
import sys
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.cli.exit_codes import FAILED
from drake_nonstop.studies.files import replacing_file, require_writable
from drake_nonstop.validation import require_installed
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "report",
        help="measure the numbers that the README marks as measured, and take its pictures",
    )
    parser.set_defaults(action=_report_claims)
    parser.add_argument(
        "--readme",
        type=Path,
        metavar="FILE",
        default=Path("README.md"),
        help="with docs beside it (README.md)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/report"))
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the runs only: no benchmarks, no pictures, no tests/evals",
    )


def _report_claims(options: argparse.Namespace) -> int:
    # Imported here: other commands need none of it.
    from drake_nonstop.benchmarks import claims as report

    text = report.documentation(options.readme)
    claims = [
        claim for claim in report.read_claims(text) if not (options.quick and claim.is_of_speed)
    ]
    files = ["report.md"]
    if not options.quick:  # what is missing is said before all is measured
        require_installed("report", PIL="pillow", scipy="scipy", pytest="pytest")
        require_drawing()
        from drake_nonstop.benchmarks.browser import find_browser
        from drake_nonstop.benchmarks.pictures import FILES

        find_browser()
        files += FILES
    require_writable(options.out, files)
    with TaskProgress() as progress:
        measured = report.measure(claims, progress=progress)
    failed, solvers = report.wrong_claims(measured), ""
    if not options.quick:
        from drake_nonstop.benchmarks.optimizer import benchmark_optimizer
        from drake_nonstop.benchmarks.optimizer import table as solvers_table
        from drake_nonstop.benchmarks.pictures import make_pictures

        with TaskProgress() as progress:
            make_pictures(options.out, progress=progress)
            results = benchmark_optimizer(1000, 0, [], progress=progress)
        solvers = solvers_table(results)
        failed += report.wrong_shares(text, results)
        print("running tests/evals, which measure the rest ...", flush=True)
        failed += report.failing_evals(options.readme.parent)
    with replacing_file(options.out / "report.md") as file:
        file.write(report.report_text(measured, solvers, failed).encode())
    for claim in failed:
        print(claim, file=sys.stderr)
    print(f"{len(claims)} numbers measured, {len(failed) or 'no'} claims failed")
    print(f"results: {options.out / 'report.md'}")
    return FAILED if failed else 0
