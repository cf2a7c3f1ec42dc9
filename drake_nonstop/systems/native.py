"""Functions of a sample as C, compiled once and kept in a cache folder; also for flights in lanes.

CasADi's C text is one for any type that has arithmetic. For lanes it is compiled as C++ with a
vector of GCC's and Clang's in the place of a number: a lane for each of 8, 4 or 2 flights, with
the bits of a flight by itself, since no operation is contracted or done in another order.
"""

import _ctypes
import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.validation import warn_user

COMPILER = "CC"  # the environment variable that names another compiler
CACHE = "DRAKE_NONSTOP_CACHE"  # the one that names another cache folder
_COMPILERS = "cc", "gcc", "clang"
_TIME_LIMIT = 120.0  # s, of a compilation
_VERSION_TIME_LIMIT = 10.0  # s, in which a compiler tells its version
_GLANCE = 0.1  # s, between calls of a check while a compiler runs
_LARGEST_CACHE = 200e6  # bytes
_SCRATCH = ".new-"  # begins the name of the folder of a compilation
_OPTIONS = ["-O2", "-march=native", "-fPIC", "-shared", "-fvisibility=hidden", "-w"]
_OPTIONS += ["-ffp-contract=off", "-fno-math-errno"]
# Of one flight; the vectorizer fuses products with sums, which rounds otherwise.
_OPTIONS_OF_ONE = [*_OPTIONS, "-fno-tree-slp-vectorize"]
_OPTIONS_OF_LANES = ["-xc++", "-nostdinc++", "-fno-exceptions", "-Dcasadi_real=lanes"]
_OPTIONS_OF_LANES += ["-D__STDC_VERSION__=199901L"]  # CasADi's text then calls fmin, log1p ...
_FEATURES = "vendor_id", "cpu family", "model", "stepping", "flags", "CPU part", "Features"


@functools.cache
def _processor() -> str:
    """Text that tells processors apart, of which one may lack what another has."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
        return "\n".join(line for line in lines if line.split("\t")[0].strip() in _FEATURES)
    return f"{platform.processor()} {platform.node()}"


# Numbers in a vector of AVX-512, of AVX or of others: longer ones would be kept in memory.
LANES = 8 if "avx512f" in _processor() else 4 if " avx " in _processor() else 2
_FLY = """
#define CHECK(values, size) for (i = 0; i < size; i++) good &= BELOW((values)[i], largest)
#define EXPORT __attribute__((visibility("default")))
#pragma GCC optimize("O3") /* so that checks are made side by side */
#ifndef LANES
#define BELOW(v, limit) (fabs(v) < limit)
/* Flies samples; x becomes the state after those that are finite, which are counted. */
EXPORT casadi_int fly(casadi_int samples, const casadi_int *sizes, double largest,
    const double *times, double *x, const double *p, const double *rows, double *shown,
    double *steps, const double **arg, double **res, casadi_int *iw, double *w, double *after) {
  for (casadi_int i, k = 0, good = 1; k < samples; k++) {
    arg[0] = x; arg[1] = times + k; arg[2] = p; arg[3] = rows;
    res[0] = after; res[1] = shown; res[2] = steps;
    if (loop(arg, res, iw, w, 0)) return k;
    CHECK(times + k, 2); CHECK(after, sizes[0]); CHECK(shown, sizes[1]); CHECK(steps, sizes[2]);
    if (!good) return k;
    memcpy(x, after, sizes[0] * sizeof(double));
    shown += sizes[1]; steps += sizes[2]; rows += sizes[3];
  }
  return samples;
}
#else
#define LOAD(to, from, size, place) for (l = 0; l < LANES; l++) { \\
    const double *own = (from)[l] + (place) * (size); \\
    for (i = 0; i < size; i++) (to)[i].v[l] = own[i]; }
#define STORE(to, from, size) for (i = 0; i < size; i += LANES) for (l = 0; l < LANES; l++) \\
  if (good[l]) { \\
    double *own = (to)[l] + k * (size) + i; \\
    if (i + LANES <= size) for (casadi_int j = 0; j < LANES; j++) own[j] = (from)[i + j].v[l]; \\
    else for (casadi_int j = 0; i + j < size; j++) own[j] = (from)[i + j].v[l]; }
