"""Calls of the package's functions, and what they may raise."""

import io
import traceback
import warnings
from collections.abc import Callable
from typing import Any

from adversary.commands import last_frame
from adversary.verdicts import (
    ACCEPTED,
    REFUSED,
    STOPPED,
    TRACEBACK,
    Verdict,
    judge_sentence,
)
from drake_nonstop import RunInterrupted, RunStopped, ScenarioError
from drake_nonstop.studies.journal import StudyInterrupted


def attempt_call(
    call: Callable[[], Any], *, has_own_code: bool = False, allowed: tuple[type, ...] = ()
) -> tuple[Any, Verdict]:
    """The result of a call, None where it raised, and the verdict on what it raised.

    ScenarioError refuses an input; RunStopped and the interruptions end a run; Python's own
    TypeError for a wrong number or name of arguments is left alone. All else is a fault.
    """
    verdict = Verdict(ending=ACCEPTED)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return call(), verdict
    except ScenarioError as error:
        verdict.ending, verdict.message = REFUSED, str(error)
        judge_sentence(verdict, str(error), has_own_code=has_own_code)
    except (RunStopped, RunInterrupted, StudyInterrupted):
        verdict.ending = STOPPED
    except allowed:
        verdict.ending = REFUSED
    except BaseException as error:
        verdict.ending = REFUSED
        if not _is_pythons_own(error):
            verdict.ending = STOPPED
            text = io.StringIO()
            traceback.print_exception(error, limit=-40, file=text)
            verdict.add(TRACEBACK, last_frame(text.getvalue()))
    return None, verdict


def _is_pythons_own(error: BaseException) -> bool:
    """Whether an error is Python's for a call that cannot be made, or one of the caller's code."""
    words = "positional argument", "required keyword", "unexpected keyword", "multiple values"
    if isinstance(error, TypeError) and any(word in str(error) for word in words):
        return True
    files = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    is_in_package = any("/drake_nonstop/" in file or "/diagrams/" in file for file in files)
    is_callers = files[-1] == "<typed>" and isinstance(error, Exception)
    return is_callers or (not is_in_package and isinstance(error, Exception))
