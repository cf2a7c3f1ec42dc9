"""Copies of the checkout in which faults are made and tests are run."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mutants.faults import Fault

_TICK, _GRACE = 0.05, 10.0  # s, between two looks at a process, and until it is killed
# Variables of the environment that would make tests do something else.
_LEFT_OUT = ("CI", "DRAKE_NONSTOP_CACHE", "PYTHONHOME")


class EndedError(RuntimeError):
    """The processes have been ended, as by Ctrl-C."""


class Ran(NamedTuple):
    """How a process ended."""

    code: int | None  # negative: by that signal; None: it took too long
    output: str
    seconds: float


class Processes:
    """Runs processes, each in a group of its own, until all are ended."""

    def __init__(self) -> None:
        self._is_over = threading.Event()

    def end(self) -> None:
        """Has all processes end, and each further call raise `EndedError`."""
        self._is_over.set()

    def run(
        self, call: Sequence[str], *, folder: Path, output: Path, env: dict[str, str], limit: float
    ) -> Ran:
        """Runs a process with all that it starts, for at most `limit` s.

        Args:
            call: the command.
            folder: in which it runs.
            output: a file for what it prints: a pipe would stay open as long as a child has it.
            env: its environment.
            limit: s.

        Raises:
            EndedError: all processes have been ended.
        """
        if self._is_over.is_set():
            raise EndedError
        start = time.monotonic()
        with output.open("wb") as file:
            process = subprocess.Popen(
                call,
                cwd=folder,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        try:
            has_ended = _ends_until(process, start + limit, self._is_over)
            if not has_ended:
                process.send_signal(signal.SIGINT)  # lets fixtures end what they have started
                _ends_until(process, time.monotonic() + _GRACE)
        finally:
            # No other group can have its number before the process is waited for.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if self._is_over.is_set():
            raise EndedError
        text = output.read_text(encoding="utf-8", errors="replace")
        code = process.returncode if has_ended else None
        return Ran(code, text, time.monotonic() - start)


def _ends_until(
    process: subprocess.Popen, deadline: float, is_over: threading.Event | None = None
) -> bool:
    """Whether a process ends before a deadline, and before all are ended."""
    while os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() > deadline or (is_over is not None and is_over.is_set()):
            return False
        time.sleep(_TICK)
    return True


class Copy:
    """A copy of what git tracks, or would, with the content of the working tree.

    Args:
        source: the checkout.
        folder: a new one, for the copy, its cache and its temporary files.
        processes: what runs them.
    """

    def __init__(self, source: Path, folder: Path, processes: Processes):
        self.root, self._folder, self._processes = folder / "checkout", folder, processes
        for part in (self.root, folder / "cache", folder / "temporary"):
            part.mkdir(parents=True)
        call = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(call, cwd=source, capture_output=True, check=True).stdout
        for name in filter(None, os.fsdecode(names).split("\0")):
            path, copied = source / name, self.root / name
            if not os.path.lexists(path):
                continue  # it is deleted, and git does not know yet
            copied.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, copied, follow_symlinks=False)
        kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
        for name in _LEFT_OUT:
            kept.pop(name, None)
        self._env = kept | {
            "PYTHONPATH": str(self.root),
            "OPENBLAS_NUM_THREADS": "1",
            "XDG_CACHE_HOME": str(folder / "cache"),
            "TMPDIR": str(folder / "temporary"),
        }

    def imported_from(self) -> Path:
        """The folder of the package that Python imports in the copy."""
        code = "import drake_nonstop; print(drake_nonstop.__file__)"
        ran = self._run([sys.executable, "-c", code], self._folder, limit=300.0)
        lines = ran.output.strip().splitlines()
        return Path(lines[-1]).parent if ran.code == 0 and lines else Path()

    def run_tests(self, tests: Sequence[str], limit: float) -> Ran:
        """Runs tests up to the first one that fails, for at most `limit` s."""
        shutil.rmtree(self.root / ".hypothesis", ignore_errors=True)  # examples of other faults
        call = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-n", "0"]
        call += ["-m", "not nightly", f"--basetemp={self._folder / 'temporary' / 'tests'}"]
        return self._run([*call, *tests], self.root, limit)

    def _run(self, call: Sequence[str], folder: Path, limit: float) -> Ran:
        output = self._folder / "output"
        return self._processes.run(call, folder=folder, output=output, env=self._env, limit=limit)

    @contextlib.contextmanager
    def with_fault(self, fault: Fault) -> Iterator[None]:
        """The copy has a fault."""
        path = self.root / fault.file
        text = path.read_text(encoding="utf-8")
        _write(path, fault.made_in(text))
        try:
            yield
        finally:
            _write(path, text)


def _write(path: Path, text: str) -> None:
    """Writes a file anew; a compiled one of the same second and length would still count."""
    path.write_text(text, encoding="utf-8")
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink(missing_ok=True)
