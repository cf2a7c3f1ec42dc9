"""What was found, as texts."""

from collections import Counter
from collections.abc import Sequence

from adversary.trying import CLASSES, Tried
from adversary.verdicts import ENDINGS, FAULTS, signature


def summary(tried: Sequence[Tried]) -> str:
    """A row per class: cases by how they ended, and those with each kind of fault."""
    columns = ["tried", *ENDINGS, *FAULTS]
    lines = [f"| class | {' | '.join(columns)} |", f"| --- |{' ---: |' * len(columns)}"]
    counts = {name: Counter[str]() for name in CLASSES}
    for one in tried:
        kinds = {kind for kind, _ in one.verdict.faults}
        counts[one.class_name].update(["tried", one.verdict.ending, *kinds])
    counts["all"] = sum(counts.values(), Counter[str]())
    for name, row in counts.items():
        if row["tried"]:
            lines.append(f"| {name} | {' | '.join(str(row[column]) for column in columns)} |")
    return "\n".join(lines)


def printable(text: str) -> str:
    """The text without control characters other than ends of lines."""
    return "".join(c if c.isprintable() or c == "\n" else "·" for c in text)


def findings(tried: Sequence[Tried]) -> str:
    """The distinct faults by class, each with how often it was found and one case of it."""
    found: dict[tuple[str, str], list[tuple[Tried, str]]] = {}
    for one in tried:
        for kind, detail in one.verdict.faults:
            key = one.class_name, signature(kind, detail)
            found.setdefault(key, []).append((one, f"{kind}: {detail}"))
    lines = []
    for (name, _), cases in sorted(found.items(), key=lambda item: item[0]):
        shortest, detail = min(cases, key=lambda case: len(case[0].text))
        lines += [f"[{name}, {len(cases)} times] {detail}", f"    {shortest.repeat}"]
        lines += [f"    {line}" for line in shortest.text[:400].splitlines()]
    return "\n".join(lines)
