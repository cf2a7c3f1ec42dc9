"""Files and folders that are missing, of another kind, damaged, huge or in the way."""

import contextlib
import hashlib
import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adversary import earlier
from adversary.commands import Command, ended
from adversary.verdicts import ACCEPTED, EXIT_CODE, LOST_WORK, MISREAD, REFUSED, Case, Verdict

_QUICK = ["--set", "simulation_duration=0.02", "--no-figures", "--no-replay"]
_SWEPT = (
    "overrides: ['system.load_mass=!Uniform {min: 0.9, max: 1.1}', "
    "simulation_duration=0.02]\nseeds: 2\n"
)
_CSV = "t,x,y,z\n0,0,0,0\n1,0.1,0,0\n2,0.2,0,0\n"
_SDF = """<sdf version="1.7"><model name="crate"><link name="box"><inertial><mass>1.2</mass>
<inertia><ixx>0.01</ixx><ixy>0</ixy><ixz>0</ixz><iyy>0.01</iyy><iyz>0</iyz><izz>0.02</izz></inertia>
</inertial></link><frame name="a" attached_to="box"><pose>0.5 0 0 0 0 0</pose></frame>
<frame name="b" attached_to="box"><pose>-0.25 0.43 0 0 0 0</pose></frame>
<frame name="c" attached_to="box"><pose>-0.25 -0.43 0 0 0 0</pose></frame></model></sdf>"""
_FRAMES = "system.attachment_frames=[a, b, c]"

_Put = Callable[[np.random.Generator, Path, str], str]


