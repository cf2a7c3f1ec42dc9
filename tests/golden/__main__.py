"""Writes golden numbers: `python -m golden`, in `tests`, or with the names of some flights.

Numbers within their tolerance stay as they are; what is written anew is listed.
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from fleet import Fleet  # noqa: E402

from golden.numbers import (  # noqa: E402
    MOVED,
    Golden,
    differences,
    flights,
    moved_numbers,
    numbers_of_flight,
    read_table,
    tolerances,
    write_table,
)


def renewed(name: str, kept: dict[str, Golden]) -> tuple[dict[str, Golden], dict[str, str]]:
    """The golden numbers of a flight, those that hold as they are kept, and what differs."""
    with tempfile.TemporaryDirectory() as folder:
        numbers = numbers_of_flight(name, Fleet(Path(folder)))
    different = differences(kept, numbers)
    if not different:
        return kept, {}
    try:
        made = tolerances(numbers, [moved_numbers(name, share) for share in (MOVED, -MOVED)])
    except ValueError as error:
        raise SystemExit(f"{name}: {error}; give the flight another duration") from None
    return {q: made[q] if q in different else kept[q] for q in numbers}, different


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m golden", description=__doc__)
    parser.add_argument("flights", nargs="*", metavar="FLIGHT", help="these only")
    parser.add_argument("--check", action="store_true", help="list what differs, write nothing")
    options = parser.parse_args()
    unknown = set(options.flights) - set(flights())
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: give some of {', '.join(flights())}")
    table, chosen = read_table(), options.flights or flights()
    count = 0
    with ProcessPoolExecutor(2, multiprocessing.get_context("fork")) as pool:
        found = pool.map(renewed, chosen, [table.get(name, {}) for name in chosen])
        for name, (table[name], different) in zip(chosen, found, strict=True):
            count += len(different)
            print(*(f"{name}: {sentence}\n" for sentence in different.values()), sep="", end="")
    if not options.check:
        write_table(table)
    print(f"{count} numbers of {len(chosen)} flights {'differ' if options.check else 'written'}")
    return 1 if options.check and count else 0


if __name__ == "__main__":
    sys.exit(main())
