"""What may become of an input: it is flown, or refused with one sentence, in a reasonable time."""

import contextlib
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from typing import Any

from drake_nonstop import (
    RunInterrupted,
    RunStopped,
    Scenario,
    ScenarioError,
    dump_scenario,
    parse_scenario,
    simulate,
)

ACCEPTED, REFUSED, STOPPED = "accepted", "refused", "stopped"
LONGEST = 60  # s, of a single input, on a busy machine
# Words of the code, which a user's sentence has no use for.
_INTERNAL = re.compile(
    r"\b[A-Z]\w+(Error|Exception)\b|object at 0x|bound method|<class |<function |Failure at|"
    r"\bstd::|\bpydrake\b|\bcondition '|yaml_read_archive|Traceback|numpy\.|np\.|\bNoneType\b"
)


@contextlib.contextmanager
def limited(seconds: int = LONGEST) -> Iterator[None]:
    """What is called within it ends in time."""

    def late(*_: object) -> None:
        raise TimeoutError(f"{seconds} s have passed")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def judge_sentence(text: str, *, shows_python: bool = False) -> None:
    """Asserts that a message is one sentence with field, value and remedy.

    Values that Python shows, and errors of code of the user's own, may have names of its own.
    """
    assert "\n" not in text, text
    assert len(text) < 2000, text
    assert re.search(r"\S\s+= .*: \S", text), f"not 'field = value: remedy': {text}"
    assert shows_python or not _INTERNAL.search(text), text


def ending_of(call: Callable[[], Any], *, shows_python: bool = False) -> tuple[str, Any]:
    """How a call ended, with its value or message; any other error is raised."""
    with warnings.catch_warnings(), limited():
        warnings.simplefilter("ignore")
        try:
            return ACCEPTED, call()
        except ScenarioError as error:
            judge_sentence(str(error), shows_python=shows_python)
            return REFUSED, str(error)
        except (RunStopped, RunInterrupted) as error:
            said = str(error)
    assert "\n" not in said, said
    assert not re.search(r"\b(Type|Index|Key|Attribute|LinAlg)Error\b", said), said
    return STOPPED, said


def read_back_and_flown(scenario: Scenario) -> str:
    """How a flight ends of what was accepted, which is written and read back before."""
    text = dump_scenario(scenario)
    assert dump_scenario(parse_scenario(text, trust=True)) == text
    return ending_of(lambda: simulate(scenario))[0]
