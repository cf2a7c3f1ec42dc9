"""Traced functions as C, compiled once and kept in the user's cache folder.

An entry is named after the function or the C text, the compiler and its options, and the processor
where it is compiled for that. It is loaded only where it is this user's own, nobody else may write
to it, and its checksum is right; else it is built again. Without a compiler, or without a folder to
write to, CasADi's virtual machine evaluates instead, which is told in one line.

What is not in the cache is compiled at once, or beside the calling process, by one that ends with
it, for those that ask later.
"""

import atexit
import contextlib
import ctypes
import fcntl
import functools
import hashlib
import inspect
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import casadi

from drake_nonstop.systems import lane_code
from drake_nonstop.systems.lane_code import (
    FAST_TO_COMPILE,
    CompilationError,
    with_rows_side_by_side,
)
from drake_nonstop.validation import warn_user

COMPILER = "CC"  # the variable of the environment that names another compiler
CACHE = "DRAKE_NONSTOP_CACHE"  # likewise, another folder
BESIDE = "DRAKE_NONSTOP_COMPILES_BESIDE"  # likewise: 0: nothing is compiled beside a process
_COMPILERS = "cc", "gcc", "clang"
_SHARED = [  # on Linux a library calls its own functions, and none of that name elsewhere
    *("-fPIC", "-shared", "-ffp-contract=off"),
    *(["-Wl,-Bsymbolic"] if sys.platform == "linux" else []),
]
_OPTIONS = ["-Og", *_SHARED]
_OF_PROCESSOR = ["-O2", "-march=native", "-fno-math-errno", "-fno-builtin-pow", *_SHARED]
_FEATURES = "vendor_id", "cpu family", "model", "stepping", "flags", "CPU part", "Features"
_TIME_LIMIT = 600.0  # s, of a compilation
_VERSION_TIME_LIMIT = 10.0  # s
_LEFT_TIME = 2 * _TIME_LIMIT  # s, after which nothing is at work in a folder
_NEW = ".new-"  # a folder, and files in it
_SAVED, _BESIDES, _CALL = "function.casadi", "besides.c", "call"
_WRITER = inspect.getsource(lane_code)  # which writes a part of the C, too
_NICE = 10  # of what compiles beside a process, which comes first
_BUILD_BESIDE = """
import sys
scratch, library, *sys.path[:] = sys.argv[1:]
from drake_nonstop.systems.compilation import build_beside
build_beside(scratch, library)
"""


_Loaded = TypeVar("_Loaded")


class Compiled(NamedTuple):
    """A function as compiled C, and what its C text has besides."""

    function: casadi.Function
    library: ctypes.CDLL


def compiled(
    function: casadi.Function, *, besides: str = "", own_digest: str = "", waits: bool = True
) -> Compiled | None:
    """A function as compiled C; None: it cannot be, or is not yet, and is to be evaluated as it is.

    Both give the same numbers, to the bit. What is not in the cache, is waited for, or compiled
    beside this process for later calls: one function at a time is, each once, unless another
    process compiles it.

    Args:
        function: of SX expressions, or of MX that calls such.
        besides: C text that follows that of the function, and may call it.
        own_digest: its `digest`; "": it is not known.
        waits: if so, a ScenarioWarning tells why it cannot be compiled, once for each reason.

    Raises:
        CompilationError: nothing can be compiled, and it does not wait.
    """
    load = functools.partial(_of_library, function.name())
    # What calls functions is long at work: it is worth the compiler's time.
    options = [*_OF_PROCESSOR, _processor()] if function.is_a("MXFunction") else _OPTIONS
    try:
        entry = _entry_of(own_digest or digest(function, besides), options)
        if waits:
            return _compiled(load, entry, lambda: c_text(function) + besides)
        found = _cached(load, entry.library)
        if found is None:
            _begin(function, besides, entry)
        return found
    except CompilationError as error:
        if not waits:
            raise
        tell_not_c(str(error))
    return None


def digest(function: casadi.Function, besides: str = "") -> str:
    """Text that differs for functions, and C text besides, that differ."""
    text = f"{casadi.__version__}\0{_WRITER}\0{function.serialize()}\0{besides}"
    return hashlib.sha256(text.encode()).hexdigest()


def compiled_for_processor(
    make_text: Callable[[], str],
    *,
    builds: bool,
    begins: bool = False,
    told: tuple[str, str] = ("flights side by side", "they are flown one by one"),
) -> ctypes.CDLL | None:
    """A C text as a library for this processor; None: it cannot be had.

    It `builds` where the cache does not have it, or `begins` to beside this process, for later
    calls. A ScenarioWarning tells why it cannot be compiled, which may be a CompilationError of
    `make_text`: what it is, and what is done instead, are `told` in it.
    """
    try:
        text = make_text()
        entry = _entry_of(text, [*_OF_PROCESSOR, _processor()])
        if builds:
            return _compiled(_loaded, entry, lambda: text)
        found = _cached(_loaded, entry.library)
        if found is None and begins:
            _begin(None, text, entry)
        return found
    except CompilationError as error:
        _tell(str(error), *told)
    return None


