"""SIGKILL of a worker or of the command itself at drawn times.

Of a worker: the command goes on and comes to its end. Of the command: no process stays behind,
and the same call comes to its end from what is there, and leaves no temporary files.
"""

import contextlib
import os
import signal
import time
from pathlib import Path

import numpy as np

from adversary import earlier
from adversary.commands import Command, ended
from adversary.interrupts import CALLS, _judge_continued, journal_rows, prepare
from adversary.processes import slowness
from adversary.verdicts import EXIT_CODE, LEFTOVER, LOST_WORK, STOPPED, Case, Verdict

_WEIGHTS = {"run to its end": 2, "sweep": 3, "ablate": 3, "robustness": 1.5}
_WEIGHTS["check"] = 1


def draw(rng: np.random.Generator) -> Case:
    weights = np.array(list(_WEIGHTS.values()))
    name = str(rng.choice(list(_WEIGHTS), p=weights / weights.sum()))
    has_workers = name in ("sweep", "ablate", "robustness")
    target = str(rng.choice(["a worker", "a worker", "all workers", "the command"]))
    target = target if has_workers else "the command"
    after = float(rng.uniform(0, CALLS[name][1]))
    is_fresh, has_earlier = bool(rng.random() < 0.25), bool(rng.random() < 0.5)
    text = f"{' '.join(CALLS[name][0])}: SIGKILL of {target} after {after:.3f} s"
    text += f"{', in a folder with earlier results' if has_earlier else ''}"
    text += f"{' (fresh)' if is_fresh else ''}"
    return Case(
        text=text,
        attempt=lambda folder: _attempt(folder, name, target, after, is_fresh, has_earlier),
        limit=180,
    )


def _attempt(
    folder: Path, name: str, target: str, after: float, is_fresh: bool, has_earlier: bool
) -> Verdict:
    out = prepare(folder, has_earlier=has_earlier)
    arguments = CALLS[name][0]
    command = Command(arguments=arguments, folder=folder, is_fresh=is_fresh)
    command.await_start()
    if target == "the command":
        command.wait(after * min(3.0, slowness()))
        flown, rows = command.flown, journal_rows(out)
        is_over = command.code is not None
        command.kill()
        verdict = Verdict(ending=STOPPED)
        for process in command.leftovers():
            verdict.add(LEFTOVER, f"{name}: process {process}")
        if is_over:
            return verdict
        if name in ("run to its end", "check") and out.exists():
            earlier.judge_results(verdict, out, 0.0)
        if journal_rows(out)[: len(rows)] != rows:
            verdict.add(LOST_WORK, f"{name}: rows of the journal are gone")
        if name == "ablate" and 0.2 < flown < 1 and not [*out.glob("*/metrics.json")]:
            verdict.add(LOST_WORK, f"{name}: {flown:.0%} were done, and nothing of it is there")
        if name != "robustness":
            _judge_continued(verdict, folder, arguments, out, name)
        return verdict
    end = time.monotonic() + 20 * slowness()
    workers: list[int] = []
    while not workers and time.monotonic() < end and not command.wait(0.01):
        workers = command.workers()
    command.wait(after / 2)
    workers = command.workers()
    for worker in workers[:1] if target == "a worker" else workers:
        with contextlib.suppress(ProcessLookupError):
            os.kill(worker, signal.SIGKILL)
    verdict = ended(command, 60)
    if command.code != 0 and command.code != 3:
        word = (command.error.strip().splitlines() or ["no word"])[-1]
        verdict.add(EXIT_CODE, f"{name}: {command.code} after a worker's end: {word}")
    earlier.judge_tidiness(verdict, out)
    if name.startswith("sweep") and len(journal_rows(out)) != 31:
        verdict.add(LOST_WORK, f"{name}: {len(journal_rows(out)) - 1} rows of 30")
    return verdict
