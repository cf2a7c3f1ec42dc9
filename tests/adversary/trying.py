"""Tries cases, each in a process of its own, and counts what is found."""

import contextlib
import importlib
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adversary import earlier
from adversary.processes import become_subreaper, end_all_below, slowness
from adversary.verdicts import HANG, STOPPED, TRACEBACK, Case, Verdict

# The classes of inputs, each a module with a function `draw`, and their shares of all cases.
CLASSES = {
    "yaml": 0.28,
    "overrides": 0.27,
    "python": 0.19,
    "files": 0.07,
    "command_line": 0.07,
    "signals": 0.055,
    "kills": 0.025,
    "blocks": 0.03,
    "scripts": 0.01,
}
_MODULES = {"yaml": "yaml_texts", "signals": "interrupts", "blocks": "own_blocks"}
_MEMORY = 4 << 30  # bytes that a process may have beyond what the imports take


@dataclass(kw_only=True)
class Tried:
    """A case that was tried."""

    class_name: str
    seed: int
    number: int
    text: str
    seconds: float
    verdict: Verdict

    @property
    def repeat(self) -> str:
        return (
            f"python -m adversary --class {self.class_name} --seed {self.seed} "
            f"--number {self.number}"
        )


@dataclass
class _Running:
    class_name: str
    number: int
    case: Case
    process: int
    pipe: int
    folder: Path
    started: float = field(default_factory=time.monotonic)


def draw(class_name: str, seed: int, number: int) -> Case:
    """The case of that class, seed and number, whatever else was drawn."""
    module = importlib.import_module(f"adversary.{_MODULES.get(class_name, class_name)}")
    rng = np.random.default_rng([seed, zlib.crc32(class_name.encode()), number])
    return module.draw(rng)


def shares(count: int) -> list[tuple[str, int]]:
    """So many classes and numbers, in the proportions of `CLASSES`, in one mixed order."""
    numbered = [
        (name, number)
        for name, share in CLASSES.items()
        for number in range(max(1, round(share * count)))
    ]
    order = np.random.default_rng(count).permutation(len(numbered))
    return [numbered[k] for k in order]


def warm_up() -> None:
    """Imports the package and runs it once, for all processes that are forked from this one."""
    import warnings

    import drake_nonstop  # noqa: F401
    from drake_nonstop.cli import main  # noqa: F401
    from drake_nonstop.run.simulate import simulate
    from drake_nonstop.scenario.loading import load_scenario
    from drake_nonstop.studies import study  # noqa: F401

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in ("quintic", "three_carriers"):
            simulate(load_scenario(name, ["simulation_duration=0.02"]))
        earlier.finished()


def try_all(
    numbered: Iterable[tuple[str, int]],
    seed: int,
    *,
    jobs: int = 2,
    report: Callable[[Tried], None] = lambda tried: None,
) -> list[Tried]:
    """Tries cases given by class and number, so many at a time."""
    waiting, running, done = iter(numbered), {}, []
    while True:
        while len(running) < jobs and (following := next(waiting, None)) is not None:
            begun = _begin(*following, seed)
            running[begun.pipe] = begun
        if not running:
            return done
        ready, _, _ = select.select(list(running), [], [], 0.2)
        for begun in list(running.values()):
            limit = begun.case.limit * slowness()
            if begun.pipe in ready or time.monotonic() > begun.started + limit:
                del running[begun.pipe]
                tried = _finish(begun, seed, has_answered=begun.pipe in ready)
                done.append(tried)
                report(tried)


def _begin(class_name: str, number: int, seed: int) -> _Running:
    case = draw(class_name, seed, number)
    folder = Path(tempfile.mkdtemp(prefix="adversary-"))
    (folder / "here").mkdir()
    reader, writer = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if process == 0:
        os.close(reader)
        try:
            verdict = _verdict(case, folder)
        except BaseException:  # of the adversary itself
            verdict = Verdict(ending=STOPPED)
            verdict.add("adversary", traceback.format_exc()[-500:])
        end_all_below(os.getpid())
        os.write(writer, json.dumps([verdict.ending, verdict.faults]).encode())
        os._exit(0)
    os.close(writer)
    return _Running(class_name, number, case, process, reader, folder)


def _verdict(case: Case, folder: Path) -> Verdict:
    os.setsid()
    become_subreaper()
    os.chdir(folder / "here")
    null, log = os.open(os.devnull, os.O_RDONLY), os.open(folder / "log", os.O_RDWR | os.O_CREAT)
    for target, source in ((0, null), (1, log), (2, log)):
        os.dup2(source, target)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    return case.attempt(folder / "here")


def _finish(begun: _Running, seed: int, *, has_answered: bool) -> Tried:
    seconds = time.monotonic() - begun.started
    verdict = Verdict(ending=STOPPED)
    answer = os.read(begun.pipe, 1 << 20) if has_answered else b""
    os.close(begun.pipe)
    if not has_answered:
        verdict.add(HANG, f"more than {begun.case.limit:g} s")
    end_all_below(begun.process)
    with contextlib.suppress(ProcessLookupError):
        if not answer:
            os.kill(begun.process, signal.SIGKILL)
    _, status = os.waitpid(begun.process, 0)
    if answer:
        ending, faults = json.loads(answer)
        verdict = Verdict(ending=ending, faults=[(kind, detail) for kind, detail in faults])
    elif has_answered:
        log = (begun.folder / "log").read_text(errors="replace")[-300:]
        code = os.waitstatus_to_exitcode(status)
        verdict.add(TRACEBACK, f"the process ended with {code}: {log}")
    _remove(begun.folder)
    return Tried(
        class_name=begun.class_name,
        seed=seed,
        number=begun.number,
        text=begun.case.text,
        seconds=seconds,
        verdict=verdict,
    )


def _remove(folder: Path) -> None:
    for path in (folder, *folder.rglob("*")):
        with contextlib.suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o755)
    shutil.rmtree(folder, ignore_errors=True)
