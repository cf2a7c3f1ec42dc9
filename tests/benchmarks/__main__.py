"""The pages' numbers and pictures, anew: `python -m tests.benchmarks report`, in the checkout."""

import argparse
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from benchmarks import claims  # noqa: E402
from benchmarks.pictures import make_pictures  # noqa: E402
from drake_nonstop.validation import ScenarioError, require  # noqa: E402


def _report(options: argparse.Namespace) -> int:
    chosen = [
        claim
        for claim in claims.read_claims(claims.documentation(options.readme))
        if options.only in claim.arguments and not (options.quick and claim.is_of_speed)
    ]
    require(chosen, "--only", options.only, "give a part of what measures a claim")
    failed = 0
    print("| measured by | quantity | printed | measured | |\n| --- | --- | --- | --- | --- |")
    for claim, value in claims.measure(chosen):
        fault = claim.fault(value)
        failed += bool(fault)
        cells = claim.arguments, claim.quantity, claim.printed, f"{value:.4g}"
        print(f"| {' | '.join(cells)} | {'**fails**' if fault else 'holds'} |", flush=True)
    print(f"{len(chosen)} numbers measured, {failed or 'no'} claims failed", file=sys.stderr)
    return 1 if failed else 0


def _pictures(options: argparse.Namespace) -> int:
    options.out.mkdir(parents=True, exist_ok=True)
    for path in make_pictures(options.out):
        print(path)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    report = commands.add_parser("report", help="measure the numbers that the pages claim")
    report.set_defaults(action=_report)
    about = "with docs beside it (README.md)"
    report.add_argument("--readme", type=Path, default=Path("README.md"), help=about)
    report.add_argument("--only", default="", metavar="WORD", help="those measured by WORD alone")
    report.add_argument("--quick", action="store_true", help="without the claims of speed")
    pictures = commands.add_parser("pictures", help="take the README's pictures")
    pictures.set_defaults(action=_pictures)
    pictures.add_argument("--out", type=Path, default=Path("out/pictures"), help="(out/pictures)")
    options = parser.parse_args(arguments)
    try:
        return options.action(options)
    except ScenarioError as error:
        print(f"benchmarks: {error!s}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
