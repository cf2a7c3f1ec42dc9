"""The faults that the tests are tested by: what faults.yaml has, and how one of them is made."""

from pathlib import Path
from typing import Any, NamedTuple

import yaml

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).parent / "faults.yaml"
CHOSEN, DRAWN = ORIGINS = "chosen", "drawn"


class FaultError(ValueError):
    """A fault cannot be made; the message tells why."""


class Fault(NamedTuple):
    """A line of the source, and what it becomes; both without leading blanks."""

    file: str  # from the checkout's root
    line: str
    becomes: str
    kind: str  # in a word or two, such as "sign"
    origin: str  # one of ORIGINS

    def line_number(self, text: str) -> int:
        """That of the line in the file's text, from 1 on.

        Raises:
            FaultError: it is not found exactly once.
        """
        lines = text.split("\n")
        found = [k for k, line in enumerate(lines, start=1) if line.lstrip(" ") == self.line]
        if len(found) != 1:
            raise FaultError(
                f"{self.file}: the line {self.line!r} is found {len(found)} times; give one that "
                "is found once"
            )
        return found[0]

    def made_in(self, text: str) -> str:
        """The file's text with the fault."""
        lines, k = text.split("\n"), self.line_number(text) - 1
        blanks = len(lines[k]) - len(self.line)
        lines[k] = lines[k][:blanks] + self.becomes
        return "\n".join(lines)


def read_faults(path: Path = FILE) -> list[Fault]:
    """The faults of a file.

    Raises:
        FaultError: an entry lacks a field, or has another one, or one that is no text.
    """
    entries: list[Any] = yaml.safe_load(path.read_text(encoding="utf-8")) or []
    for number, entry in enumerate(entries, start=1):
        is_entry = isinstance(entry, dict) and [*entry] == [*Fault._fields]
        if not is_entry or not all(isinstance(v, str) and v for v in entry.values()):
            raise FaultError(f"entry {number}: give a text for each of {', '.join(Fault._fields)}")
        if entry["origin"] not in ORIGINS:
            raise FaultError(f"entry {number}: give an origin of {' or '.join(ORIGINS)}")
    return [Fault(**entry) for entry in entries]


def as_yaml(fault: Fault) -> str:
    """The entry of a fault."""
    entry = [fault._asdict()]
    return yaml.safe_dump(entry, sort_keys=False, allow_unicode=True, width=10**6)