/* The same for a flight in each lane, of which each has its own number of samples and arrays. */
EXPORT void fly(const casadi_int *samples, const casadi_int *sizes, double largest,
    const double *const *times, double *const *x, const double *const *p,
    const double *const *rows, double *const *shown, double *const *steps, casadi_int *counts,
    const lanes **arg, lanes **res, casadi_int *iw, lanes *w, lanes *memory) {
  lanes *state = memory, *after = state + sizes[0], *show = after + sizes[0],
        *step = show + sizes[1], *row = step + sizes[2], *parameters = row + sizes[3], t[2];
  casadi_int i, k, l, most = 0;
  for (l = 0; l < LANES; l++) if (samples[l] > most) most = samples[l];
  LOAD(state, x, sizes[0], 0);
  LOAD(parameters, p, sizes[4], 0);
  mask good, ended = {};
  for (k = 0; k < most; k++) {
    for (l = 0; l < LANES; l++) good[l] = -(k < samples[l] && !ended[l]);
    LOAD(t, times, 1, k < samples[l] ? k : 0);
    for (l = 0; l < LANES; l++) t[1].v[l] = times[l][k < samples[l] ? k + 1 : 0];
    LOAD(row, rows, sizes[3], k < samples[l] ? k : 0);
    arg[0] = state; arg[1] = t; arg[2] = parameters; arg[3] = row;
    res[0] = after; res[1] = show; res[2] = step;
    mask flown = good;
    if (loop(arg, res, iw, w, 0)) break;
    CHECK(t, 2); CHECK(after, sizes[0]); CHECK(show, sizes[1]); CHECK(step, sizes[2]);
    ended |= flown & ~good;
    if (!is_any(good)) { if (is_any(flown & ~good)) continue; break; }
    for (i = 0; i < sizes[0]; i++) state[i] = CHOSEN(good, after[i], state[i]);
    STORE(shown, show, sizes[1]);
    STORE(steps, step, sizes[2]);
    for (l = 0; l < LANES; l++) counts[l] -= good[l];
  }
  for (l = 0; l < LANES; l++) if (samples[l] > 0)
    for (i = 0; i < sizes[0]; i++) x[l][i] = state[i].v[l];
}
#endif
"""
_LANES = """
#include <math.h>
typedef double vector __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long mask __attribute__((vector_size(8 * LANES), aligned(8)));
struct lanes {
  vector v;
  lanes() = default;
  constexpr lanes(double c) : v{EACH(c)} {}
  constexpr lanes(vector v) : v(v) {}
};
#define BELOW(a, limit) (mask)(fabs(a).v < lanes(limit).v)
static inline long long is_any(mask m)
  { long long found = 0; for (int k = 0; k < LANES; k++) found |= m[k]; return found; }
