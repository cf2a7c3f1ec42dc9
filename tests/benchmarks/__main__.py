"""The pages' numbers and pictures, anew: `python -m tests.benchmarks report`, in the checkout."""

import argparse
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from benchmarks.claims import documentation, measure, read_claims  # noqa: E402
from benchmarks.pictures import make_pictures  # noqa: E402


def report(only: str, *, is_quick: bool) -> int:
    """Prints what is measured, and whether it holds; 1 where a claim fails."""
    claims = [claim for claim in read_claims(documentation()) if only in claim.arguments]
    failed = 0
    print("| measured by | quantity | printed | measured | |\n| --- | --- | --- | --- | --- |")
    for claim, value in measure([c for c in claims if not (is_quick and c.is_of_speed)]):
        failed += not claim.holds(value)
        cells = claim.arguments, claim.quantity, claim.printed, f"{value:.4g}"
        print(f"| {' | '.join(cells)} | {'holds' if claim.holds(value) else '**fails**'} |")
    print(f"{failed or 'no'} claims failed", file=sys.stderr)
    return 1 if failed else 0


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    made = commands.add_parser("report", help="measure the numbers that the pages claim")
    made.add_argument("--only", default="", metavar="WORD", help="those measured by WORD alone")
    made.add_argument("--quick", action="store_true", help="without the claims of speed")
    pictures = commands.add_parser("pictures", help="take the README's pictures")
    pictures.add_argument("--out", type=Path, default=Path("out/pictures"), help="(out/pictures)")
    options = parser.parse_args(arguments)
    if options.command == "report":
        return report(options.only, is_quick=options.quick)
    options.out.mkdir(parents=True, exist_ok=True)
    print(*make_pictures(options.out), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
