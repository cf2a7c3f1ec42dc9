"""The command `drake-nonstop` in a process of its own, and what is to be said of its end."""

import atexit
import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from adversary.processes import command_line, descendants, end_all_below, slowness
from adversary.verdicts import (
    ACCEPTED,
    EXIT_CODE,
    HANG,
    LEFTOVER,
    REFUSED,
    SENTENCE,
    STOPPED,
    TRACEBACK,
    Verdict,
    judge_sentence,
)

ROOT = Path(__file__).resolve().parents[2]
_POLLING_PERIOD = 0.005  # s
_LEFTOVER_TIME = 4.0  # s, in which helpers of a command may end after it

COMPLETED_CODES = 0, 3  # 3: the run came to its end with an outcome that is not ok
FAILED_CODE, REFUSED_CODE = 1, 2


@dataclass(kw_only=True)
class Command:
    """A call of the command.

    It is forked from this process, which has imported the package, or with `is_fresh` it is an
    interpreter of its own. `flown` is what `progress` of the package was last told, in
    forked commands: simulated seconds or the share of a task.
    """

    arguments: Sequence[str]
    folder: Path  # the current one
    environment: dict[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()  # variables of the environment
    is_fresh: bool = False
    stdout: str = ""  # "closed", "full", "pipe" (whose reader has gone), or a file
    program: Callable[[], int] | None = None  # in place of the command, if forked
    script: str = ""  # in place of the command, if fresh: a program,
    python: Sequence[str] | None = None  # or arguments of the interpreter
    stdin: str = os.devnull  # a file

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)
        beside = self.folder.parent
        count = len(list(beside.glob("stdout*")))
        self._paths = [beside / f"{name}{count}" for name in ("stdout", "stderr", "progress")]
        self.started = time.monotonic()
        self.code: int | None = None  # negative: of the signal that ended it
        self._process = (self._start_fresh if self.is_fresh else self._fork)()

    @property
    def out(self) -> str:
        return self._paths[0].read_text(encoding="utf-8", errors="replace")

    @property
    def error(self) -> str:
        return self._paths[1].read_text(encoding="utf-8", errors="replace")

    @property
    def flown(self) -> float:
        with contextlib.suppress(OSError, ValueError):
            return float(self._paths[2].read_text() or 0)
        return 0.0

    @property
    def pid(self) -> int:
        return self._process

    def await_start(self) -> None:
        """Returns where a forked process has come to the command itself."""
        while not self.is_fresh and not self._paths[2].exists() and not self.wait(0):
            time.sleep(_POLLING_PERIOD)
        self.started = time.monotonic()

    def send(self, number: int, *, to_group: bool = True) -> None:
        """Sends a signal: to the group as a terminal does, or to the command alone."""
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if to_group else os.kill)(self._process, number)

    def workers(self) -> list[int]:
        """The processes below it that simulate: children of its fork server."""
        return [
            worker
            for below in descendants(self._process)
            if "forkserver" in command_line(below)
            for worker in descendants(below)
        ]

    def wait(self, limit: float) -> bool:
        """Whether it ends within so many seconds."""
        end = time.monotonic() + limit
        while self.code is None:
            found, status = os.waitpid(self._process, os.WNOHANG)
            if found:
                self.code = os.waitstatus_to_exitcode(status)
                break
            if time.monotonic() > end:
                return False
            time.sleep(_POLLING_PERIOD)
        return True

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process, signal.SIGKILL)
        self.wait(10)

    def leftovers(self) -> list[str]:
        """Processes that it leaves behind, which are ended."""
        end = time.monotonic() + _LEFTOVER_TIME * slowness()
        while time.monotonic() < end:
            if not descendants(os.getpid()):
                return []
            time.sleep(0.05)
        found = [command_line(process) for process in descendants(os.getpid())]
        end_all_below(os.getpid())
        return found

    def _environment(self) -> dict[str, str]:
        environment = dict(os.environ) | {"PYTHONPATH": str(ROOT)} | self.environment
        return {name: value for name, value in environment.items() if name not in self.without}

    def _open_out(self) -> int:
        path = {"full": "/dev/full", "closed": os.devnull}.get(self.stdout, self._paths[0])
        self._paths[0].touch()
        if self.stdout == "pipe":
            reader, writer = os.pipe()
            os.close(reader)
            return writer
        return os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)

    def _start_fresh(self) -> int:
        out, error = self._open_out(), os.open(self._paths[1], os.O_WRONLY | os.O_CREAT, 0o644)

        def prepare() -> None:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
                signal.signal(number, signal.SIG_DFL)
            if self.stdout == "closed":
                os.close(1)

        call = ["-m", "drake_nonstop.cli"] if self.python is None else [*self.python]
        if self.script:
            call = ["-c", self.script]
        source = os.open(self.folder / (self.stdin or os.devnull), os.O_RDONLY)
        process = subprocess.Popen(
            [sys.executable, *call, *self.arguments],
            cwd=self.folder,
            env=self._environment(),
            stdin=source,
            stdout=out,
            stderr=error,
            start_new_session=True,
            preexec_fn=prepare,
        )
        for descriptor in (source, out, error):
            os.close(descriptor)
        process.returncode = 0  # it is waited for here
        return process.pid

    def _fork(self) -> int:
        process = os.fork()
        if process:
            with contextlib.suppress(OSError):  # whoever comes first
                os.setpgid(process, process)
            return process
        try:
            code = self._in_child()
        except BaseException:
            traceback.print_exc()
            code = 99
        os._exit(code)

    def _in_child(self) -> int:
        """What an interpreter does around the command."""
        with contextlib.suppress(PermissionError):  # the parent has made it a group's leader
            os.setsid()
        os.chdir(self.folder)
        environment = self._environment()
        os.environ.clear()
        os.environ.update(environment)
        out = self._open_out()
        os.dup2(out, 1)
        os.close(out)
        os.dup2(os.open(self._paths[1], os.O_WRONLY | os.O_CREAT, 0o644), 2)
        encoding, _, errors = environment.get("PYTHONIOENCODING", "utf-8").partition(":")
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(io.FileIO(1, "w", closefd=False)),
            encoding=encoding,
            errors=errors or "strict",
        )
        sys.stderr = io.TextIOWrapper(
            io.FileIO(2, "w", closefd=False),  # type: ignore[arg-type]
            encoding=encoding,
            errors="backslashreplace",
            write_through=True,
        )
        if self.stdout == "closed":
            os.close(1)
            sys.stdout = None  # type: ignore[assignment]
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _note_progress(self._paths[2])
        sys.argv = ["drake-nonstop", *self.arguments]
        return _as_interpreter(self.program or _main)