#define CHOSEN(m, a, b) lanes((vector)(((m) & (mask)(a).v) | (~(m) & (mask)(b).v)))
#define OF(type, f, ...) static inline type f(__VA_ARGS__)
#define OPERATOR(o) OF(lanes, operator o, lanes a, lanes b) { return a.v o b.v; } \\
  OF(lanes &, operator o##=, lanes &a, lanes b) { return a = a o b; }
#define COMPARISON(o) OF(lanes, operator o, lanes a, lanes b) \\
  { return (vector)((mask)(a.v o b.v) & (mask)lanes(1.0).v); }
#define FUNCTION(f) OF(lanes, f, lanes a) { return vector{EACH(f(a.v[K]))}; }
#define FUNCTION2(f) OF(lanes, f, lanes a, lanes b) { return vector{EACH(f(a.v[K], b.v[K]))}; }
OPERATOR(+) OPERATOR(-) OPERATOR(*) OPERATOR(/)
COMPARISON(<) COMPARISON(<=) COMPARISON(>) COMPARISON(==) COMPARISON(!=)
FUNCTION(sin) FUNCTION(cos) FUNCTION(tan) FUNCTION(asin) FUNCTION(acos) FUNCTION(atan)
FUNCTION(sinh) FUNCTION(cosh) FUNCTION(tanh) FUNCTION(asinh) FUNCTION(acosh) FUNCTION(atanh)
FUNCTION(exp) FUNCTION(log) FUNCTION(expm1) FUNCTION(log1p) FUNCTION(erf)
FUNCTION(sqrt) FUNCTION(floor) FUNCTION(ceil)
FUNCTION2(atan2) FUNCTION2(pow) FUNCTION2(fmod) FUNCTION2(remainder) FUNCTION2(hypot)
FUNCTION2(copysign)
OF(lanes, operator -, lanes a) { return -a.v; }
OF(lanes, operator !, lanes a) { return a == lanes(0.0); }
OF(lanes, if_else, lanes c, lanes a, lanes b) { return CHOSEN((mask)(c.v != lanes(0.0).v), a, b); }
OF(lanes, operator &&, lanes a, lanes b) { return if_else(a, b != lanes(0.0), 0.0); }
OF(lanes, operator ||, lanes a, lanes b) { return if_else(a, 1.0, b != lanes(0.0)); }
OF(lanes, fabs, lanes a) { return (vector)((mask)a.v & ~(mask)lanes(-0.0).v); }
/* One that is no number gives the other; of zeros, it is the first. */
OF(lanes, fmin, lanes a, lanes b) { return CHOSEN((mask)(b.v < a.v | a.v != a.v), b, a); }
OF(lanes, fmax, lanes a, lanes b) { return CHOSEN((mask)(b.v > a.v | a.v != a.v), b, a); }
"""
_TERNARIES = {  # which C++ has for a single number alone
    r"\(([\w\[\]]+)\?([\w\[\]]+):0\)": r"if_else(\1,\2,0.0)",
    r"c!=0 \? x : y": "if_else(c,x,y)",
    r"x<0 \? -1 : x>0 \? 1 : x": "if_else(x<0,-1.0,if_else(x>0,1.0,x))",
}


_meanwhile: ContextVar[Callable[[], None]] = ContextVar("meanwhile", default=lambda: None)


@contextlib.contextmanager
def asking(check: Callable[[], None]) -> Iterator[None]:
    """Within it `check` is called while a compiler runs, which ends if it raises.

    So does a Ctrl-C that a handler has only noted.
    """
    before = _meanwhile.set(check)
    try:
        yield
    finally:
        _meanwhile.reset(before)


class CompilationError(RuntimeError):
    """A function cannot be compiled; the message tells why, in a few words."""


class Native:
    """A function `loop(x, t, p, rows) -> (x_next, shown, steps)` of a sample as compiled C.

    Several threads may fly at once, and others run meanwhile.

    Args:
        library: in which `fly` is; None: there is none.
        function: of CasADi, dense; t (2,) are the times, s, of the sample and the next one.
        lanes: 1, or `LANES`.

    Raises:
        ValueError: the function has other arguments or results.
    """

    def __init__(self, library: ctypes.CDLL | None, function: casadi.Function, lanes: int = 1):
        sizes = [function.numel_in(k) for k in range(function.n_in())]
        sizes += [function.numel_out(k) for k in range(function.n_out())]
        is_fit = len(sizes) == 7 and sizes[1] == 2 and sizes[0] == sizes[4]
        if not is_fit or function.nnz_in() + function.nnz_out() != sum(sizes):
            raise ValueError(f"{function}: give dense (x, t[2], p, rows) -> (x, shown, steps)")
        self._x, _, self._p, self._row, _, self._shown, self._steps = sizes
        self.lanes, self._function, self._library = lanes, function, library
        self._threads = threading.local()

    def fly(
        self,
        times: NDArray,
        x: NDArray,
        p: NDArray,
        rows: NDArray,
        shown: NDArray,
        steps: NDArray,
        largest: float,
    ) -> int:
        """Flies samples, and returns how many there are before one that is not finite.

        All arrays are contiguous; what is written for later samples has no meaning.

        Args:
            times: (samples + 1,), s; the flight ends before one that is NaN.
            x: (k,), the state, which becomes that after the samples that are counted.
            p: (p,), parameters.
            rows: (samples, r), what is known beforehand of each sample.
            shown: (samples, s), signals, which are written.
            steps: (samples, q), signals of steps, likewise.
            largest: SI units, which results and times are below.

        Raises:
            ValueError: an array has another shape or type, or is not contiguous.
        """
        arrays = times, x, p, rows, shown, steps
        samples = self._samples_of(arrays)
        return int(self._evaluate(samples, *arrays, largest))

    def fly_lanes(self, flights: Sequence[Sequence[NDArray]], largest: float) -> list[int]:
        """`fly` for a flight in each lane, as many as `lanes` or fewer; returns their counts.

        Each has arrays of its own, and its own number of samples.
        """
        samples = [*map(self._samples_of, flights)]
        return self._evaluate(samples, flights, largest)

    def _samples_of(self, arrays: Sequence[NDArray]) -> int:
        """The number of samples in the arrays of a flight, which are checked."""
        samples = len(arrays[0]) - 1
        widths = self._row, self._shown, self._steps
        shapes = (samples + 1,), (self._x,), (self._p,), *((samples, width) for width in widths)
        for array, shape in zip(arrays, shapes, strict=True):
            is_fit = samples >= 0 and array.shape == shape and array.flags.c_contiguous
            if not is_fit or array.dtype != np.float64:
                raise ValueError(f"an array is {array.dtype} {array.shape}: give {shape}")
        return samples

    @property
    def _evaluate(self) -> Callable[..., Any]:
        """What evaluates samples in memory of the thread's own."""
        try:
            return self._threads.evaluate
        except AttributeError:
            self._threads.evaluate = self._evaluator() if self.lanes == 1 else self._of_lanes()
            return self._threads.evaluate

    def _call(self, memory: int) -> tuple[Any, list[Any]]:
        """`fly` of the library, and its work memory, with as many numbers besides."""
        f, lanes = self._function, self.lanes
        sizes = f.sz_arg(), f.sz_res(), f.sz_iw(), f.sz_w() * lanes, memory * lanes
        call: Any = self._library.fly  # type: ignore[union-attr]
        call.restype = ctypes.c_longlong
        return call, [np.zeros(n + 1).ctypes.data_as(ctypes.c_void_p) for n in sizes]

    @property
    def _layout(self) -> Any:
        sizes = self._x, self._shown, self._steps, self._row, self._p
        return np.array(sizes).ctypes.data_as(ctypes.c_void_p)  # which keeps it alive

    def _evaluator(self) -> Callable[..., int]:
        sizes, (call, work) = self._layout, self._call(self._x)
        call.argtypes = [ctypes.c_longlong, ctypes.c_void_p, ctypes.c_double]
        call.argtypes += [ctypes.c_void_p] * 11

        def evaluate(samples: int, *arrays_and_largest: Any) -> int:
            *arrays, largest = arrays_and_largest
            return call(samples, sizes, largest, *(a.ctypes.data for a in arrays), *work)

        return evaluate

    def _of_lanes(self) -> Callable[..., list[int]]:
        memory = 2 * self._x + self._shown + self._steps + self._row + self._p
        sizes, (call, work) = self._layout, self._call(memory)
        call.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double]
        call.argtypes += [ctypes.c_void_p] * 12

        def evaluate(
            samples: list[int], flights: Sequence[Sequence[NDArray]], largest: float
        ) -> list[int]:
            idle = self.lanes - len(flights)  # lanes, which have a flight's numbers
            own = np.array([*samples, *[0] * idle])
            pointers = np.array(
                [[a.ctypes.data for a in arrays] for arrays in [*flights, *[flights[0]] * idle]]
            ).T.copy()
            counts = np.zeros(self.lanes, np.int64)
            addresses = [array.ctypes.data for array in (*pointers, counts)]
            call(own.ctypes.data, sizes, largest, *addresses, *work)
            return counts[: len(flights)].tolist()

        return evaluate


