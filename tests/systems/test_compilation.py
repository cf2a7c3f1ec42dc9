"""Functions as compiled C: the same values, and an entry of the cache is loaded if it is sound.

What is compiled beside a process is there for the next call, and ends with the process.
"""

import hashlib
import os
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi
import numpy as np
import pytest

from drake_nonstop.systems import compilation
from drake_nonstop.systems.compilation import (
    CompilationError,
    compiled,
    compiled_for_processor,
    compiler,
)
from drake_nonstop.validation import ScenarioWarning

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache folder of its own, and warnings that have not been told yet."""
    monkeypatch.setenv("DRAKE_NONSTOP_CACHE", str(tmp_path / "cache"))
    compilation._tell.cache_clear()
    return tmp_path / "cache"


@pytest.fixture
def use_compiler(tmp_path, monkeypatch):
    """A function that makes a shell script the compiler."""

    def use(script):
        own = tmp_path / "own"
        own.write_text(f"#!/bin/sh\n{script}\n")
        own.chmod(0o755)
        monkeypatch.setenv("CC", str(own))

    return use


def function(factor=2.0, name="f"):
    x = casadi.SX.sym("x", 2)
    return casadi.Function(name, [x], [casadi.vertcat(factor * casadi.sin(x[0]), x[1] ** 2)])


def values(compiled_function):
    return np.array(compiled_function([0.3, -1.5])).ravel()


def library(folder):
    (found,) = folder.glob("*.so")
    return found


@needs_compiler
def test_values_are_those_of_the_virtual_machine_and_the_entry_is_used_again(folder):
    made = compiled(function()).function
    assert made.class_name() == "External"
    np.testing.assert_allclose(values(made), values(function()), rtol=1e-15)
    before = library(folder).stat().st_mtime_ns
    compiled(function())
    assert library(folder).stat().st_mtime_ns == before
    assert values(compiled(function(3.0)).function)[0] == pytest.approx(3 * np.sin(0.3), rel=1e-15)
    assert len([*folder.glob("*.so")]) == 2


# Each case starts processes, which import this file.
DAMAGES = ["bytes", "useless"]
DAMAGES += [
    pytest.param(damage, marks=pytest.mark.nightly("engines"))
    for damage in ("empty", "mode", "checksum", "folder", "link")
]


@needs_compiler
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.slow
def test_an_entry_that_is_not_sound_is_built_again(folder, damage, tmp_path):
    text = "import sys; sys.path[:0] = sys.argv[1:]; import test_compilation as t; "
    text += "print(t.values((t.compiled(t.function()) or [t.function()])[0]).tolist())"
    call = [sys.executable, "-c", text, os.path.dirname(__file__)]
    # In a process of its own: this one would keep the library that it has loaded.
    expected = subprocess.run(call, capture_output=True, text=True, check=True).stdout
    entry = library(folder)
    sound = entry.read_bytes()
    if damage == "bytes":
        entry.write_bytes(b"no library" + sound[10:])
    elif damage in ("useless", "empty"):  # with a right checksum
        compiled(function(name="g"))
        (other,) = {*folder.glob("*.so")} - {entry}
        other.replace(entry)
        if damage == "empty":
            entry.unlink()  # this process has loaded the other's file
            entry.write_bytes(b"")
        checksum = hashlib.sha256(entry.read_bytes()).hexdigest()
        entry.with_suffix(".sha256").write_text(checksum)
    elif damage == "mode":
        entry.chmod(0o666)
    elif damage == "checksum":
        entry.with_suffix(".sha256").unlink()
    else:
        entry.unlink()
        entry.mkdir() if damage == "folder" else entry.symlink_to(tmp_path / "elsewhere")
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert done.stdout == expected
    if damage == "folder":
        assert "virtual machine" in done.stderr  # what stands there is not removed
        return
    assert not entry.is_symlink()
    assert "virtual machine" not in done.stderr
    assert entry.read_bytes() == sound
    assert entry.stat().st_mode & 0o777 == 0o600


@needs_compiler
def test_a_version_that_is_no_utf_8_is_none_the_less_a_version(use_compiler):
    version = "[ $1 = --version ] && printf 'gcc \\251 FSF\\n' && exit 0"
    use_compiler(f'{version}\nexec {compiler()} "$@"')
    assert values(compiled(function()).function)[1] == 1.5**2


def test_a_compiler_that_does_not_answer_is_told_and_asked_once(
    use_compiler, monkeypatch, tmp_path
):
    use_compiler(f"echo asked >> {tmp_path}/times\nexec sleep 60")
    monkeypatch.setattr(compilation, "_VERSION_TIME_LIMIT", 0.5)
    with pytest.warns(ScenarioWarning, match=r"does not tell its version within 0\.5 s"):
        assert compiled(function()) is None
    assert compiled(function(3.0)) is None
    assert (tmp_path / "times").read_text() == "asked\n"


@needs_compiler
def test_a_user_without_a_home_directory_is_told(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    for name in ("DRAKE_NONSTOP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(compilation.Path, "home", no_home)
    with pytest.warns(ScenarioWarning, match="no home directory; set DRAKE_NONSTOP_CACHE"):
        assert compiled(function()) is None


@needs_compiler
def test_two_at_once_build_it_once_and_both_load_it(folder):
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(compiled, [function(), function()])
    np.testing.assert_array_equal(values(first.function), values(second.function))
    assert len([*folder.glob("*.so")]) == 1
    assert not [*folder.glob(".new-*")]


@needs_compiler
def test_what_killed_processes_have_left_is_removed_once_it_is_old(folder):
    for name in (".new-old", ".new-now"):
        (folder / name).mkdir(parents=True)
    os.utime(folder / ".new-old", (0, 0))
    assert compiled(function()) is not None
    assert [path.name for path in folder.glob(".new-*")] == [".new-now"]


def test_without_a_compiler_one_line_tells_it_once(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(ScenarioWarning, match="there is no C compiler") as told:
        made = compiled(function())
    assert len(told) == 1
    assert "\n" not in str(told[0].message)
    assert made is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled(function()) is None


def test_a_compiler_that_fails_is_told(use_compiler, folder):
    use_compiler("[ $1 = --version ] && exit 0\necho out of memory >&2\nexit 1")
    with pytest.warns(ScenarioWarning, match=r"own failed \(out of memory\)"):
        made = compiled(function())
    assert made is None
    assert not [*folder.glob("*.so")]
    assert not [*folder.glob(".new-*")]


def test_a_compiler_that_makes_what_cannot_be_loaded_is_told(use_compiler, folder):
    use_compiler("while [ $# -gt 1 ]; do [ $1 = -o ] && echo no > $2; shift; done")
    with pytest.warns(ScenarioWarning, match="cannot be loaded"):
        made = compiled(function())
    assert made is None
    assert not [*folder.glob("*.so")]


def test_a_cache_that_cannot_be_written_is_told(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("DRAKE_NONSTOP_CACHE", str(tmp_path / "file" / "cache"))
    if compiler() is None:
        pytest.skip("there is no C compiler")
    with pytest.warns(ScenarioWarning, match="cannot be written"):
        made = compiled(function())
    assert made is None
    assert (tmp_path / "file").read_text() == "mine"


@needs_compiler
def test_what_is_compiled_for_another_processor_is_not_used(folder, monkeypatch):
    def text():
        return "double twice(double x) { return 2 * x; }"

    assert compiled_for_processor(text, builds=False) is None
    assert compiled_for_processor(text, builds=True) is not None
    assert compiled_for_processor(text, builds=False) is not None
    monkeypatch.setattr(compilation, "_processor", lambda: "another")
    assert compiled_for_processor(text, builds=False) is None
    assert len([*folder.glob("*.so")]) == 1


def test_a_compiler_without_vectors_is_told_and_flights_go_one_by_one(use_compiler):
    use_compiler("[ $1 = --version ] && exit 0\necho note >&2\necho error: vector >&2\nexit 1")
    said = (
        r"^flights side by side: .*own failed \(error: vector\); they are flown one by one instead$"
    )
    with pytest.warns(ScenarioWarning, match=said) as told:
        assert compiled_for_processor(lambda: "double x;", builds=True) is None
    assert len(told) == 1


@pytest.fixture
def beside(monkeypatch):
    """A function that takes C, or begins to compile it beside, in a process that has not yet."""
    monkeypatch.setenv(compilation.BESIDE, "1")
    monkeypatch.setattr(compilation, "_begun", set())
    monkeypatch.setattr(compilation, "_builder", None)
    return lambda function: compiled(function, waits=False)


def wait_for(asked, timeout=30.0):
    """Waits until something is so."""
    end = time.monotonic() + timeout
    while not asked() and time.monotonic() < end:
        time.sleep(0.02)
    assert asked()


@needs_compiler
@pytest.mark.slow
def test_what_is_compiled_beside_is_there_for_the_next_call(beside, folder):
    assert beside(function()) is None
    assert beside(function(3.0)) is None  # and is not begun: one at a time is compiled
    assert compilation._builder.wait(30) == 0
    made = beside(function()).function
    assert made.class_name() == "External"
    assert values(made).tobytes() == values(function()).tobytes()
    assert {path.suffix for path in folder.iterdir()} == {".so", ".sha256", ".lock"}


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("ending", ["sys.exit()", "os.kill(os.getpid(), 9)"])
def test_a_process_that_ends_first_ends_its_compiler(use_compiler, folder, tmp_path, ending):
    version = "[ $1 = --version ] && exit 0"
    use_compiler(f"{version}\necho $$ > {tmp_path}/new; mv {tmp_path}/new {tmp_path}/id; sleep 60")
    text = f"""
