"""Output that cannot be written, and characters that it cannot show."""

import io
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_nonstop.cli.output import GuardedStream


@given(
    encoding=st.sampled_from(["ascii", "latin-1", "utf-8", "cp437"]),
    texts=st.lists(st.text(st.characters(codec=None, categories=None))),
)
def test_any_text_can_be_printed_in_any_encoding(encoding, texts):
    raw = io.BytesIO()
    stream = GuardedStream(io.TextIOWrapper(raw, encoding=encoding, newline=""))
    for text in texts:
        print(text, file=stream, end="")
    stream.flush()
    assert stream.error is None
    shown = raw.getvalue().decode(encoding)
    whole = "".join(texts)
    assert len(shown) == len(whole)
    assert all(a == b or a == "?" for a, b in zip(shown, whole, strict=True))


def test_the_first_error_silences_a_stream():
    closed = io.StringIO()
    closed.close()
    stream = GuardedStream(closed)
    print("a", file=stream)
    print("b", file=stream, flush=True)
    assert isinstance(stream.error, ValueError)


def run(arguments, redirections, folder):
    script = f"{sys.executable} -m drake_nonstop.cli {arguments} {redirections}"
    return subprocess.run(
        ["sh", "-c", script],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=60,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("redirections", "code", "words"),
    [
        ("<&- >&- 2>&-", 0, ""),
        (">/dev/full", 1, "the output was not written"),
        (">/dev/full 2>/dev/full", 1, ""),
        (">&-", 0, ""),
    ],
)
def test_results_do_not_depend_on_what_is_printed(tmp_path, redirections, code, words):
    options = "--no-figures --no-replay --set simulation_duration=0.05"
    done = run(f"run static_hold_open_loop {options}", redirections, tmp_path)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 1
    names = {path.name for path in (tmp_path / "out" / "static_hold_open_loop").iterdir()}
    assert names == {"scenario.yaml", "metrics.json", "signals.npz", "diagram.svg"}


@pytest.mark.nightly("processes")
def test_help_and_an_ascii_locale(tmp_path):
    done = run("--help", ">/dev/full", tmp_path)
    assert done.returncode == 1
    assert "the output was not written" in done.stderr
    ascii_only = "PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 LC_ALL=C"
    script = f"{ascii_only} {sys.executable} -m drake_nonstop.cli list"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "PYTHONUTF8=1" in done.stderr