class Interpreted(Native):
    """`Native` of one flight, by CasADi's virtual machine: the same numbers, more slowly.

    Args:
        function: as of `Native`.
    """

    def __init__(self, function: casadi.Function):
        super().__init__(None, function)

    def _evaluator(self) -> Callable[..., int]:
        buffer, evaluate_once = self._function.buffer()
        self._threads.buffer = buffer  # which has to live as long
        given = [np.zeros(size) for size in (self._x, 2, self._p, self._row)]
        ends = np.cumsum([self._x, self._shown])
        made = np.zeros(ends[-1] + self._steps)
        results = np.split(made, ends)
        for k, array in enumerate(given):
            buffer.set_arg(k, array.data)
        for k, array in enumerate(results):
            buffer.set_res(k, array.data)
        (state, t, parameters, row), (after, signals, of_steps) = given, results

        def evaluate(samples: int, *arrays_and_largest: Any) -> int:
            times, x, p, rows, shown, steps, largest = arrays_and_largest
            state[:], parameters[:] = x, p
            are_times = np.append(np.abs(times) < largest, False)
            samples = min(samples, max(0, int(np.argmin(are_times)) - 1))
            k = 0
            for k in range(samples):
                t[:], row[:] = times[k : k + 2], rows[k]
                evaluate_once()
                if not np.abs(made).max(initial=0.0) < largest:
                    break
                state[:], shown[k], steps[k] = after, signals, of_steps
            else:
                k = samples
            x[:] = state
            return k

        return evaluate