def _main() -> int:
    from drake_nonstop.cli.main import main

    return main()


def _note_progress(path: Path) -> None:
    """Has the package's bars write what they are told to a file."""
    from drake_nonstop.view.progress import RunProgress, TaskProgress

    file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
    for bar in (RunProgress, TaskProgress):

        def noting(self, *told, _call=bar.__call__):  # type: ignore[no-untyped-def]
            os.pwrite(file, f"{told[-1]:<24.9g}".encode(), 0)
            return _call(self, *told)

        bar.__call__ = noting  # type: ignore[method-assign]


def _as_interpreter(program: Callable[[], int]) -> int:
    """The exit code of `sys.exit(program())` with all that an interpreter does at its end."""
    code, is_interrupted = 1, False
    try:
        result = program()
        code = result if isinstance(result, int) else 0
    except SystemExit as ended:
        if isinstance(ended.code, int) or ended.code is None:
            code = ended.code or 0
        else:
            print(ended.code, file=sys.stderr)
    except BaseException as error:
        is_interrupted = isinstance(error, KeyboardInterrupt)
        traceback.print_exc()
    try:
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
    except BaseException:
        traceback.print_exc()
    try:
        if sys.stdout is not None and not sys.stdout.closed:
            sys.stdout.flush()
    except BaseException as error:
        print(f"Exception ignored in: stdout: {error!r}", file=sys.stderr)
        code = 120
    if is_interrupted:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    return code & 0xFF


