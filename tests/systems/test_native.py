"""Functions as C: the virtual machine's numbers, in lanes as well, from a cache that is sound."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import casadi
import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop.systems import native as module
from drake_nonstop.systems.native import LANES, Interpreted, asking, compiler, native
from drake_nonstop.validation import ScenarioWarning

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
VERSION = "[ $1 = --version ] && exit 0"
LARGEST = 1e3
BINARY = [
    *("ADD", "SUB", "MUL", "DIV", "LT", "LE", "EQ", "NE", "AND", "OR", "IF_ELSE_ZERO"),
    *("ATAN2", "POW", "CONSTPOW", "FMIN", "FMAX", "FMOD", "REMAINDER", "HYPOT", "COPYSIGN"),
]
UNARY = [
    *("NEG", "SQ", "TWICE", "INV", "FABS", "NOT", "SIGN", "SQRT", "SIN", "COS", "TAN", "ASIN"),
    *("ACOS", "ATAN", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "EXP", "LOG", "EXPM1"),
    *("LOG1P", "ERF", "FLOOR", "CEIL"),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache folder of its own, and warnings that have not been told yet."""
    monkeypatch.setenv("DRAKE_NONSTOP_CACHE", str(tmp_path / "cache"))
    module._tell.cache_clear()
    return tmp_path / "cache"


@pytest.fixture
def use_compiler(tmp_path, monkeypatch):
    """A function that makes a shell script the compiler; None: there is none."""

    def use(script):
        path = tmp_path / "compiler"
        if script is not None:
            path.write_text(f"#!/bin/sh\n{script}\n")
            path.chmod(0o755)
        monkeypatch.setenv("CC", str(path))
        module._version.cache_clear()

    return use


def function(factor=2.0, sizes=(2, 1, 1), make=None, kind=casadi.SX):
    """x grows by the row times a factor; the times and what `make` returns are shown."""
    x, p, row = (kind.sym(name, size) for name, size in zip("xpr", sizes, strict=True))
    t = kind.sym("t", 2)
    shown = casadi.vertcat(t, *(make(x, t, p, row) if make else []))
    after = x + factor * casadi.vertcat(*[casadi.sum1(row)] * sizes[0])
    return casadi.Function("sample", [x, t, p, row], [after, shown, casadi.vertcat(x, x)])


def arrays(function, samples, lanes=(), seed=1):
    """Times, x, p and rows, and room for what is shown and for steps."""
    generator = np.random.default_rng(seed)
    x, p, row = (generator.normal(size=(function.numel_in(k), *lanes)) for k in (0, 2, 3))
    rows = generator.normal(size=(samples, *row.shape))
    times = np.cumsum(generator.uniform(0.1, 1.0, (samples + 1, *lanes)), axis=0)
    room = [np.zeros((samples, function.numel_out(k), *lanes)) for k in (1, 2)]
    return [times, x, p, rows, *room]


def lane(values, k):
    return [np.ascontiguousarray(array[..., k]) for array in values]


def assert_same_bits(values, expected):
    for one, other in zip(values, expected, strict=True):
        both = np.isnan(one) & np.isnan(other)
        assert ((one.view(np.int64) == other.view(np.int64)) | both).all()


def library(folder):
    (path,) = folder.glob("*.so")
    return path


def all_operations(x, t, p, row):
    unary = [casadi.SX.unary(getattr(casadi, f"OP_{name}"), v) for name in UNARY for v in (x, p)]
    pairs = [(x[0], row), (p, x[1]), (x[0], x[0])]
    codes = [getattr(casadi, f"OP_{name}") for name in BINARY]
    binary = [casadi.SX.binary(code, *pair) for code in codes for pair in pairs]
    powers = [x**3, x**2.5, x**-1, 2.0**x, x**0.5, x**p, -0.0 * x, casadi.inf * x, x * 1e-310]
    values = casadi.vertcat(*unary, *binary, *powers)
    is_number = casadi.fabs(values) < 100  # to be shown, and not to end the flight
    return [casadi.if_else(is_number, values, -7.0), casadi.if_else(values != values, 5.0, values)]


