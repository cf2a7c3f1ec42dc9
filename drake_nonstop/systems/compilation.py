"""Traced functions as C, compiled once and kept in the user's cache folder.

An entry is named after the C text, the compiler and its options, and the processor where it is
compiled for that. It is loaded only where it is this user's own, nobody else may write to it, and
its checksum is right; else it is built again. Without a compiler, or without a folder to write to,
CasADi's virtual machine evaluates instead, which is told in one line.
"""

import contextlib
import ctypes
import fcntl
import functools
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import casadi

from drake_nonstop.validation import warn_user

COMPILER = "CC"  # the variable of the environment that names another compiler
CACHE = "DRAKE_NONSTOP_CACHE"  # likewise, another folder
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


class CompilationError(RuntimeError):
    """Nothing was compiled; the message tells why, in a few words."""


_Loaded = TypeVar("_Loaded")


class Compiled(NamedTuple):
    """A function as compiled C, and what its C text has besides."""

    function: casadi.Function
    library: ctypes.CDLL


def compiled(
    function: casadi.Function, *, besides: str = "", builds: bool = True
) -> Compiled | None:
    """A function as compiled C; None: it cannot be, and is to be evaluated as it is.

    Both give the same numbers, to the bit. A ScenarioWarning tells why it cannot, once for each
    reason.

    Args:
        function: of SX expressions.
        besides: C text that follows that of the function, and may call it.
        builds: whether it is compiled where the cache does not have it.
    """
    load = functools.partial(_of_library, function.name())
    try:
        return _compiled(load, _c_text(function) + besides, _OPTIONS, builds)
    except CompilationError as error:
        _tell(str(error), "compiled loop", "CasADi's virtual machine evaluates it")
    return None


def compiled_for_processor(make_text: Callable[[], str], *, builds: bool) -> ctypes.CDLL | None:
    """A C text of flights side by side as a library for this processor; None: it cannot be had.

    `builds` as of `compiled`. A ScenarioWarning tells why it cannot be compiled, which may be a
    CompilationError of `make_text`.
    """
    try:
        return _compiled(_loaded, make_text(), [*_OF_PROCESSOR, _processor()], builds)
    except CompilationError as error:
        _tell(str(error), "flights side by side", "they are flown one by one")
    return None


@functools.cache
def compiled_text(text: str) -> ctypes.CDLL | None:
    """C text of plans as a library; None: it cannot be compiled, which a ScenarioWarning tells."""
    try:
        return _compiled(_loaded, text, [*_OF_PROCESSOR, _processor()], builds=True)
    except CompilationError as error:
        _tell(str(error), "plans", "Python makes them, ten times slower,")
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


def _compiled(
    load: Callable[[Path], _Loaded], text: str, options: list[str], builds: bool
) -> _Loaded | None:
    """What is loaded of a C text's library, from the cache or compiled now; None: it has none."""
    own_compiler = compiler()
    if own_compiler is None:
        asked = os.environ.get(COMPILER)
        wanted = f"{COMPILER} = {asked} is no program" if asked else "cc, gcc or clang"
        raise CompilationError(f"there is no C compiler ({wanted})")
    parts = (text, own_compiler, _version(own_compiler), *options, platform.machine())
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    folder = cache_folder()
    library = folder / f"{key}.so"
    found = _cached(load, library)
    if found is not None or not builds:
        return found
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with _locked(folder / f"{key}.lock"):
            found = _cached(load, library)
            if found is None:
                _build([own_compiler, *options], text, library)
                found = load(library)
    except OSError as error:
        reason = f"{folder} cannot be written ({error.strerror or error})"
        raise CompilationError(reason) from None
    return found


def _cached(load: Callable[[Path], _Loaded], library: Path) -> _Loaded | None:
    """What is loaded of a library of the cache; None: it is not sound, or of no use."""
    if not _is_sound(library):
        return None
    try:
        return load(library)
    except CompilationError:
        return None


def _c_text(function: casadi.Function) -> str:
    generator = casadi.CodeGenerator("loop", {"with_header": False})
    generator.add(function)
    text: str = generator.dump()
    return text


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
def _locked(path: Path) -> Iterator[None]:
    """Others that build the same wait; file systems without locks let both build."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
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


def _build(compiler_call: list[str], text: str, library: Path) -> None:
    """Compiles C to a library, which is put in its place when it is complete."""
    with tempfile.TemporaryDirectory(prefix=".new-", dir=library.parent) as scratch:
        source, made = Path(scratch) / "text.c", Path(scratch) / "text.so"
        source.write_text(text)
        call = [*compiler_call, str(source), "-o", str(made), "-lm"]
        try:
            done = _called(call, _TIME_LIMIT)
        except subprocess.TimeoutExpired:
            raise CompilationError(f"{call[0]} took more than {_TIME_LIMIT:g} s") from None
        if done.returncode != 0 or not made.is_file():
            lines = done.stderr.strip().splitlines() or ["it says nothing"]
            told = next((line for line in lines if "error" in line), lines[-1])
            raise CompilationError(f"{call[0]} failed ({told[:200]})")
        _loaded(made)  # or it would not be from the cache either
        made.chmod(0o600)
        checksum = Path(scratch) / "checksum"
        checksum.write_text(hashlib.sha256(made.read_bytes()).hexdigest())
        checksum.chmod(0o600)
        for path in (library, _checksum(library)):
            with contextlib.suppress(IsADirectoryError):
                path.unlink(missing_ok=True)
        os.replace(made, library)
        os.replace(checksum, _checksum(library))