def native(function: casadi.Function, *, lanes: int = 1, builds: bool = True) -> Native | None:
    """A function as C, from the cache, or compiled now; None: it is not.

    A ScenarioWarning tells why it cannot be compiled, once for each reason.

    Args:
        function: as of `Native`, of SX or MX; it may call others.
        lanes: 1, or `LANES`.
        builds: whether it is compiled where the cache does not have it.
    """
    if lanes not in (1, LANES):
        raise ValueError(f"lanes = {lanes}: give 1 or {LANES}")
    made = Native(None, function, lanes)
    try:
        made._library = _library(*_text_and_options(function, lanes), builds)
    except CompilationError as error:
        remedy = "flights go one by one" if lanes > 1 else "CasADi's virtual machine evaluates it"
        if builds:
            _tell(f"compiled loop: {error}; {remedy} instead")
    return None if made._library is None else made


def cache_folder() -> Path:
    """Where compiled functions are kept: $DRAKE_NONSTOP_CACHE, or in the user's cache folder.

    Raises:
        OSError: the user has no home directory, as in some containers.
    """
    if os.environ.get(CACHE):
        return Path(os.environ[CACHE])
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        raise OSError(0, "there is no home directory") from None
    return Path(base) / "drake_nonstop"


def compiler() -> str | None:
    """The path of the C compiler that is used; None: there is none."""
    names = [os.environ[COMPILER]] if os.environ.get(COMPILER) else _COMPILERS
    return next(filter(None, map(shutil.which, names)), None)


_tell = functools.cache(warn_user)
_failures: dict[str, str] = {}  # why functions could not be compiled in this process, by their keys


def _text_and_options(function: casadi.Function, lanes: int) -> tuple[str, list[str]]:
    """A function's C text with `fly`, and the options by which it is compiled."""
    generator = casadi.CodeGenerator("loop", {"with_header": False})
    generator.add(function)
    text: str = generator.dump()
    text += f"\n#define loop {function.name()}\n{_FLY}"
    return (text, _OPTIONS_OF_ONE) if lanes == 1 else _in_lanes(text, lanes)


def _in_lanes(text: str, lanes: int) -> tuple[str, list[str]]:
    """A C text in which `casadi_real` is a vector of numbers, and its options."""
    for ternary, call in _TERNARIES.items():
        text = re.sub(ternary, call, text)
    begin = re.sub(
        r"EACH\((.*)\)\}",
        lambda found: ", ".join(found[1].replace("K", str(k)) for k in range(lanes)) + "}",
        f"#define LANES {lanes}\n{_LANES}",
    )
    return f'{begin}extern "C" {{{text}}}', [*_OPTIONS, *_OPTIONS_OF_LANES]


def shared_library(text: str, symbol: str, *, lanes: int = 1) -> ctypes.CDLL:
    """A C text as a library with a function of that name, from the cache, or compiled now.

    The text makes that function visible. In `LANES` lanes its `casadi_real` is a vector.

    Raises:
        CompilationError: it cannot be compiled.
    """
    own = (text, _OPTIONS_OF_ONE) if lanes == 1 else _in_lanes(text, lanes)
    library = _library(*own, True, symbol)
    assert library is not None  # since it builds
    return library


