"""The command with drawn options, files and folders: an exit code, one sentence, nothing lost."""

import contextlib
import hashlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adversary.drawn import SHORT
from adversary.judging import judge_sentence, limited
from drake_nonstop.cli.main import main

FLOWN, FAILED, REFUSED = (0, 3), 1, 2
QUICK = ["--set", SHORT, "optimization_layer=ConstantParameters"]
WORDS = (
    *("0", "-1", "1", "1.5", "nan", "inf", "1e400", "abc", "", "0x1", "9" * 30, "1_0", "٣", "é"),
    *("🛩", "a\nb", "x" * 3000, "--", "-", "-h", "a=b", "=", "/dev/zero", "[]", "!x", "%s", "{0}"),
    *("../..", "quintic", "no_such.yaml", "LINE", "phase=PaperPhase", "system.load_mass=0", "640x"),
)
FOLDERS = (
    *("x" * 300, "file", "file/below", "closed/new", "loop/a", "gone/below", "x" * 255, "x" * 256),
    *("/dev/null", "/dev/null/a", "/dev/full", "/proc/new", "/sys/new", " ", "a\tb", "a//b/../c"),
    *(".", "..", "~", "é/ü", "\udcff", "\\", "*", "$HOME", "a:b", "'"),
)


def help_of(*command: str) -> str:
    """What the help of the command shows."""
    with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
        main([*command, "--help"])
    return shown.getvalue()


def options_of(command: str) -> dict[str, bool]:
    """The options of a command, and whether each takes a value."""
    found = re.findall(r"(?m)^  (?:-\w, )?(--[\w-]+)( \S)?", help_of(command))
    return {name: bool(value) for name, value in found if name not in ("--help", "--live")}


OPTIONS = {name: options_of(name) for name in re.findall(r"(?m)^    (\w+) ", help_of())}
# Studies fly in processes, which takes seconds: here what they are asked for is refused before.
BRIEF = {"run": [*QUICK, "--no-figures", "--no-replay"], "check": [*QUICK, "--seeds", "1"]}
REFUSED_ANYHOW = ["--set", "system.load_mass=0"]


@st.composite
def calls(draw: st.DrawFn) -> list[str]:
    """A command with options that it has, and words for them, or with others."""
    command, word = draw(st.sampled_from([*OPTIONS])), st.sampled_from(WORDS)
    call = [command, draw(st.one_of(st.sampled_from(["line", "quintic"]), word))]
    for option, takes_value in OPTIONS[command].items():
        if draw(st.booleans()) and draw(st.booleans()):
            value = st.sampled_from(FOLDERS) if option == "--out" else word
            call += [option, draw(value)] if takes_value else [option]
    call += draw(st.lists(word, max_size=1))
    return [*call, *BRIEF.get(command, REFUSED_ANYHOW if "--set" in OPTIONS[command] else [])]