def few(x, t, p, row):
    """A few operations, which compile at once."""
    return [casadi.sin(x) * p, casadi.if_else(x > p, x, row), casadi.exp(-(x**2))]


def calls(x, t, p, row):
    """A function for each column, called from MX, and operations of MX on vectors."""
    own = casadi.SX.sym("own", 2)
    results = [casadi.sin(own[0]) * own[1], casadi.if_else(own[0] > 0, own[1], casadi.sign(own[0]))]
    each = casadi.Function("each", [own], [casadi.vertcat(*results)]).map(3)
    columns = casadi.horzcat(x, x[[1, 0]], -x)
    a = casadi.reshape(casadi.vertcat(x, x), 2, 2)
    made = [casadi.vec(each(columns)), casadi.if_else(p > 0, x, 2 * x), casadi.logic_not(x)]
    made += [casadi.logic_and(x, x), casadi.logic_or(x, p), casadi.fmin(x, p), casadi.fmax(x, 0.1)]
    made += [casadi.dot(x, x), casadi.norm_2(x), a @ x, casadi.mmax(x)]
    made += [casadi.sum1(x), casadi.fmod(x, 0.3), casadi.sign(x), x**3, x**2]
    return [*made, casadi.mmin(x), casadi.bilin(a, x, x), casadi.floor(x), casadi.atan2(x, p)]


CASES = [(all_operations, casadi.SX), (calls, casadi.MX)]


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(("make", "kind"), CASES)
def test_all_operations_give_the_bits_of_the_virtual_machine_in_lanes_too(make, kind):
    f = function(0.1, make=make, kind=kind)
    if make is all_operations:
        codes = {f.instruction_id(k) for k in range(f.n_instructions())}
        needed = {getattr(casadi, f"OP_{name}") for name in UNARY} - {casadi.OP_TWICE}
        assert needed <= codes  # CasADi 3.6 adds a number to itself
    wide, one, interpreted = native(f, lanes=LANES), native(f), Interpreted(f)
    in_lanes = arrays(f, 5, (LANES,))
    special = np.array([[0.0, -0.0, 1.0, -0.7], [0.0, 0.5, 1.0, 0.7]])
    in_lanes[1][:, :4] = special[:, :LANES]
    in_lanes[2][:, :3] = [0.0, 1.0, -0.0][:LANES]
    begin = [array.copy() for array in in_lanes]
    flights = [lane(in_lanes, k) for k in range(LANES)]
    counts = wide.fly_lanes(flights, np.inf)
    for k in range(LANES):
        alone, expected = lane(begin, k), lane(begin, k)
        assert interpreted.fly(*expected, np.inf) == one.fly(*alone, np.inf) == counts[k]
        count = counts[k]
        shown = [[a[:count] for a in values[4:]] for values in (alone, expected, flights[k])]
        assert_same_bits([alone[1], *shown[0]], [expected[1], *shown[1]])
        assert_same_bits([flights[k][1], *shown[2]], [expected[1], *shown[1]])


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    "place", nightly_beyond(2, "engines", ["state", "times", "shown", "steps"])
)
def test_a_flight_ends_before_what_is_not_finite_and_other_lanes_go_on(place):
    x, t, p, row = (
        casadi.SX.sym(name, size) for name, size in zip("xtpr", (2, 2, 0, 1), strict=True)
    )
    after = x + casadi.vertcat(1.0, row if place == "state" else 0)
    shown = row if place == "shown" else x[0]
    f = casadi.Function("f", [x, t, p, row], [after, shown, row if place == "steps" else x[1]])
    in_lanes = arrays(f, 9, (LANES,))
    in_lanes[1][:], in_lanes[3][:] = 0.0, 1.0
    for k, value in enumerate([np.nan, np.inf, -np.inf, 2 * LARGEST, -2 * LARGEST][:LANES]):
        (in_lanes[0][1:, None] if place == "times" else in_lanes[3])[k, 0, k] = value
    begin = [array.copy() for array in in_lanes]
    flights = [lane(in_lanes, k) for k in range(LANES)]
    counts = native(f, lanes=LANES).fly_lanes(flights, LARGEST)
    np.testing.assert_array_equal(counts, [0, 1, 2, 3, 4, 9, 9, 9][:LANES])
    np.testing.assert_array_equal([flight[1][0] for flight in flights], counts)
    for k, evaluated in enumerate(([native(f), Interpreted(f)] * 4)[:LANES]):
        alone = lane(begin, k)
        assert evaluated.fly(*alone, LARGEST) == counts[k]
        np.testing.assert_array_equal(alone[1], flights[k][1])
        np.testing.assert_array_equal(alone[4][: counts[k]], flights[k][4][: counts[k]])