def _library(
    text: str, options: list[str], builds: bool, symbol: str = "fly"
) -> ctypes.CDLL | None:
    """A C text as a library of the cache folder; None: it would have to be built."""
    program = compiler()
    if program is None:
        named = os.environ.get(COMPILER)
        wanted = f"{COMPILER} = {named} is no program" if named else "cc, gcc or clang"
        raise CompilationError(f"there is no C compiler ({wanted})")
    call = [program, *options]
    version, reason = _version(program)
    if reason:
        raise CompilationError(reason)
    parts = text, version, *call, platform.machine(), _processor()
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    try:
        path = cache_folder() / f"{key}.so"
        library = _cached(path, symbol)
        if library is not None or not builds:
            return library
        if key in _failures:  # which may have taken long
            raise CompilationError(_failures[key])
        return _built(path, text, call, symbol)
    except OSError as error:
        reason = f"{error.filename or 'the cache'} cannot be used ({error.strerror or error})"
        raise CompilationError(f"{reason}; set {CACHE} to a folder") from None


def _cached(path: Path, symbol: str) -> ctypes.CDLL | None:
    """The library of a path, if it can be loaded."""
    library = _loaded(path, symbol) if path.is_file() else None
    if library is not None:
        with contextlib.suppress(OSError):  # as of a folder that can be read only
            os.utime(path)
    return library


def _loaded(path: Path, symbol: str) -> ctypes.CDLL | None:
    """A library with a function of that name; None: it is none."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError:
        return None
    if hasattr(library, symbol):
        return library
    _ctypes.dlclose(library._handle)
    return None


def _built(path: Path, text: str, call: list[str], symbol: str) -> ctypes.CDLL:
    """A library that is compiled now, in a folder of its own, and moved to its path at the end."""
    folder = path.parent
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(prefix=_SCRATCH, dir=folder) as scratch:
        source, made = Path(scratch) / "loop.c", Path(scratch) / "loop.so"
        source.write_text(text)
        _, reason = _run([*call, str(source), "-o", str(made), "-lm"], _TIME_LIMIT, scratch)
        library = None if reason else _loaded(made, symbol)
        if library is None:
            _failures[path.stem] = reason or f"{call[0]} has made nothing that can be loaded"
            raise CompilationError(_failures[path.stem])
        made.chmod(0o600)
        made.replace(path)
    _prune(folder)
    return library


def _run(call: list[str], time_limit: float, scratch: str | None = None) -> tuple[str, str]:
    """What a program prints, in a process group that ends with this call, and why it fails, or "".

    Its own files are made in the folder `scratch`; the time limit is in s.
    """
    environment = {**os.environ, "TMPDIR": scratch} if scratch else None
    with tempfile.TemporaryFile(dir=scratch) as output:
        try:
            process = subprocess.Popen(
                call,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            return "", f"{call[0]} cannot be run ({error.strerror})"
        try:
            if not _ends(process, time_limit):
                return "", f"{call[0]} took more than {time_limit:g} s"
        finally:  # at a KeyboardInterrupt, too
            with contextlib.suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        output.seek(0)
        printed = output.read().decode(errors="replace")
    if process.returncode == 0:
        return printed, ""
    lines = printed.strip().splitlines() or ["it says nothing"]
    line = next((line for line in lines if "error" in line), lines[-1])
    return "", f"{call[0]} failed ({line[:200]})"


def _ends(process: subprocess.Popen, time_limit: float) -> bool:
    """Whether a process ends in time, s; the check of `asking` may raise."""
    ask, end = _meanwhile.get(), time.monotonic() + time_limit
    while time.monotonic() < end:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_GLANCE)
            return True
        ask()
    return False


def _prune(folder: Path) -> None:
    """Removes entries not used for longest, and what killed processes have left."""
    entries = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process removes it
            status = path.lstat()
            if re.fullmatch(r"[0-9a-f]{64}\.so", path.name):
                entries.append((status.st_mtime, status.st_size, path))
            elif path.name.startswith(_SCRATCH) and time.time() - status.st_mtime > 2 * _TIME_LIMIT:
                shutil.rmtree(path, ignore_errors=True)
    size = 0
    for _, of_entry, path in sorted(entries, reverse=True):
        size += of_entry
        if size > _LARGEST_CACHE:
            with contextlib.suppress(OSError):
                path.unlink()


@functools.cache
def _version(program: str) -> tuple[str, str]:
    """What a compiler prints as its version, and why it does not."""
    return _run([program, "--version"], _VERSION_TIME_LIMIT)
