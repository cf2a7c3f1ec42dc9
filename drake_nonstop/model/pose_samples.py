"""Poses at given times: rows of numbers, from a CSV file or a scenario, and their checks."""

import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.validation import ScenarioError, read_text, require

COLUMNS = ["t", "x", "y", "z", "roll", "pitch", "yaw"]  # s, m, rad; the angles are optional
_MAX_VALUE = 1e6  # s, m, rad
_MAX_ROWS = 20_000
_MIN_INTERVAL = 1e-6  # s, between two samples


def read_samples(path: str | Path, field: str) -> list[list[float]]:
    """The rows of a CSV file, [t, x, y, z] or [t, x, y, z, roll, pitch, yaw] in s, m and rad.

    Its first line names these columns, in this order. Empty lines are skipped. Errors do not show
    what is in it, but the field's name: a scenario of somebody else may name any file.

    Raises:
        ScenarioError: the file cannot be read, or as `sample_array`.
    """
    remedy = "give a CSV file that can be read"
    text = read_text(path, field, remedy)
    require(text.count("\n") <= _MAX_ROWS, field, path, f"give at most {_MAX_ROWS} rows")
    try:
        lines = list(csv.reader(text.splitlines(), skipinitialspace=True))
    except csv.Error as error:
        raise ScenarioError(f"{field} = {path}: {remedy} ({error})") from None
    header, rows = [name.strip() for name in lines[0]] if lines else [], []
    require(
        header in (COLUMNS[:4], COLUMNS),
        field,
        path,
        f"give the columns {', '.join(COLUMNS[:4])} or {', '.join(COLUMNS)} in its first line",
    )
    for number, line in enumerate(lines[1:], start=2):
        if not any(line):
            continue
        try:
            rows.append([float(text) for text in line])
        except ValueError:
            rows.append([])
        require(
            len(rows[-1]) == len(header),
            field,
            path,
            f"give {len(header)} numbers in line {number}",
        )
    sample_array(rows, field, path)
    return rows


def sample_array(rows: list[list[float]], field: str, value: Any) -> NDArray:
    """The rows as an array (n, 7), checked: [t, x, y, z, roll, pitch, yaw], omitted angles 0.

    n rows of 4 or of 7 numbers, in s, m and rad; field and value are what error messages show.

    Raises:
        ScenarioError: there are fewer than 2 rows, they differ in length, a number is not
            finite or above 1e6, or the times do not increase from 0 or above.
    """
    try:
        lengths = [len(row) for row in rows]
    except TypeError:
        lengths = []
    require(
        len(lengths) >= 2 and lengths[0] in (4, 7) and lengths.count(lengths[0]) == len(lengths),
        field,
        value,
        f"give 2 or more rows of {', '.join(COLUMNS[:4])} or of {', '.join(COLUMNS)}",
    )
    array = np.zeros((len(rows), 7))
    for number, row in enumerate(rows):
        try:
            array[number, : len(row)] = row
            is_sound = bool(np.all(np.abs(array[number]) <= _MAX_VALUE))
        except (TypeError, ValueError):
            is_sound = False
        require(
            is_sound, field, value, f"give finite numbers up to 1e6 in row {number + 1}, not {row}"
        )
    times = array[:, 0]
    require(times[0] >= 0, field, value, f"give times from 0 up, not {times[0]:g} in row 1")
    for number, (before, after) in enumerate(itertools.pairwise(times), start=2):
        require(
            after - before >= _MIN_INTERVAL,
            field,
            value,
            "give times that increase, by 1e-6 s or more: "
            f"row {number} has {after:.9g} after {before:.9g}",
        )
    return array