@needs_compiler
@pytest.mark.parametrize("sizes", nightly_beyond(1, "engines", [[2, 1, 0], [0, 0, 0]]))
def test_sizes_may_be_zero(sizes):
    f = function(sizes=sizes)
    for samples in (0, 1, 3):
        for evaluated in (native(f), Interpreted(f)):
            assert evaluated.fly(*arrays(f, samples), LARGEST) == samples
        flights = [arrays(f, samples) for _ in range(LANES)]
        assert native(f, lanes=LANES).fly_lanes(flights, LARGEST) == [samples] * LANES


def test_arrays_that_do_not_fit_are_refused():
    f = function()
    values, evaluated = arrays(f, 3), Interpreted(f)
    for k, array in enumerate(values):
        for strange in (array[..., :0], array.astype(int), np.stack([array] * 2)):
            with pytest.raises(ValueError, match="give "):
                evaluated.fly(*[*values[:k], strange, *values[k + 1 :]], LARGEST)
    with pytest.raises(ValueError, match="give "):
        evaluated.fly(np.arange(8.0)[::2], *values[1:], LARGEST)


def is_cached(function, lanes=1):
    return native(function, lanes=lanes, builds=False) is not None


@needs_compiler
def test_an_entry_is_used_again_and_each_function_and_processor_has_its_own(folder, monkeypatch):
    assert not is_cached(function())
    assert native(function()) is not None
    before = library(folder).stat().st_ino
    assert native(function()) is not None
    assert library(folder).stat().st_ino == before
    assert not is_cached(function(), LANES)
    assert not is_cached(function(3.0))
    assert [path.suffix for path in folder.iterdir()] == [".so"]
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(module, "_processor", lambda: "another")
    assert not is_cached(function())


@needs_compiler
def test_an_entry_that_cannot_be_loaded_is_made_again(folder):
    native(function())
    path = library(folder)
    path.unlink()  # this process has loaded it
    path.write_bytes(b"no library")
    assert not is_cached(function())
    assert native(function()).fly(*arrays(function(), 3), LARGEST) == 3
    assert is_cached(function())


@needs_compiler
def test_entries_used_last_are_kept_and_what_is_no_entry(folder, monkeypatch):
    for factor in (1.0, 2.0):
        native(function(factor))
        for path in folder.glob("*.so"):
            os.utime(path, (0, path.stat().st_mtime - 100))
    assert is_cached(function(1.0))  # it is used
    (folder / "mine").write_bytes(bytes(100_000))
    monkeypatch.setattr(module, "_LARGEST_CACHE", 2.5 * next(folder.glob("*.so")).stat().st_size)
    native(function(4.0))
    assert [is_cached(function(factor)) for factor in (1.0, 2.0, 4.0)] == [1, 0, 1]
    assert {path.name for path in folder.iterdir() if path.suffix != ".so"} == {"mine"}