import os, sys, time
sys.path[:0] = {os.path.dirname(__file__)!r},
import test_compilation as t
assert t.compiled(t.function(), waits=False) is None
while not os.path.exists({str(tmp_path / "id")!r}):
    time.sleep(0.02)
{ending}
"""
    environment = {**os.environ, compilation.BESIDE: "1"}
    subprocess.run([sys.executable, "-c", text], env=environment, stderr=subprocess.DEVNULL)
    number = int((tmp_path / "id").read_text())

    def is_running():
        status = Path(f"/proc/{number}/stat")
        return status.exists() and status.read_text().split()[2] != "Z"

    if ending == "sys.exit()":
        assert not [*folder.glob(".new-*")]
    wait_for(lambda: not is_running() and not [*folder.glob(".new-*")])
    assert not [*folder.glob("*.so")]


@needs_compiler
def test_nothing_is_compiled_beside_where_the_environment_says_so(beside, monkeypatch, folder):
    monkeypatch.setenv(compilation.BESIDE, "0")
    assert beside(function()) is None
    assert compilation._builder is None
    assert not folder.exists()


def test_what_cannot_be_compiled_beside_has_a_reason(beside, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompilationError, match="there is no C compiler"):
        beside(function())
    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("DRAKE_NONSTOP_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.delenv("CC", raising=False)
    if compiler() is not None:
        with pytest.raises(CompilationError, match="cannot be written"):
            beside(function())


@needs_compiler
def test_text_for_this_processor_is_compiled_beside_for_later_calls(monkeypatch, folder):
    def text():
        return "double thrice(double x) { return 3 * x; }"

    monkeypatch.setenv(compilation.BESIDE, "1")
    assert compiled_for_processor(text, builds=False, begins=True) is None
    assert compilation._builder.wait(60) == 0
    assert compiled_for_processor(text, builds=False).thrice is not None
    assert not [*folder.glob(".new-*")]
