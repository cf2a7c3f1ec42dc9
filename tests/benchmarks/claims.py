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
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measures import MEASURES, OF_SPEED, RUN
from drake_nonstop.run.run import RunStopped
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError, read_text, require

_PRINTED = r"(?:≤ )?\d+(?:\.\d+)?(?:–\d+(?:\.\d+)?)?"
_ROW = re.compile(rf"^\| `([^`]+)` \| ([^|]+) \|[^|]*\| ({_PRINTED}) \|$")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_START, _END = "<!-- measured", "-->"  # of the rows of a paragraph
_FACTOR = 2.0  # between the speeds of machines


@dataclass(frozen=True, kw_only=True)
class Claim:
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
        return "" if self.holds(value) else f"= {value:.4g}, not {self.printed}"

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


def documentation(readme: Path) -> str:
    """The text of a README and of the pages in the folder `docs` beside it.

    Raises:
        ScenarioError: it cannot be read.
    """
    text = read_text(readme, "--readme", "run it in a checkout, or give the file")
    pages = sorted((readme.parent / "docs").glob("*.md"))
    return "\n".join([text, *(page.read_text(encoding="utf-8") for page in pages)])


def read_claims(text: str) -> list[Claim]:
    """The claims of a text in Markdown.

    Raises:
        ScenarioError: there are none, one is of an unknown quantity, or one on a paragraph is of
            a number that does not stand there.
    """
    claims = []
    paragraph, is_in_table = "", True
    for line in text.splitlines():
        if line in (_START, _END):
            is_in_table = line == _END
        elif found := _ROW.match(line):
            arguments, quantity, printed = found.groups()
            missing = set(_NUMBER.findall(printed)) - set(_NUMBER.findall(paragraph)) - {"0"}
            remedy = "print in the paragraph above what its comment claims"
            require(is_in_table or not missing, f"claim on {arguments}", printed, remedy)
            claim = Claim(
                arguments=arguments, quantity=quantity, printed=printed, is_in_table=is_in_table
            )
            known = MEASURES[claim.measure].quantities
            remedy = f"give one of {', '.join(known)}"
            require(quantity in known, f"claim on {arguments}", quantity, remedy)
            claims.append(claim)
        elif line.startswith("| `") and line.count("|") == 5:
            remedy = "give a row of `run` | quantity | paper | ours, with ours a number"
            require(False, "claim", line, remedy)
        else:
            is_same = line and not line.startswith("- ")
            paragraph = f"{paragraph} {line}" if is_same else line
    require(claims, "--readme", "a text without claims", "give the README of drake_nonstop")
    return claims


def measure(claims: Sequence[Claim]) -> Iterator[tuple[Claim, float]]:
    """The value of each claim, as it is found, in a process per core; of speed last, one by one.

    Raises:
        ScenarioError: a claim's arguments make no scenario, its run did not complete, or its
            quantity was not measured in that run.
    """
    of_arguments: dict[str, list[Claim]] = {}
    for claim in claims:
        of_arguments.setdefault(claim.arguments, []).append(claim)
    groups = sorted(of_arguments.values(), key=lambda group: group[0].is_of_speed)
    shared = [group for group in groups if not group[0].is_of_speed]
    with ProcessPoolExecutor() as pool:
        for group, values in zip(shared, pool.map(values_of, shared), strict=True):
            yield from zip(group, values, strict=True)
    for group in groups[len(shared) :]:
        yield from zip(group, values_of(group), strict=True)


def values_of(claims: Sequence[Claim]) -> list[float]:
    """The values of claims on the same arguments; raises ScenarioError as `measure`."""
    arguments, measure = claims[0].arguments, MEASURES[claims[0].measure]
    name, *overrides = shlex.split(arguments.removeprefix(claims[0].measure))
    try:
        found = measure.measure(load_scenario(name, overrides))
    except (RunStopped, ScenarioError) as error:
        raise ScenarioError(f"claim on {arguments} = {error}") from None
    values = [measure.quantities[claim.quantity](found) for claim in claims]
    for claim, value in zip(claims, values, strict=True):
        remedy = "give a quantity that this run measures"
        require(value is not None, f"claim on {arguments}", claim.quantity, remedy)
    return [float(value) for value in values]