@needs_compiler
@pytest.mark.parametrize("home", [True, False])
def test_a_folder_that_cannot_be_used_is_told_with_the_remedy(monkeypatch, tmp_path, home):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    (tmp_path / "file").write_text("mine")
    for name in ("DRAKE_NONSTOP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    if home:
        monkeypatch.setenv("DRAKE_NONSTOP_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(module.Path, "home", no_home)
    with pytest.warns(ScenarioWarning, match=r"cannot be used .*set DRAKE_NONSTOP_CACHE") as told:
        assert native(function()) is None
    assert len(told) == 1
    assert (tmp_path / "file").read_text() == "mine"


FAILURES = [
    (None, "there is no C compiler"),
    (f"{VERSION}\necho note >&2\necho error: out of memory >&2\nexit 1", "error: out of memory"),
    ("while [ $# -gt 1 ]; do [ $1 = -o ] && echo no > $2; shift; done", "nothing that can be"),
    (f"{VERSION}\nsleep 60 &\nsleep 60", r"took more than 0\.5 s"),
]


@pytest.mark.parametrize(("script", "reason"), FAILURES)
def test_a_compiler_that_fails_is_told_once(use_compiler, folder, monkeypatch, script, reason):
    use_compiler(script)
    for name in ("_VERSION_TIME_LIMIT", "_TIME_LIMIT"):
        monkeypatch.setattr(module, name, 0.5 if "sleep" in str(script) else 60)
    with pytest.warns(ScenarioWarning, match=reason) as told:
        assert native(function(), lanes=LANES) is None
    assert len(told) == 1
    assert str(told[0].message).endswith("flights go one by one instead")
    begin = time.monotonic()
    assert native(function(), lanes=LANES) is None  # which is not tried again
    assert time.monotonic() - begin < 0.4
    assert not [*folder.glob("*")]


IN_A_PROCESS = """
import sys
sys.path[:0] = {folders!r}
import test_native as t
values = t.arrays(t.function(), 3)
print(t.native(t.function()).fly(*values, 1e3), values[1].tolist())
"""


def start(**options):
    text = IN_A_PROCESS.format(folders=[str(folder) for folder in Path(__file__).parents[:2]])
    return subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, **options)


@needs_compiler
@pytest.mark.slow
def test_two_processes_at_once_do_no_harm(folder):
    values = arrays(function(), 3)
    Interpreted(function()).fly(*values, LARGEST)
    processes = [start() for _ in range(2)]
    printed = [process.communicate(timeout=100)[0].decode().strip() for process in processes]
    assert printed == [f"3 {values[1].tolist()}"] * 2
    assert {path.suffix for path in folder.iterdir()} == {".so"}
    assert is_cached(function())


@pytest.mark.slow
def test_the_first_interrupt_ends_the_compiler(use_compiler, folder, tmp_path):
    use_compiler(
        f"{VERSION}\nsleep 60 &\necho $! > {tmp_path}/new; mv {tmp_path}/new {tmp_path}/id; wait"
    )
    process = start(stderr=subprocess.PIPE)
    while not (tmp_path / "id").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    _, told = process.communicate(timeout=30)
    assert b"KeyboardInterrupt" in told
    assert process.returncode != 0
    status = Path(f"/proc/{int((tmp_path / 'id').read_text())}/stat")
    while status.exists() and status.read_text().split()[2] != "Z":
        assert time.monotonic() - begin < 30  # of the 60 s that it would take
    assert not [*folder.glob("*")]


def test_a_compiler_ends_where_a_check_raises(use_compiler, folder):
    """As of a Ctrl-C that `simulate` only notes."""
    use_compiler(f"{VERSION}\nsleep 60")
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), asking(Mock(side_effect=KeyboardInterrupt)):
        native(function())
    assert time.monotonic() - begin < 5
    assert not [*folder.glob("*")]