_PROGRESS = re.compile(
    r"\|[.#0-9 █▏▎▍▌▋▊▉]*\||x real time|^\s*$|^warning: |^watch |^usage: |^ {6,}\S|^\s*\d+%"
    r"|^the loop is compiled as C, once"
)


def error_lines(text: str) -> list[str]:
    """The lines of a standard error, without progress and usage."""
    lines = re.split(r"[\n\r]+", text)
    return [line for line in lines if line and not _PROGRESS.search(line)]


def last_frame(text: str) -> str:
    """The last error of a traceback and the line of the package that it came through."""
    frames = re.findall(r'File "[^"]*?(drake_nonstop/[^"]*|diagrams/[^"]*)", line (\d+)', text)
    errors = re.findall(r"^(\w[\w.]*(?:Error|Exception|Interrupt|Exit|Warning)\b.*)$", text, re.M)
    place = ":".join(frames[-1]) if frames else "outside the package"
    return f"{errors[-1] if errors else text[-200:]} [{place}]"


def judge(command: Command, *, codes: Sequence[int] = (), has_own_code: bool = False) -> Verdict:
    """The verdict on a command that has ended; `codes` are allowed beside those of any end."""
    verdict, code = Verdict(), command.code
    error, out = command.error, command.out
    lines = error_lines(error)
    sentences = [s for s in lines if re.match(r"drake-nonstop( [\w-]+)*: ", s)]
    has_traceback = "Traceback (most recent call last)" in error + out
    if has_traceback or "Exception ignored" in error or "Fatal Python error" in error:
        verdict.add(TRACEBACK, last_frame(error + out))
    elif (strange := set(lines) - set(sentences)) and command.stdout != "closed":
        # A help goes to the standard error where there is no output.
        verdict.add(SENTENCE, f"stray line: {min(strange)}")
    if code in COMPLETED_CODES:
        verdict.ending = ACCEPTED
        if code == 0 and sentences:
            verdict.add(EXIT_CODE, f"0 with the error {sentences[0]}")
    elif code == REFUSED_CODE:
        verdict.ending = REFUSED
        if len(sentences) != 1:
            verdict.add(SENTENCE, f"{len(sentences)} sentences: {' / '.join(lines)[:300]}")
        elif re.match(r"drake-nonstop( [\w-]+)*: error: ", sentences[0]):
            pass  # argparse's
        else:
            judge_sentence(
                verdict, sentences[0].removeprefix("drake-nonstop: "), has_own_code=has_own_code
            )
    elif code == FAILED_CODE:
        verdict.ending = STOPPED
        if not sentences and not out.strip() and not verdict.faults:
            verdict.add(SENTENCE, "exit code 1 without a word")
    elif code in codes:
        verdict.ending = STOPPED
    elif not verdict.faults:
        verdict.add(EXIT_CODE, f"{code}: {(lines or ['no word'])[-1]}")
    return verdict


def ended(command: Command, limit: float, *, has_own_code: bool = False) -> Verdict:
    """Waits for a command that should end by itself, and judges its end."""
    if not command.wait(limit * slowness()):
        verdict = Verdict(ending=STOPPED)
        verdict.add(HANG, f"more than {limit:g} s: {' '.join(command.arguments)[:200]}")
        command.kill()
        end_all_below(os.getpid())
        return verdict
    verdict = judge(command, has_own_code=has_own_code)
    for process in command.leftovers():
        verdict.add(LEFTOVER, f"process {process}")
    return verdict