def _made(rng: np.random.Generator, path: Path, good: str, form: str, is_read: bool = True) -> None:
    """Puts something at a path: of `good` content, damaged or of another kind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = good.encode()
    cut = int(rng.integers(1, len(data)))
    if form == "missing":
        return
    if form in ("directory", "full directory"):
        path.mkdir()
        if form == "full directory":
            (path / "mine.txt").write_text("mine")
    elif form == "fifo":
        os.mkfifo(path)
    elif form == "loop":
        path.symlink_to(path.name)
    elif form == "dangling":
        path.symlink_to("nowhere/at/all")
    elif form.startswith("/"):
        path.symlink_to(form)
    elif form == "unreadable":
        path.write_bytes(data)
        path.chmod(0)
    elif form == "huge":
        with path.open("wb") as file:
            file.write(data)
            file.truncate(40 << 30)  # sparse
    elif form == "long":
        lines = good.splitlines(keepends=True)
        path.write_text("".join(lines) + lines[-1] * int(rng.choice([1000, 300_000])))
    elif form == "binary":
        path.write_bytes(rng.bytes(3000))
    elif form == "zeros":
        path.write_bytes(bytes(5000))
    elif form == "truncated":
        path.write_bytes(data[:cut])
    elif form == "empty":
        path.write_bytes(b"")
    elif form == "utf-16":
        path.write_bytes(good.encode("utf-16"))
    elif form == "one line":
        path.write_bytes(data.replace(b"\n", b" ") * 2000)
    else:
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 8))):
            damaged[rng.integers(len(damaged))] = int(rng.integers(256))
        path.write_bytes(bytes(damaged))


_KINDS = (
    *("missing", "directory", "fifo", "loop", "dangling", "unreadable", "huge", "long", "binary"),
    *("zeros", "truncated", "empty", "utf-16", "one line", "damaged", "damaged", "damaged"),
    *(
        "/dev/zero",
        "/dev/null",
        "/dev/full",
        "/dev/random",
        "/dev/stdin",
        "/proc/self/mem",
        "/proc",
    ),
    *("/dev/tty", "/etc/shadow", "/proc/kmsg", "/dev/ptmx"),
)
_STANDING = (
    *("directory", "full directory", "fifo", "loop", "dangling", "unreadable", "binary", "empty"),
    *("/dev/zero", "/dev/null", "/dev/full", "/dev/random", "truncated", "huge"),
)
_LONG = "x" * 300


def _read(rng: np.random.Generator, folder: Path) -> tuple[list[str], str]:
    """A command that reads a file which is not what it should be."""
    form = str(rng.choice(_KINDS))
    what = str(rng.choice(["scenario", "trajectory", "load", "spec", "grid", "base"]))
    name = str(
        rng.choice(["mine", "mine", "mine", "a b", "é", "-x", "a'b", "a,b", "[x]", "a:b", "~"])
    )
    if what == "scenario":
        _made(
            rng,
            folder / f"{name}.yaml",
            "mine:\n  based_on: line\n  simulation_duration: 0.02\n",
            form,
        )
        call = ["run", f"./{name}.yaml", "--out", "out", *_QUICK]
    elif what == "base":
        _made(
            rng,
            folder / "base.yaml",
            "mine:\n  based_on: line\n  simulation_duration: 0.02\n",
            form,
        )
        (folder / "top.yaml").write_text("top: {based_on: base.yaml, simulation_duration: 0.02}")
        call = ["run", "top.yaml", "--out", "out", *_QUICK]
    elif what == "trajectory":
        _made(rng, folder / f"{name}.csv", _CSV, form)
        yaml_name = name.replace("'", "''")
        call = [
            "run",
            "line",
            "--out",
            "out",
            *_QUICK,
            "--set",
            f"load_trajectory=!SampledTrajectory {{file: './{yaml_name}.csv'}}",
        ]
    elif what == "load":
        ending = str(
            rng.choice(
                ["sdf", "urdf", "xml", "txt", "dae", "yaml"], p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]
            )
        )
        _made(rng, folder / f"crate.{ending}", _SDF, form)
        call = [
            "run",
            "three_carriers",
            "--out",
            "out",
            *_QUICK,
            "--set",
            f"system.load_file=crate.{ending}",
            _FRAMES,
        ]
    elif what == "spec":
        _made(rng, folder / f"{name}.yaml", _SWEPT, form)
        call = ["sweep", "line", f"./{name}.yaml", "--out", "out"]
    else:
        _made(rng, folder / f"{name}.yaml", "variants:\n  a: [simulation_duration=0.01]\n", form)
        call = [
            "ablate",
            "line",
            "--grid",
            f"./{name}.yaml",
            "--out",
            "out",
            "--no-replay",
            "--set",
            "simulation_duration=0.02",
        ]
    return call, f"{what} file is {form}"


def _written(rng: np.random.Generator, folder: Path) -> tuple[list[str], str]:
    """A command whose results meet something that stands in their way."""
    form = str(rng.choice(_STANDING))
    names = {
        "run": (
            "scenario.yaml",
            "metrics.json",
            "signals.npz",
            "diagram.svg",
            "replay.html",
            "figures",
            "figures/tensions.png",
            ".",
            ".new-abc",
        ),
        "ablate": (
            "summary.tex",
            "runs.csv",
            "index.html",
            "base",
            "PaperPhase",
            ".",
            "PaperPhase/metrics.json",
            "PaperPhase/signals.npz",
            "base/scenario.yaml",
        ),
        "sweep": (
            "journal.jsonl",
            "runs.csv",
            "wall_times.parquet",
            "scenario.yaml",
            "spec.yaml",
            ".",
        ),
        "robustness": (".",),
        "check": ("scenario.yaml", "check.json", "check.png", "."),
    }
    commands = ["run", "run", "run", "ablate", "sweep", "sweep", "robustness", "check"]
    command = str(rng.choice(commands))
    name = str(rng.choice(names[command]))
    _made(rng, folder / "out" / name if name != "." else folder / "out", "text\n" * 20, form)
    if command == "run":
        figures = [] if "figures" in name else ["--no-figures"]
        call = ["run", "line", "--out", "out", "--set", "simulation_duration=0.02", *figures]
    elif command == "ablate":
        call = [
            "ablate",
            "line",
            "--swap",
            "phase=PaperPhase",
            "--out",
            "out",
            "--no-replay",
            "--set",
            "simulation_duration=0.02",
        ]
    elif command == "sweep":
        (folder / "s.yaml").write_text(_SWEPT)
        call = ["sweep", "line", "s.yaml", "--out", "out"]
        call += ["--restart"] if rng.random() < 0.3 else []
    elif command == "check":
        call = ["check", "aircraft_rest", "--out", "out"]
    else:
        call = ["robustness", "line", "--out", "out", "--set", "simulation_duration=-1"]
        if form not in ("directory", "full directory"):
            call[-1] = "simulation_duration=0.02"
    return call, f"out/{name} is {form}"


def _named(rng: np.random.Generator, folder: Path) -> tuple[list[str], str]:
    """An output folder of a name that is none, or where nothing can be written."""
    (folder / "file").write_text("mine")
    (folder / "closed").mkdir()
    (folder / "closed").chmod(0o500)
    (folder / "loop").symlink_to("loop")
    (folder / "gone").symlink_to("nowhere")
    out = str(
        rng.choice(
            [
                _LONG,
                f"a/{_LONG}/b",
                "/".join(["abcdefgh"] * 600),
                "file",
                "file/below",
                "closed/new",
                "loop",
                "loop/a",
                "gone",
                "gone/below",
                "/dev/null",
                "/dev/null/a",
                "/dev/full",
                "/proc/new",
                "/proc/self/fd",
                "/sys/new",
                "",
                " ",
                ".",
                "..",
                "-",
                "~",
                "é/ü",
                "a\nb",
                "\udcff",
                "a\tb",
                "\\",
                "*",
                "$HOME",
                "a:b",
                "'",
                '"',
                "con",
                "x" * 255,
                "x" * 256,
                "x" * 250,
                "/",
                "//",
                "a//b/../c",
            ]
        )
    )
    command = str(rng.choice(["run", "run", "ablate", "sweep", "robustness", "stability", "check"]))
    (folder / "s.yaml").write_text(_SWEPT)
    call = {
        "run": ["run", "line", *_QUICK],
        "ablate": [
            "ablate",
            "line",
            "--swap",
            "phase=PaperPhase",
            "--set",
            "simulation_duration=0.02",
            "--no-replay",
        ],
        "sweep": ["sweep", "line", "s.yaml"],
        "robustness": ["robustness", "line", "--set", "system.load_mass=-1"],
        "stability": ["stability", "line", "--set", "system.load_mass=-1"],
        "check": ["check", "aircraft_rest"],
    }[command]
    return [*call, f"--out={out}"], "an odd folder"


def _resumed(rng: np.random.Generator, folder: Path) -> tuple[list[str], str]:
    """A sweep in a folder whose journal is damaged."""
    (folder / "s.yaml").write_text(_SWEPT)
    line = str(
        rng.choice(
            [
                '{"run":0}',
                '{"run":0,"outcome":"completed"}',
                "{}",
                "[]",
                "5",
                "null",
                "text",
                '{"run":"a"}',
                '{"run":99,"outcome":"completed","error":"","metrics":{},"wall_times":{}}',
                '{"run":-1}',
                '{"run":0,"outcome":5,"error":5,"metrics":5,"wall_times":5}',
                '{"run":null}',
                '"run"',
                '{"run":0,"outcome":"completed","error":"","metrics":{"a":[1]},"wall_times":{}}',
                "\0\0\0",
                '{"run":0.5,"metrics":{}}',
                '{"run":[0]}',
                '{"run":{}}',
                '{"run":0',
                "\ufeff",
                "é" * 100,
                '{"run":true,"outcome":"x","error":"","metrics":{},"wall_times":{}}',
                "[" * 100_000,
                '{"run":0,"ending":"completed","outcome":"ok","error":"","metrics":{},"wall_times":{}}',
            ]
        )
    )
    where = str(rng.choice(["after the first line", "alone", "at the end", "as the first line"]))
    return [
        "sweep",
        "line",
        "s.yaml",
        "--out",
        "out",
    ], f"journal line {line[:80]} {where}|{line}"


_SCARCE = {  # resources, and how much of them there is
    "bytes in a file": (resource.RLIMIT_FSIZE, (5_000, 20_000, 60_000, 300_000)),
    "open files": (resource.RLIMIT_NOFILE, (16, 24, 40)),
    "bytes of memory": (resource.RLIMIT_DATA, (1 << 28, 1 << 29)),
}


def _scarce(rng: np.random.Generator, folder: Path) -> tuple[list[str], str]:
    """A command that runs out of something, in a folder with earlier results."""
    what = str(rng.choice(list(_SCARCE)))
    amount = int(rng.choice(_SCARCE[what][1]))
    (folder / "s.yaml").write_text(_SWEPT)
    earlier.put(folder / "out")
    call = {
        "run": ["run", "line", "--set", "simulation_duration=0.1", "--no-figures"],
        "ablate": [
            "ablate",
            "line",
            "--swap",
            "phase=PaperPhase",
            "--set",
            "simulation_duration=0.1",
            "--no-replay",
        ],
        "sweep": ["sweep", "line", "s.yaml"],
        "check": ["check", "aircraft_rest"],
    }[str(rng.choice(["run", "run", "run", "ablate", "sweep", "check"]))]
    out = "out/check" if call[0] == "check" else "out"  # beside a run's results, not over them
    return [*call, "--out", out], f"no more than {amount} {what}"


_FORMS = {_scarce: 1.5, _read: 4, _written: 4, _named: 2, _resumed: 1}


def draw(rng: np.random.Generator) -> Case:
    weights = np.array(list(_FORMS.values()))
    form = list(_FORMS)[rng.choice(len(weights), p=weights / weights.sum())]
    state = rng.bit_generator.state

    def again() -> np.random.Generator:
        copy = np.random.default_rng()
        copy.bit_generator.state = state
        return copy

    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as scratch:  # only to know what is typed
        call, what = form(again(), Path(scratch))
    shown = " ".join(a if len(a) < 100 else f"{a[:60]}… ({len(a)})" for a in call)
    return Case(
        text=f"{what.partition('|')[0]}: {shown}".encode("utf-8", "replace").decode(),
        attempt=lambda folder: _attempt(form, again(), folder),
        limit=60,
    )


def _attempt(form, rng: np.random.Generator, folder: Path) -> Verdict:  # type: ignore[no-untyped-def]
    call, what = form(rng, folder)
    if form is _resumed:
        first = Command(arguments=call, folder=folder)
        before = ended(first, 30)
        if before.faults:
            return before
        journal = folder / "out" / "journal.jsonl"
        lines = journal.read_text().splitlines()
        line, where = what.split("|", 1)[1], what.split("|", 1)[0]
        lines = {
            "line": [lines[0], line, *lines[1:]],
            "alone": [line],
            "end": [*lines, line],
        }.get(where.split()[-1], lines)
        if where.endswith("as the first line"):
            lines = [line, *lines[1:]]
        journal.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="surrogatepass")
    before_call = _contents(folder)
    if form is _scarce:
        return _attempt_scarce(folder, call, what)
    command = Command(arguments=call, folder=folder)
    verdict = ended(command, 30)
    after = _contents(folder)
    if verdict.ending == REFUSED:
        changed = [
            name
            for name in before_call.keys() | after.keys()
            if before_call.get(name) != after.get(name) and not name.endswith("/out")
        ]
        # A sweep's own files, which say what it was asked for, may be written already.
        changed = [name for name in changed if Path(name).name not in ("out", "journal.jsonl")]
        if changed:
            verdict.add(LOST_WORK, f"refused, but changed {sorted(changed)[:3]}")
    for name in ("file", "out/mine.txt", "out/figures/mine.txt"):
        if name in before_call and before_call[name] != after.get(name):
            verdict.add(LOST_WORK, f"{name} of the user is gone or changed")
    if verdict.ending == ACCEPTED and "fifo" not in what and call[0] == "run":
        found = [*folder.parent.rglob("metrics.json")]
        if not found and not any(a.startswith("--out=/") for a in call):
            verdict.add(MISREAD, "accepted, but there are no results")
    return verdict


def _attempt_scarce(folder: Path, call: list[str], what: str) -> Verdict:
    _, _, _, amount, name = what.split(" ", 4)
    kind = _SCARCE[name][0]

    def program() -> int:
        from drake_nonstop.cli.main import main

        resource.setrlimit(kind, (int(amount), int(amount)))
        return main()

    command = Command(arguments=call, folder=folder, program=program)
    verdict = ended(command, 40)
    if command.code == -signal.SIGXFSZ:
        verdict.faults = []
        verdict.add(EXIT_CODE, "killed by SIGXFSZ")
    earlier.judge_tidiness(verdict, folder / "out")
    if call[0] in ("run", "check"):
        earlier.judge_results(verdict, folder / "out", 0.0)
    return verdict


def _contents(folder: Path) -> dict[str, str]:
    """What is in a folder: hashes of the files."""
    found = {}
    for path in sorted(folder.rglob("*")):
        with contextlib.suppress(OSError):
            if path.is_symlink():
                found[str(path.relative_to(folder))] = f"link to {os.readlink(path)}"
            elif path.is_file() and path.stat().st_size < 1 << 24:
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                found[str(path.relative_to(folder))] = digest
    return found
