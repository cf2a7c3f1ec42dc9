"""Signals at drawn times: Ctrl-C once and more often, SIGTERM, SIGHUP, SIGQUIT and SIGPIPE.

A command ends within 2 s of the second Ctrl-C and the time to write what was flown, which is
kept; two signals at one instant may reach it as one. It says one sentence, has the exit code that
a shell gives for the signal, keeps what is finished, and the same call continues from there.
"""

import json
import os
import signal
import time
from pathlib import Path

import numpy as np

from adversary import earlier
from adversary.commands import Command, ended, judge
from adversary.processes import end_all_below, slowness
from adversary.verdicts import (
    EXIT_CODE,
    HANG,
    LEFTOVER,
    LOST_WORK,
    STOPPED,
    TRACEBACK,
    Case,
    Verdict,
)

SPEC = (
    "overrides: ['system.load_mass=!Uniform {min: 0.9, max: 1.1}', "
    "simulation_duration=0.1]\nseeds: 30\n"
)
GRID = "grid: {system.load_mass: [0.9, 0.95, 1.0, 1.05, 1.1, 1.15]}\n"

# Calls, and how long each takes on an idle machine, in s, from its start in a forked process.
CALLS: dict[str, tuple[list[str], float]] = {
    "run": (
        ["run", "line", "--set", "simulation_duration=1000", "--no-figures", "--out", "out"],
        3.0,
    ),
    "run to its end": (["run", "line", "--set", "simulation_duration=3", "--out", "out"], 4.0),
    "run live": (
        [
            "run",
            "line",
            "--live",
            "--set",
            "simulation_duration=1000",
            "--no-figures",
            "--no-replay",
            "--out",
            "out",
        ],
        4.0,
    ),
    "sweep": (["sweep", "line", "s.yaml", "--out", "out"], 5.0),
    "ablate": (
        [
            "ablate",
            "line",
            "--grid",
            "g.yaml",
            "--no-replay",
            "--set",
            "simulation_duration=0.3",
            "--out",
            "out",
        ],
        6.0,
    ),
    "robustness": (["robustness", "line", "--set", "simulation_duration=0.2", "--out", "out"], 6.0),
    "stability": (["stability", "line", "--out", "out"], 20.0),
    "check": (["check", "aircraft_rest", "--out", "out/check"], 3.0),
    "list": (["list"], 0.5),
}
_WEIGHTS = {
    "run": 4,
    "run to its end": 2,
    "run live": 1,
    "sweep": 4,
    "ablate": 4,
    "robustness": 2,
    "stability": 1,
    "check": 1,
    "list": 0.5,
}

_AFTER_SECOND = 2.0  # s, in which a command ends after the second Ctrl-C
_PER_FLOWN = 0.015  # s more for each simulated second, whose data it writes
_AFTER_FIRST = 20.0  # s, in which it does after the first, or SIGTERM: it writes what there is


def draw(rng: np.random.Generator) -> Case:
    weights = np.array(list(_WEIGHTS.values()))
    name = str(rng.choice(list(_WEIGHTS), p=weights / weights.sum()))
    is_fresh = bool(rng.random() < 0.3)
    number = int(rng.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], p=[0.7, 0.18, 0.12]))
    times = int(rng.choice([1, 2, 2, 3])) if number == signal.SIGINT else 1
    length = CALLS[name][1]
    early = rng.random() < (0.6 if is_fresh else 0.2)
    first = float(rng.uniform(0, 0.6) if early else rng.uniform(0, length))
    gaps = [float(gap) for gap in rng.choice([0.0, 0.01, 0.1, 0.4, 0.9, 1.5], times - 1)]
    to_group = bool(rng.random() < 0.7) if number != signal.SIGTERM else bool(rng.random() < 0.3)
    has_earlier = bool(rng.random() < 0.5)
    signals = f"{signal.Signals(number).name} after {first:.3f} s"
    signals += "".join(f", again {gap:g} s later" for gap in gaps)
    text = f"{' '.join(CALLS[name][0])}: {signals}, to {'the group' if to_group else 'it alone'}"
    text += f"{', in a folder with earlier results' if has_earlier else ''}"
    text += f"{' (fresh)' if is_fresh else ''}"
    return Case(
        text=text,
        attempt=lambda folder: _attempt(
            folder, name, is_fresh, number, first, gaps, to_group, has_earlier
        ),
        limit=150,
    )


def prepare(folder: Path, *, has_earlier: bool) -> Path:
    """Writes what the calls read; returns the folder of results."""
    (folder / "s.yaml").write_text(SPEC)
    (folder / "g.yaml").write_text(GRID)
    if has_earlier:
        earlier.put(folder / "out")
    return folder / "out"


