"""What is tried, and what is found."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# How what was tried came to its end.
ACCEPTED = "accepted"
REFUSED = "refused"  # with one sentence
STOPPED = "stopped"  # a run that failed, or was interrupted, and said so
ENDINGS = ACCEPTED, REFUSED, STOPPED

# What may be wrong with it.
TRACEBACK = "traceback"
HANG = "hang"
LOST_WORK = "lost work"
EXIT_CODE = "exit code"
SENTENCE = "sentence"  # none, several, or one that is not "field = value: remedy"
MISREAD = "misread"  # accepted with another meaning than a reader's, or although it has none
LEFTOVER = "leftover"  # processes or temporary files that stay behind
FAULTS = TRACEBACK, HANG, LOST_WORK, EXIT_CODE, SENTENCE, MISREAD, LEFTOVER


@dataclass(kw_only=True)
class Verdict:
    """How a case ended, and its faults: kind and detail."""

    ending: str = ACCEPTED
    message: str = ""  # of what refused it
    faults: list[tuple[str, str]] = field(default_factory=list)

    def add(self, kind: str, detail: str) -> None:
        self.faults.append((kind, " ".join(detail.split())[:600]))

    def merge(self, other: "Verdict") -> None:
        self.faults += other.faults


@dataclass(kw_only=True)
class Case:
    """An input: what a user would type, and the function that tries it in an empty folder.

    The function runs in a process of its own, with that folder as the current one; where it has
    not returned after `limit` seconds of an idle machine, it hangs.
    """

    text: str
    attempt: Callable[[Path], Verdict]
    limit: float = 30.0


Draw = Callable[[np.random.Generator], Case]


def signature(kind: str, detail: str) -> str:
    """What faults of one cause have in common: their text without numbers and quoted parts."""
    if kind == TRACEBACK:
        error, _, place = detail.rpartition(" [")
        return f"{kind}: {error.partition(':')[0]} [{re.sub(r':.*', '', place)}"
    detail = re.sub(r"(/[\w.~+-]+)+/?", "PATH", detail)
    detail = re.sub(r"'[^']*'|\"[^\"]*\"", "'…'", detail)
    detail = re.sub(r"-?\d+(\.\d+)?(e[+-]?\d+)?", "#", detail)
    return f"{kind}: {detail[:160]}"


_INTERNAL = (  # words of the code, which a user's sentence has no use for
    r"\b[A-Z]\w+(Error|Exception)\b|object at 0x|bound method|<class |<function |Failure at|"
    r"\bstd::|\bpydrake\b|\bcondition '|yaml_read_archive|Traceback|numpy\.|np\.|\bNoneType\b"
)


def judge_sentence(verdict: Verdict, text: str, *, has_own_code: bool = False) -> None:
    """Notes what is wrong with the message of a ScenarioError.

    With code of the user's own, the names of its errors belong into it.
    """
    if "\n" in text:
        verdict.add(SENTENCE, f"several lines: {text!r}")
    if len(text) > 2000:
        verdict.add(SENTENCE, f"{len(text)} characters: {text[:200]}")
    if not re.search(r"\S\s+= .*: \S", text, re.DOTALL):
        verdict.add(SENTENCE, f"not 'field = value: remedy': {text}")
    elif not has_own_code and (found := re.search(_INTERNAL, text)):
        verdict.add(SENTENCE, f"internal {found[0]!r}: {text}")