def compiler() -> str | None:
    """The path of the C compiler that is used; None: there is none."""
    names = [os.environ[COMPILER]] if os.environ.get(COMPILER) else _COMPILERS
    return next(filter(None, map(shutil.which, names)), None)


def cache_folder() -> Path:
    """Where compiled functions are kept: $DRAKE_NONSTOP_CACHE, or in the user's cache folder.

    Raises:
        CompilationError: the user has no home directory, as in some containers.
    """
    if os.environ.get(CACHE):
        return Path(os.environ[CACHE])
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        raise CompilationError(f"there is no home directory; set {CACHE} to a folder") from None
    return Path(base) / "drake_nonstop"


def tell_not_c(reason: str) -> None:
    """Warns of what is not compiled, once for each reason."""
    _tell(reason, "compiled loop", "CasADi's virtual machine evaluates it")


@functools.cache
def _tell(reason: str, what: str, remedy: str) -> None:
    warn_user(f"{what}: {reason}; {remedy} instead")


@functools.cache
def _processor() -> str:
    """A definition for C that tells processors apart, of which one may lack what another has."""
    told = f"{platform.processor()} {platform.node()}"
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
        told = "\n".join(line for line in lines if line.split("\t")[0].strip() in _FEATURES)
    return f'-DPROCESSOR="{hashlib.sha256(told.encode()).hexdigest()}"'


