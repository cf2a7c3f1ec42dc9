"""What became of faults, in lines for a terminal."""

from collections.abc import Sequence
from typing import NamedTuple

from mutants.faults import Fault
from mutants.stages import Ending, Verdict

LEAST_CAUGHT, LEAST_WITHOUT_GOLDEN = 0.95, 0.80  # shares of all faults
_GOLDEN = 3  # the number of the last stage


class Result(NamedTuple):
    """What became of a fault."""

    number: int  # from 1 on
    fault: Fault
    line: int  # its number in the file
    verdict: Verdict = Verdict(Ending.PASSED)  # of all stages
    stage: int = 0  # in which it ended; 0: none
    seconds: float = 0.0

    @property
    def is_caught(self) -> bool:
        """Whether a test fails because of the fault."""
        return self.verdict.ending is Ending.CAUGHT

    @property
    def is_caught_early(self) -> bool:
        """Whether it is without the golden tests."""
        return self.is_caught and self.stage < _GOLDEN


def line_of(result: Result) -> str:
    """A line for one fault."""
    said = {
        Ending.PASSED: "SURVIVED",
        Ending.CAUGHT: f"caught by {result.verdict.by} (stage {result.stage})",
        Ending.UNCLEAR: f"UNCLEAR: {result.verdict.by} (stage {result.stage})",
    }[result.verdict.ending]
    fault, place = result.fault, f"{result.fault.file}:{result.line}"
    return (
        f"{result.number:3}  {place:50} {fault.kind:18} {fault.origin:7} {result.seconds:5.0f} s  "
        f"{said}"
    )


def summary(results: Sequence[Result]) -> str:
    """The faults that no test caught, and the shares of those that were."""
    left = [result for result in results if not result.is_caught]
    lines = []
    for result in sorted(left, key=lambda result: result.number):
        fault = result.fault
        lines += [line_of(result), f"       {fault.line}", f"    -> {fault.becomes}"]
    for name, least, caught in (
        ("caught", LEAST_CAUGHT, sum(result.is_caught for result in results)),
        (
            "caught without the golden tests",
            LEAST_WITHOUT_GOLDEN,
            sum(result.is_caught_early for result in results),
        ),
    ):
        share = f"{100 * caught / len(results):.1f} %" if results else "none"
        lines.append(f"{name}: {caught} of {len(results)}, {share} (at least {least:.0%} asked)")
    return "\n".join(lines)
