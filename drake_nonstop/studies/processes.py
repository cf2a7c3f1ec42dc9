"""Worker processes: they may die, be killed or never return, and nothing that is done is lost."""

import atexit
import contextlib
import gc
import math
import multiprocessing.forkserver as forkserver
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pipe, current_process, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

from drake_nonstop.run.interruption import before_end
from drake_nonstop.studies.files import remove_unfinished
from drake_nonstop.validation import ScenarioError, message_of, one_line, require, show_warning

PROCESS_DIED = "its process died: it crashed or ran out of memory"

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# In the process from which workers are forked, in this order.
_PRELOADED = [
    "drake_nonstop.studies.one_blas_thread",
    "drake_nonstop.studies.run_all",
    "drake_nonstop.public",
]
_KEEPING_TIME = 2.0  # s, for which an interrupt waits for results that are being written
_ENDING_TIME = 1.0  # s, for workers without a call to end by themselves
_MAX_FAILED_STARTS = 3  # in a row
_RESTART_PAUSE = 0.2  # s, in which a process that was killed ends
_GUARD = '`if __name__ == "__main__":`'

_READY, _KEEPING = "ready", "keeping"  # what a worker sends besides answers
_ALL = -1  # in the place of a number: the end of all calls
_MOST_TOGETHER, _PARTS = 32, 4  # calls that a process gets at a time, and how often at least

_connection: Connection | None = None  # to the parent, in a worker


class Answer(NamedTuple):
    """Result of a call, or the message of its error."""

    result: Any = None
    error: str = ""
    is_bad_input: bool = False  # the error is a ScenarioError

    @classmethod
    def of(cls, call: Callable[[], Any]) -> "Answer":
        """The answer of a call; raises only what breaks an executor, or Ctrl-C."""
        try:
            return cls(result=call())
        except ScenarioError as error:
            return cls(error=message_of(error), is_bad_input=True)
        except BrokenExecutor:
            raise
        except (Exception, SystemExit) as error:  # such as the SystemExit of a block
            return cls(error=one_line(error))


def require_main() -> None:
    """Checks that workers can import the script that starts them.

    In a process that is importing that script, and so runs what should be below the script's
    guard, it ends the process without a word: the parent tells why.

    Raises:
        ScenarioError: the script is in no file, or the process may start none.
    """
    if getattr(current_process(), "_inheriting", False):
        os._exit(1)
    remedy = "it may start no processes; call the study from a process that is none"
    require(not current_process().daemon, "process", "daemonic, as a pool's", remedy)
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    if getattr(main, "__spec__", None) is None and file and not Path(file).exists():
        raise ScenarioError(
            f"__main__ = {file}: processes import it as they start, and cannot; save it as a .py "
            f"file, with what it does in a function that is called below {_GUARD}"
        )