def _attempt(
    folder: Path,
    name: str,
    is_fresh: bool,
    number: int,
    first: float,
    gaps: list[float],
    to_group: bool,
    has_earlier: bool,
) -> Verdict:
    out = prepare(folder, has_earlier=has_earlier)
    arguments = CALLS[name][0]
    command = Command(arguments=arguments, folder=folder, is_fresh=is_fresh)
    command.await_start()
    if command.wait(first * min(3.0, slowness())):
        return judge(command)  # it was faster
    flown = command.flown
    rows = journal_rows(out)
    command.send(number, to_group=to_group)
    sent = time.monotonic()
    for gap in gaps:
        if command.wait(gap):
            break
        command.send(number, to_group=to_group)
        sent = time.monotonic()
    verdict = Verdict(ending=STOPPED)
    is_second_sure = max(gaps, default=0.0) > 0  # pending signals of a kind are one
    limit = _AFTER_SECOND + _PER_FLOWN * flown if is_second_sure else _AFTER_FIRST
    limit *= slowness()
    if not command.wait(limit):
        waited = time.monotonic() - sent
        gone = command.wait(15 * slowness())
        what = f"{name}: {signal.Signals(number).name} x {1 + len(gaps)}: "
        state = f"ended after {time.monotonic() - sent:.1f} s" if gone else "does not end"
        verdict.add(HANG, f"{what}{state}, {waited:.1f} s allowed")
        command.kill()
    else:
        verdict = judge(command, codes=[128 + number])
        _judge_code(verdict, command, name, number)
    for process in command.leftovers():
        verdict.add(LEFTOVER, f"{name}: process {process}")
    end_all_below(os.getpid())
    _judge_work(verdict, command, name, out, flown, rows, len(gaps) + 1)
    is_repeated = name in ("sweep", "ablate", "check", "run to its end")
    if is_repeated and not verdict.faults:
        _judge_continued(verdict, folder, arguments, out, name)
    return verdict


def _judge_code(verdict: Verdict, command: Command, name: str, number: int) -> None:
    """The shell's code for the signal, or that of an end just before it."""
    fine = {128 + number, -number}
    if command.code in (0, 3) or (command.code == 2 and "Ctrl-C" not in command.error):
        # It ended by itself meanwhile: only where it was about to, anyway.
        if name in ("run", "run live", "stability") and command.code == 0:
            verdict.add(EXIT_CODE, f"{name}: 0 after {signal.Signals(number).name}")
        return
    if command.code in fine:
        verdict.faults = [fault for fault in verdict.faults if fault[0] != EXIT_CODE]
    elif not any(kind in (TRACEBACK, EXIT_CODE) for kind, _ in verdict.faults):
        word = (command.error.strip().splitlines() or ["no word"])[-1]
        verdict.add(
            EXIT_CODE, f"{name}: {command.code} after {signal.Signals(number).name}: {word}"
        )


def journal_rows(out: Path) -> list[str]:
    """The whole lines of a sweep's journal."""
    journal = out / "journal.jsonl"
    if not journal.is_file():
        return []
    return journal.read_text(errors="replace").split("\n")[:-1]


def _judge_work(
    verdict: Verdict,
    command: Command,
    name: str,
    out: Path,
    flown: float,
    rows: list[str],
    times: int,
) -> None:
    """What was finished before the signal has to be there."""
    if name.startswith("run"):
        stopped = out.with_name("out_stopped")
        if stopped.exists():  # beside the earlier results, which stay as they are
            earlier.judge_results(verdict, stopped, flown if times == 1 else 0.0)
            earlier.judge_results(verdict, out, 0.0)
        elif out.exists():
            earlier.judge_results(verdict, out, flown if times == 1 else 0.0)
        elif flown > 0 and times == 1:
            verdict.add(LOST_WORK, f"{flown:.3g} s were flown, but there is no folder")
    elif name.startswith("sweep"):
        if journal_rows(out)[: len(rows)] != rows:
            verdict.add(LOST_WORK, "rows of the journal are gone")
    elif name in ("ablate", "robustness", "stability") and 0 < flown < 1:
        new = [
            path
            for path in out.rglob("*")
            if path.is_file()
            and not any(part.startswith(".new-") for part in path.parts)
            and path.name not in (*earlier.FILES, "notes.txt")
        ]
        if name == "ablate":
            new = [*out.glob("*/metrics.json")]
        if not new:
            verdict.add(LOST_WORK, f"{name}: {flown:.0%} were done, and nothing of it is there")
    if not any(kind == HANG for kind, _ in verdict.faults):
        earlier.judge_tidiness(verdict, out)
    before, now = earlier.hashes(earlier.finished()), earlier.hashes(out) if out.exists() else {}
    is_apart = not name.startswith(("run", "sweep"))
    if "notes.txt" in now and is_apart and any(now.get(f) != before[f] for f in earlier.FILES):
        verdict.add(LOST_WORK, f"{name}: earlier results are changed")


def _judge_continued(
    verdict: Verdict, folder: Path, arguments: list[str], out: Path, name: str
) -> None:
    """The same call comes to its end, and has not done again what was finished."""
    kept = journal_rows(out)
    variants = {path: path.stat().st_mtime_ns for path in out.glob("*/signals.npz")}
    again = Command(arguments=arguments, folder=folder)
    second = ended(again, 60)
    if again.code not in (0, 3):
        word = (again.error.strip().splitlines() or ["no word"])[-1]
        second.add(EXIT_CODE, f"{name} again: {again.code}: {word}")
    verdict.merge(second)
    if kept and journal_rows(out)[: len(kept)] != kept:
        verdict.add(LOST_WORK, f"{name} again: finished runs were run again")
    if name.startswith("sweep"):
        keys = [json.loads(line).get("key") for line in journal_rows(out)[1:]]
        if len(keys) != 30 or len({*keys}) != 30:
            verdict.add(LOST_WORK, f"{name} again: runs {keys}")
    repeated = [path.parent.name for path, t in variants.items() if path.stat().st_mtime_ns != t]
    # What the journal did not have yet is run again.
    if repeated and kept and len(repeated) > len(variants) - (len(kept) - 1):
        verdict.add(LOST_WORK, f"{name} again: finished variants {repeated} were run again")
    earlier.judge_tidiness(verdict, out)
