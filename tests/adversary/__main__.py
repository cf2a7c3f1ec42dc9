"""Tries bad and extreme inputs: `python -m adversary --count 2000 --seed 0`, in `tests`."""

import argparse
import json
import os
import sys
import time
from collections import Counter
from pathlib import Path

# Each process has one thread, and none opens a window or a browser.
os.environ |= {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg", "BROWSER": "true"}
sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from adversary.tables import findings, printable, summary  # noqa: E402
from adversary.trying import CLASSES, Tried, draw, shares, try_all, warm_up  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m adversary", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, metavar="N", help="of cases (2000)")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (0)")
    parser.add_argument(
        "--class",
        dest="classes",
        nargs="+",
        choices=CLASSES,
        metavar="CLASS",
        default=[],
        help=f"these only, of {', '.join(CLASSES)}",
    )
    parser.add_argument("--number", type=int, nargs="+", help="these cases of the class only")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="at a time (2)")
    parser.add_argument("--show", action="store_true", help="print the cases, try none")
    parser.add_argument("--log", type=Path, metavar="FILE", help="a line of JSON for each case")
    options = parser.parse_args()
    if options.number is not None:
        numbered = [(name, k) for name in options.classes for k in options.number]
    elif options.classes:
        each = -(-options.count // len(options.classes))
        numbered = [(name, k) for k in range(each) for name in options.classes]
    else:
        numbered = shares(options.count)
    if options.show:
        for name, k in numbered:
            print(f"--- {name} {k}\n{draw(name, options.seed, k).text}")
        return 0
    warm_up()
    start, counts = time.monotonic(), Counter[str]()
    log = options.log.open("w") if options.log else None

    def report(tried: Tried) -> None:
        counts["tried"] += 1
        counts["faulty"] += bool(tried.verdict.faults)
        for kind, detail in tried.verdict.faults:
            print(
                printable(f"{kind}: {detail}\n    {tried.repeat}\n    {tried.text[:300]}"),
                flush=True,
            )
        if log:
            row = {"repeat": tried.repeat, "text": tried.text, "ending": tried.verdict.ending}
            row |= {"faults": tried.verdict.faults, "seconds": round(tried.seconds, 2)}
            row |= {"class": tried.class_name}
            print(json.dumps(row), file=log, flush=True)
        if counts["tried"] % 100 == 0:
            minutes = (time.monotonic() - start) / 60
            print(
                f"... {counts['tried']} of {len(numbered)} in {minutes:.1f} min, "
                f"{counts['faulty']} with faults",
                flush=True,
            )

    tried = try_all(numbered, options.seed, jobs=options.jobs, report=report)
    print(printable(findings(tried)))
    print(summary(tried))
    print(f"{len(tried)} cases in {(time.monotonic() - start) / 60:.1f} min")
    return 1 if any(one.verdict.faults for one in tried) else 0


if __name__ == "__main__":
    sys.exit(main())