def _loaded(library: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise _not_loaded(library, error) from None


def _of_library(name: str, library: Path) -> Compiled:
    """The function of that name in a library."""
    try:
        function = casadi.external(name, str(library))  # which closes a library without it
    except RuntimeError as error:
        raise _not_loaded(library, error) from None
    return Compiled(function, _loaded(library))


def _not_loaded(library: Path, error: Exception) -> CompilationError:
    told = (str(error).strip().splitlines() or ["it says nothing"])[-1]
    return CompilationError(f"{library} cannot be loaded ({told[:200]})")


class _Entry(NamedTuple):
    """A place in the cache, and the call of the compiler that fills it."""

    library: Path
    call: list[str]


def _entry_of(content: str, options: list[str]) -> _Entry:
    """The entry of a C text, or of a function's digest.

    Raises:
        CompilationError: there is no compiler, or no folder.
    """
    own_compiler = compiler()
    if own_compiler is None:
        asked = os.environ.get(COMPILER)
        wanted = f"{COMPILER} = {asked} is no program" if asked else "cc, gcc or clang"
        raise CompilationError(f"there is no C compiler ({wanted})")
    parts = (content, own_compiler, _version(own_compiler), *options, platform.machine())
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return _Entry(cache_folder() / f"{key}.so", [own_compiler, *options])


def _compiled(
    load: Callable[[Path], _Loaded], entry: _Entry, make_text: Callable[[], str]
) -> _Loaded:
    """What is loaded of the library of a C text, from the cache or compiled now."""
    library = entry.library
    found = _cached(load, library)
    if found is None:
        with _written(library.parent), _locked(library.with_suffix(".lock")):
            found = _cached(load, library)
            if found is None:
                with tempfile.TemporaryDirectory(prefix=_NEW, dir=library.parent) as scratch:
                    _build(make_text(), entry, Path(scratch))
                found = load(library)
    return found


@contextlib.contextmanager
def _written(folder: Path) -> Iterator[None]:
    """Makes a folder, and removes from it what processes that were killed have left.

    Raises:
        CompilationError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        for scratch in folder.glob(f"{_NEW}*"):
            with contextlib.suppress(FileNotFoundError):  # another process removes it
                if time.time() - scratch.lstat().st_mtime > _LEFT_TIME:
                    shutil.rmtree(scratch, ignore_errors=True)
        yield
    except OSError as error:
        reason = f"{folder} cannot be written ({error.strerror or error})"
        raise CompilationError(reason) from None


_begun: set[Path] = set()  # that this process has had compiled
_builder: subprocess.Popen[bytes] | None = None  # the last process that does


def _begin(function: casadi.Function | None, besides: str, entry: _Entry) -> None:
    """Starts a process that compiles a function, or text, unless one is at work or has been."""
    global _builder
    is_busy = _builder is not None and _builder.poll() is None
    if os.environ.get(BESIDE) == "0" or is_busy or entry.library in _begun or not sys.executable:
        return
    _begun.add(entry.library)
    with _written(entry.library.parent):
        scratch = tempfile.mkdtemp(prefix=_NEW, dir=entry.library.parent)
        atexit.register(_end, Path(scratch))
        (Path(scratch) / _BESIDES).write_text(besides)
        (Path(scratch) / _CALL).write_text("\n".join(entry.call))
    if function is not None:
        function.save(f"{scratch}/{_SAVED}")
    given = [scratch, str(entry.library), *sys.path]
    _close_builder()
    _builder = subprocess.Popen(
        [sys.executable, "-c", _BUILD_BESIDE, *given],
        stdin=subprocess.PIPE,  # which ends with this process, however that ends
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": scratch},
        start_new_session=True,
    )


def _end(scratch: Path) -> None:
    """Ends the process that compiles, at the end of this one."""
    if _builder is not None and _builder.poll() is None:
        os.killpg(_builder.pid, signal.SIGKILL)
        _builder.wait()
        shutil.rmtree(scratch, ignore_errors=True)
    _close_builder()


def _close_builder() -> None:
    if _builder is not None and _builder.stdin is not None:
        _builder.stdin.close()


def build_beside(folder: str, library: str) -> None:
    """Compiles what is saved in a folder, which is removed then."""
    scratch = Path(folder)
    entry = _Entry(Path(library), (scratch / _CALL).read_text().splitlines())
    os.nice(_NICE)
    signal.signal(signal.SIGTERM, lambda *_: None)  # for the compiler, which has no such handler
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        with _locked(entry.library.with_suffix(".lock"), waits=False):
            if not _is_sound(entry.library):
                saved, text = scratch / _SAVED, (scratch / _BESIDES).read_text()
                if saved.is_file():
                    text = c_text(casadi.Function.load(str(saved))) + text
                _build(text, entry, scratch)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _end_with_parent() -> None:
    """Ends the compiler once the process that has started this one has ended."""
    os.read(0, 1)  # not by sys.stdin, which Python would wait for at its end
    while True:
        os.killpg(0, signal.SIGTERM)
        time.sleep(0.02)


def _cached(load: Callable[[Path], _Loaded], library: Path) -> _Loaded | None:
    """What is loaded of a library of the cache; None: it is not sound, or of no use."""
    if not _is_sound(library):
        return None
    try:
        return load(library)
    except CompilationError:
        return None


def c_text(function: casadi.Function) -> str:
    """A function's C text, in which what is the same in two places is computed once.

    One of MX has those that it calls as they are.
    """
    generator = casadi.CodeGenerator("loop", {"with_header": False})
    if function.is_a("MXFunction"):
        generator.add(function)
        return with_rows_side_by_side(f"{FAST_TO_COMPILE}\n{generator.dump()}", function)
    argument = casadi.SX.sym("x", function.size1_in(0))
    results = casadi.cse(function.call([argument]))
    generator.add(casadi.Function(function.name(), [argument], results))
    return with_rows_side_by_side(generator.dump(), function)


def _version(path: str) -> str:
    said, reason = _answer(path)
    if reason:
        raise CompilationError(f"{path} {reason}")
    return said


@functools.cache
def _answer(path: str) -> tuple[str, str]:
    """Version as a compiler says it, and why it says nothing."""
    try:
        return _called([path, "--version"], _VERSION_TIME_LIMIT).stdout, ""
    except OSError as error:
        return "", f"cannot be run ({error.strerror})"
    except subprocess.TimeoutExpired:
        return "", f"does not tell its version within {_VERSION_TIME_LIMIT:g} s"


def _called(call: list[str], time_limit: float) -> subprocess.CompletedProcess[str]:
    """A program's end; what it prints may be no UTF-8."""
    return subprocess.run(
        call,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        timeout=time_limit,
    )


@contextlib.contextmanager
def _locked(path: Path, *, waits: bool = True) -> Iterator[None]:
    """Others that build the same wait, or raise; file systems without locks let both build."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
        except BlockingIOError:
            raise
        except OSError:
            pass
        yield
    finally:
        os.close(descriptor)


def _checksum(library: Path) -> Path:
    return library.with_suffix(".sha256")


def _is_sound(library: Path) -> bool:
    """Whether a library is this user's own, and as it was built."""
    try:
        for path in (library, _checksum(library)):
            status = path.lstat()
            is_own = stat.S_ISREG(status.st_mode) and status.st_uid == os.getuid()
            if not is_own or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return False
        return _checksum(library).read_text() == hashlib.sha256(library.read_bytes()).hexdigest()
    except (OSError, ValueError):
        return False


def _build(text: str, entry: _Entry, scratch: Path) -> None:
    """Compiles C in a folder of its own, and puts the library in its place when it is complete."""
    library, call = entry
    source, made, checksum = (scratch / name for name in ("text.c", "text.so", "checksum"))
    source.write_text(text)
    try:
        done = _called([*call, str(source), "-o", str(made), "-lm"], _TIME_LIMIT)
    except subprocess.TimeoutExpired:
        raise CompilationError(f"{call[0]} took more than {_TIME_LIMIT:g} s") from None
    if done.returncode != 0 or not made.is_file():
        lines = done.stderr.strip().splitlines() or ["it says nothing"]
        told = next((line for line in lines if "error" in line), lines[-1])
        raise CompilationError(f"{call[0]} failed ({told[:200]})")
    _loaded(made)  # or it would not be from the cache either
    made.chmod(0o600)
    checksum.write_text(hashlib.sha256(made.read_bytes()).hexdigest())
    checksum.chmod(0o600)
    for path in (library, _checksum(library)):
        with contextlib.suppress(IsADirectoryError):
            path.unlink(missing_ok=True)
    os.replace(made, library)
    os.replace(checksum, _checksum(library))