def judged(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> int:
    """The exit code of a call, whose output is as it should be."""
    capfd.readouterr()
    with limited():
        try:
            code = main([argument.replace("\0", "") for argument in arguments])
        except SystemExit as ended:  # argparse's
            code = int(ended.code or 0)
    judge_output(code, *capfd.readouterr())
    return code


def judge_output(code: int, out: str, error: str) -> None:
    """Asserts that the output of a command fits to its exit code."""
    said = [line for line in error.splitlines() if re.match(r"drake-nonstop( [\w-]+)*: ", line)]
    assert "Traceback" not in out + error, error
    assert code in (*FLOWN, FAILED, REFUSED), code
    if code == REFUSED:
        (sentence,) = said
        if not re.match(r"drake-nonstop( [\w-]+)*: error: ", sentence):  # argparse's
            judge_sentence(sentence.removeprefix("drake-nonstop: "))
    else:
        assert code == FAILED or not said, error
        assert code != FAILED or said or out, "exit code 1 without a word"


def test_the_commands_and_their_options_are_found():
    assert {"run", "check", "list", "sweep", "design"} <= {*OPTIONS}
    assert {"--set": True, "--no-figures": False}.items() <= OPTIONS["run"].items()


@given(calls())
def test_any_options_are_one_sentence_or_a_result(tmp_path_factory, monkeypatch, capfd, arguments):
    monkeypatch.chdir(tmp_path_factory.mktemp("called"))
    Path("file").write_text("mine")
    Path("closed").mkdir(mode=0o500)
    Path("loop").symlink_to("loop")
    Path("gone").symlink_to("nowhere")
    judged(arguments, capfd)
    assert Path("file").read_text() == "mine"


CSV = "t,x,y,z\n0,0,0,0\n1,0.1,0,0\n2,0.2,0,0\n"
SDF = """<sdf version="1.7"><model name="crate"><link name="box"><inertial><mass>1.2</mass>
<inertia><ixx>0.01</ixx><ixy>0</ixy><ixz>0</ixz><iyy>0.01</iyy><iyz>0</iyz><izz>0.02</izz></inertia>
</inertial></link><frame name="a" attached_to="box"><pose>0.5 0 0 0 0 0</pose></frame>
<frame name="b" attached_to="box"><pose>-0.25 0.43 0 0 0 0</pose></frame>
<frame name="c" attached_to="box"><pose>-0.25 -0.43 0 0 0 0</pose></frame></model></sdf>"""
SPEC = "overrides: ['system.load_mass=!Uniform {min: 0.9, max: 1.1}']\nseeds: 2\n"
GRID = "variants:\n  a: [phase=PaperPhase]\n"
MINE = f"mine: {{based_on: line, {SHORT.replace('=', ': ')}}}\n"
RUN = ["run", "--out", "out", *BRIEF["run"]]
TOP = f"top: {{based_on: base.yaml, {SHORT.replace('=', ': ')}}}\n"
SAMPLED = "load_trajectory=!SampledTrajectory {file: a b.csv}"
CRATE = ["system.load_file=crate.sdf", "system.attachment_frames=[a, b, c]"]
# What a command reads from a file, and the command.
READ = {
    "mine.yaml": (MINE, [*RUN, "--", "mine.yaml"]),
    "base.yaml": (MINE, [*RUN, "--", "top.yaml"]),
    "a b.csv": (CSV, [*RUN, SAMPLED, "--", "line"]),
    "crate.sdf": (SDF, [*RUN, *CRATE, "--", "three_carriers"]),
    "spec.yaml": (SPEC, ["sweep", "line", "spec.yaml", *REFUSED_ANYHOW]),
    "grid.yaml": (GRID, ["ablate", "line", "--grid", "grid.yaml", *REFUSED_ANYHOW]),
    "request.yaml": ("load_mass: 5\n", ["design", "request.yaml", "--set", "load_mass=0"]),
}
FORMS = (
    *("missing", "folder", "full folder", "fifo", "loop", "dangling", "unreadable", "huge", "long"),
    *("binary", "zeros", "truncated", "empty", "utf-16", "one line", "damaged", "/dev/zero"),
    *("/dev/null", "/dev/full", "/dev/random", "/dev/stdin", "/proc/self/mem", "/proc", "/dev/tty"),
)


def put(path: Path, form: str, good: str, draw: int) -> None:
    """Puts something at a path: of good content, damaged, or of another kind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data, cut = good.encode(), draw % len(good)
    contents = {
        "binary": hashlib.sha512(str(draw).encode()).digest() * 50,
        "zeros": bytes(5000),
        "truncated": data[:cut],
        "empty": b"",
        "utf-16": good.encode("utf-16"),
        "one line": data.replace(b"\n", b" ") * 2000,
        "long": data + (data.splitlines()[-1] + b"\n") * 100_000,
        "damaged": data[:cut] + bytes([draw % 256]) + data[cut + 1 :],
        "unreadable": data,
        "huge": data,
    }
    if form in contents:
        path.write_bytes(contents[form])
    elif form.endswith("folder"):
        path.mkdir()
    elif form == "fifo":
        os.mkfifo(path)
    elif form != "missing":
        path.symlink_to({"loop": path.name, "dangling": "nowhere/at/all"}.get(form, form))
    if form == "full folder":
        (path / "mine.txt").write_text("mine")
    elif form == "huge":
        os.truncate(path, 40 << 30)  # sparse
    elif form == "unreadable":
        path.chmod(0)


@given(st.sampled_from([*READ]), st.sampled_from(FORMS), st.integers(0, 10_000))
def test_a_file_that_is_not_what_it_should_be(tmp_path_factory, monkeypatch, capfd, name, form, k):
    folder = tmp_path_factory.mktemp("read")
    monkeypatch.chdir(folder)
    good, call = READ[name]
    Path("top.yaml").write_text(TOP)
    put(Path(name), form, good, k)
    code = judged(call, capfd)
    assert code != REFUSED or not Path("out").exists()
    assert code not in FLOWN or Path("out/metrics.json").exists()


RESULTS = ("scenario.yaml", "metrics.json", "signals.npz", "diagram.svg", "replay.html", ".")


@given(st.sampled_from(RESULTS), st.sampled_from(FORMS[1:]), st.integers(0, 10_000))
def test_results_that_meet_something_in_their_way(
    tmp_path_factory, monkeypatch, capfd, name, form, k
):
    folder = tmp_path_factory.mktemp("written")
    monkeypatch.chdir(folder)
    Path("mine.txt").write_text("mine")
    put(Path("out") / name if name != "." else Path("out"), form, "text\n" * 20, k)
    code = judged([*RUN, "--", "line"], capfd)
    assert code not in FLOWN or {"scenario.yaml", "metrics.json"} <= {*os.listdir("out")}
    kept = [*Path().rglob("mine.txt")]
    assert all(path.read_text() == "mine" for path in kept)
    assert not [*Path().rglob(".new-*")]


ENVIRONMENTS = (
    *({"PYTHONIOENCODING": name} for name in ("ascii", "latin-1")),
    *({"LC_ALL": name} for name in ("C", "no_such.locale")),
    *({"COLUMNS": name} for name in ("1", "0", "-5", "text", "100000")),
    *({"HOME": "/nonexistent"}, {"TMPDIR": "/nonexistent"}, {"MPLBACKEND": "no_such"}),
    *({"PYTHONOPTIMIZE": "2"}, {"PYTHONDEVMODE": "1"}, {"TZ": "Nowhere/None"}),
    *({"TERM": "dumb"}, {"PATH": ""}),
)
SHOWN = (["list"], ["blocks", "phase"], ["--version"], ["check", "line", *BRIEF["check"]])


@pytest.mark.nightly("adversary")
@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=str)
def test_a_process_in_an_odd_environment(tmp_path, environment):
    for arguments in (*SHOWN, [*RUN, "--", "line"], ["run", "no_such"]):
        odd = {**os.environ, **environment}
        call = [sys.executable, "-m", "drake_nonstop.cli", *arguments]
        process = subprocess.run(call, cwd=tmp_path, capture_output=True, timeout=120, env=odd)
        texts = [text.decode(errors="replace") for text in (process.stdout, process.stderr)]
        judge_output(process.returncode, *texts)
        assert (process.returncode == REFUSED) == ("no_such" in arguments), texts
