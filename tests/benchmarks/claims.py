"""Claims: the numbers that the pages print, measured again.

A claim is a row of a table with four columns: what measures it, the quantity, the paper's value,
and ours: a number, a range "a–b" or a limit "≤ a". The first column has the arguments of
`drake-nonstop run`, after the name of another of `MEASURES` where no plain run measures it.

The numbers of a paragraph are claims, too, by rows in a comment below it that begins with
`<!-- measured`; each of these numbers has to stand in the paragraph.
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

from benchmarks.measures import MEASURES, OF_SPEED, RUN
from drake_nonstop import load_scenario

README = Path(__file__).parents[2] / "README.md"
_PRINTED = r"(?:≤ )?\d+(?:\.\d+)?(?:–\d+(?:\.\d+)?)?"
_ROW = re.compile(rf"^\| `([^`]+)` \| ([^|]+) \|[^|]*\| ({_PRINTED}) \|$")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_START, _END = "<!-- measured", "-->"  # of the rows of a paragraph
_FACTOR = 2.0  # between the speeds of machines


class Claim(NamedTuple):
    """What a text prints: the arguments that measure it, the quantity, and the number's digits."""

    arguments: str
    quantity: str
    printed: str
    is_in_table: bool = True  # or in a paragraph

    @property
    def measure(self) -> str:
        """What measures it, one of `MEASURES`."""
        first = self.arguments.split(" ")[0]
        return first if first in MEASURES else RUN

    @property
    def is_of_speed(self) -> bool:
        """Whether it is measured alone on the machine."""
        return MEASURES[self.measure].is_alone

    def fault(self, value: float) -> str:
        """Why the claim does not hold, such as "= 0.3, not 0.2"; "" where it does."""
        return "" if self.holds(value) else f"{self} = {value:.4g}, not {self.printed}"

    def holds(self, value: float) -> bool:
        """Whether the value rounds to what is printed; a bare 0 stands for exactly zero.

        What depends on the machine is within a factor of 2 of what is printed.
        """
        if self.printed == "0":
            return value == 0
        low, _, high = self.printed.removeprefix("≤ ").partition("–")
        rounding = 0.55 * 10 ** -len(low.partition(".")[2])
        least, most = float(low) - rounding, float(high or low) + rounding
        if self.quantity in OF_SPEED:
            least, most = float(low) / _FACTOR, float(high or low) * _FACTOR
        return value <= most and (self.printed.startswith("≤") or value >= least)


def documentation() -> str:
    """The text of the README and of the pages."""
    pages = [README, *sorted((README.parent / "docs").glob("*.md"))]
    return "\n".join(page.read_text(encoding="utf-8") for page in pages)


def read_claims(text: str) -> list[Claim]:
    """The claims of a text in Markdown.

    Raises:
        ValueError: one is of an unknown quantity, has no number, or is on a paragraph in which its
            number does not stand.
    """
    claims = []
    paragraph, is_in_table = "", True
    for line in text.splitlines():
        if line in (_START, _END):
            is_in_table = line == _END
        elif found := _ROW.match(line):
            claim = Claim(*found.groups(), is_in_table)
            missing = {*_NUMBER.findall(claim.printed)} - {*_NUMBER.findall(paragraph)} - {"0"}
            if missing and not is_in_table:
                raise ValueError(f"{claim}: print in the paragraph above what its comment claims")
            if claim.quantity not in MEASURES[claim.measure].quantities:
                raise ValueError(f"{claim}: give one of {[*MEASURES[claim.measure].quantities]}")
            claims.append(claim)
        elif line.startswith("| `") and line.count("|") == 5:
            raise ValueError(f"{line}: give a row of `run` | quantity | paper | ours, a number")
        else:
            is_same = line and not line.startswith("- ")
            paragraph = f"{paragraph} {line}" if is_same else line
    return claims


def measure(claims: Sequence[Claim]) -> Iterator[tuple[Claim, float]]:
    """The value of each claim, as it is found, in a process per core; of speed last, one by one."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        groups.setdefault(claim.arguments, []).append(claim)
    alone = [group for group in groups.values() if group[0].is_of_speed]
    shared = [group for group in groups.values() if not group[0].is_of_speed]
    with ProcessPoolExecutor() as pool:
        for group, values in zip(shared, pool.map(values_of, shared), strict=True):
            yield from zip(group, values, strict=True)
    for group in alone:
        yield from zip(group, values_of(group), strict=True)


def values_of(claims: Sequence[Claim]) -> list[float]:
    """The values of claims on the same arguments."""
    measure = MEASURES[claims[0].measure]
    name, *overrides = shlex.split(claims[0].arguments.removeprefix(claims[0].measure))
    found = measure.measure(load_scenario(name, overrides))
    values = [measure.quantities[claim.quantity](found) for claim in claims]
    for claim, value in zip(claims, values, strict=True):
        if value is None:
            raise ValueError(f"{claim}: give a quantity that this run measures")
    return [float(value) for value in values if value is not None]