@contextlib.contextmanager
def deferred_signals(most: int = 1) -> Iterator[None]:
    """So many signals that ask for the end act at the end of the block only; one more at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[signal.Signals, Any] = {}
    noted: list[signal.Signals] = []

    def note(number: int, frame: Any) -> None:
        noted.append(signal.Signals(number))
        if len(noted) > most:
            handlers[noted[-1]](number, frame)

    try:
        for number in _SIGNALS:
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, note)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in noted[:1] if len(noted) <= most else ():
            handlers[number](number, None)


def keep_what_is_done() -> None:
    """Has an interrupt wait, for a short time, for the result of the call that this is part of."""
    if _connection is not None:
        _connection.send(_KEEPING)


def call_in_processes(
    function: Callable[..., Any],
    parts: Iterable[Sequence[Any]],
    arguments: Callable[[Any], tuple],
    record: Callable[[Any, Answer], None],
) -> None:
    """Makes calls of a function, in a process per core, and records answers as they come.

    The function takes the arguments of a part of the keys, in a list, and yields numbers of this
    list with the results for these, as `one_by_one` does. The calls whose processes die are
    repeated at the end, one after the other in a process of their own each; one that dies again is
    answered by an error.

    Where this ends by an error, the processes are killed; where it ends by an interrupt, those
    that keep what is done (`keep_what_is_done`) have a short time for that. A first signal while an
    answer is recorded acts at the end of that.

    Raises:
        ScenarioError: processes end as they start.
    """
    require_main()
    calls, count = _Calls(function, arguments, record), os.cpu_count() or 1
    for key in calls.make(parts, count):
        if calls.make([[key]], 1):
            record(key, Answer(error=PROCESS_DIED))


def one_by_one(function: Callable[..., Any], calls: Sequence[tuple]) -> Iterator[tuple[int, Any]]:
    """The numbers of calls of a function, and their results."""
    return ((k, function(*arguments)) for k, arguments in enumerate(calls))


def in_parts(keys: Sequence[Any], *, is_of_many: bool) -> list[Sequence[Any]]:
    """The keys in parts, of which each process gets several; else one by one."""
    size = math.ceil(len(keys) / (_PARTS * (os.cpu_count() or 1)))
    size = min(_MOST_TOGETHER, max(1, size)) if is_of_many else 1
    return [keys[start : start + size] for start in range(0, len(keys), size)]


@contextlib.contextmanager
def forked(call: Callable[[], None]) -> Iterator[BaseProcess]:
    """A fork of this process that makes a call; at the end of the block it is killed.

    It gets no signals and ends with this process; its exit code is 0 where the call returns.
    """
    process = get_context("fork").Process(target=_make, args=(call,), daemon=True)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield process
    finally:
        process.kill()
        process.join()


def _make(call: Callable[[], None]) -> None:
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    with contextlib.suppress(BaseException):
        call()
        os._exit(0)
    os._exit(1)


@dataclass(eq=False, kw_only=True)
class _Worker:
    """A process and the pipe to it."""

    process: BaseProcess
    connection: Connection
    is_ready: bool = False
    is_busy: bool = False
    is_keeping: bool = False
    keys: dict[int, Any] = field(default_factory=dict)  # of the calls that it has to answer

    def kill(self) -> None:
        """Ends the process at once."""
        _workers.discard(self)
        if self.process.pid is not None:
            self.process.kill()
        self.connection.close()


_workers: set[_Worker] = set()  # of this process


@atexit.register  # before multiprocessing, which would wait for them
def _kill_workers() -> None:
    for worker in list(_workers):
        worker.kill()


before_end.insert(0, _kill_workers)  # before what they were writing is removed


@dataclass
class _Calls:
    """The calls of a function in workers."""

    _function: Callable[..., Any]
    _arguments: Callable[[Any], tuple]
    _record: Callable[[Any, Answer], None]
    _workers: list[_Worker] = field(default_factory=list)
    _died: list[Any] = field(default_factory=list)  # keys of the calls whose processes have died
    _has_started: bool = False
    _failed_starts: int = 0

    def make(self, parts: Iterable[Sequence[Any]], count: int) -> list[Any]:
        """Makes the calls of parts of the keys, in so many processes at most.

        Returns the keys whose processes died.
        """
        waiting, self._died = deque(parts), []
        is_interrupt, ending_time = False, 0.0
        try:
            while waiting or any(worker.is_busy for worker in self._workers):
                busy = sum(worker.is_busy for worker in self._workers)
                while len(self._workers) < min(count, busy + len(waiting)):
                    self._start()
                for worker in self._workers:
                    if waiting and worker.is_ready and not worker.is_busy:
                        self._give(worker, waiting.popleft())
                self._hear(wait_for=None)
            ending_time = _ENDING_TIME
            return self._died
        except BaseException as error:
            is_interrupt = not isinstance(error, Exception)
            raise
        finally:
            try:
                if is_interrupt:
                    self._keep()
                self._dismiss(ending_time)
            finally:
                with deferred_signals(most=sys.maxsize):
                    for worker in self._workers:
                        worker.kill()
                    self._workers.clear()
                    if is_interrupt:
                        _stop_forkserver()

    def _start(self) -> None:
        """Starts one more worker."""
        context = get_context("forkserver")
        context.set_forkserver_preload(_PRELOADED)
        here, there = Pipe()
        worker = _Worker(process=context.Process(target=_work, args=(there,)), connection=here)
        self._workers.append(worker)
        _workers.add(worker)
        try:
            with contextlib.suppress(OSError, EOFError):  # the process to fork from was killed
                _ensure_forkserver()
                worker.process.start()
        finally:
            there.close()
        if worker.process.pid is None:
            self._lose(worker)
            time.sleep(_RESTART_PAUSE)

    def _give(self, worker: _Worker, keys: Sequence[Any]) -> None:
        """Has a worker make the calls of some keys."""
        worker.keys, worker.is_busy = dict(enumerate(keys)), True
        try:
            call = pickle.dumps((self._function, [*map(self._arguments, keys)]))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            worker.is_busy = False
            for key in keys:
                self._record(key, Answer(error=one_line(error)))
            return
        with contextlib.suppress(OSError):  # it has died, which shows in what is heard of it
            worker.connection.send_bytes(call)

    def _hear(self, wait_for: float | None) -> None:
        """Takes what has come from the workers, or comes within a time in s; None: any time."""
        sources: dict[Any, _Worker] = {}
        for worker in self._workers:
            sources |= {worker.connection: worker, worker.process.sentinel: worker}
        for worker in dict.fromkeys(sources[source] for source in wait([*sources], wait_for)):
            with deferred_signals():
                self._take(worker)

    def _take(self, worker: _Worker) -> None:
        """Takes one message of a worker, or its end."""
        message: Any = None
        with contextlib.suppress(OSError, EOFError):
            if worker.connection.poll():
                message = worker.connection.recv()
        if message is None:
            self._lose(worker)
        elif message == _READY:
            worker.is_ready = self._has_started = True
            self._failed_starts = 0
        elif message == _KEEPING:
            worker.is_keeping = True
        else:
            number, answer = message
            worker.is_keeping, worker.is_busy = False, number != _ALL
            if not worker.is_busy:  # an error is the answer to all that have none
                numbers = [*worker.keys] if answer.error else []
            else:
                numbers = [number]
                if not answer.error:  # which may be of what this process cannot import
                    answer = Answer.of(partial(pickle.loads, answer.result))
            for each in numbers:
                self._record(worker.keys.pop(each), answer)

    def _lose(self, worker: _Worker) -> None:
        """Notes the end of a worker; raises ScenarioError where workers end as they start."""
        self._workers.remove(worker)
        code = None
        if worker.process.pid is not None:
            worker.process.join(_ENDING_TIME)
            code = worker.process.exitcode
        worker.kill()
        if worker.is_busy:
            self._died += worker.keys.values()
        if worker.is_ready:
            return
        self._failed_starts += 1
        was_killed = code is None or code < 0 or code == 255  # by that of the forking process
        if not (was_killed or self._has_started):
            main = sys.modules["__main__"]
            script = getattr(main, "__file__", "a script without a file")
            raise ScenarioError(
                f"__main__ = {script}: processes import it as they start, and end; put what it "
                f"does into a function that is called below {_GUARD}"
            )
        if self._failed_starts > _MAX_FAILED_STARTS:
            raise ScenarioError(
                f"processes = {self._failed_starts} have ended as they started, the last with exit "
                f"code {code}: look for what kills them, such as a limit of memory"
            )

    def _keep(self) -> None:
        """Kills the workers but those that keep what is done, and waits for these."""
        end = time.monotonic() + _KEEPING_TIME
        with contextlib.suppress(Exception):  # the interrupt is what is raised
            self._hear(wait_for=0)  # what has come already
            while any(worker.is_keeping for worker in self._workers):
                with deferred_signals(most=sys.maxsize):
                    for worker in [w for w in self._workers if not w.is_keeping]:
                        self._workers.remove(worker)
                        worker.kill()
                if time.monotonic() > end:
                    return
                self._hear(wait_for=end - time.monotonic())

    def _dismiss(self, wait_for: float) -> None:
        """Lets workers without a call end by themselves within a time in s."""
        end = time.monotonic() + wait_for
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            if worker.process.pid is not None:
                worker.process.join(max(0.0, end - time.monotonic()))


def _ensure_forkserver() -> None:
    """Starts the process from which workers are forked, which Ctrl-C then does not reach."""
    resource_tracker.ensure_running()  # at its end it lets SIGINT through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stop_forkserver() -> None:
    """Kills the process from which workers are forked, which may still be importing.

    It keeps the standard error open, and has to tell of the workers' ends before this process can
    end.
    """
    server: Any = getattr(forkserver, "_forkserver", None)
    pid = getattr(server, "_forkserver_pid", None)
    if pid is not None and hasattr(server, "_stop"):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
            server._stop()


def _work(connection: Connection) -> None:
    """Answers calls until the parent closes the connection."""
    global _connection
    _connection = connection
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C is the parent's to handle
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    warnings.showwarning = show_warning
    gc.freeze()  # the collector need not look at what the imports made
    with contextlib.suppress(EOFError, OSError):
        connection.send(_READY)
        while True:
            answered = Answer.of(partial(_answer, connection, connection.recv_bytes()))
            connection.send((_ALL, answered))


def _answer(connection: Connection, call: bytes) -> None:
    """Sends the answers to calls as they are there."""
    function, arguments = pickle.loads(call)
    for number, result in function(arguments):
        connection.send((number, Answer.of(partial(pickle.dumps, result))))


def _exit_with_parent() -> None:
    """Ends this worker with its parent, also where that was killed."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        remove_unfinished()
        os._exit(1)
