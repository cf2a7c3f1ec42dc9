"""Every subcommand with drawn options, in drawn environments."""

from pathlib import Path

import numpy as np

from adversary.commands import Command, ended
from adversary.verdicts import ACCEPTED, EXIT_CODE, TRACEBACK, Case, Verdict

_NUMBERS = (
    "0",
    "-1",
    "1",
    "1.5",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "abc",
    "",
    "0x1",
    "9" * 30,
    "1_0",
    "65536",
    "-0",
    "  3",
    "٣",
    "1e3",
    "True",
    "9" * 5000,
)
_TEXTS = (
    "",
    " ",
    "é",
    "🛩",
    "\udcff",
    "a\nb",
    "x" * 3000,
    "--",
    "-",
    "-h",
    "a=b",
    "=",
    "/dev/zero",
    "[]",
    "{}",
    "!x",
    "%s",
    "{0}",
    "$(ls)",
    "../..",
    "quintic",
    "line",
    "line.yaml",
    "LINE",
)

_ENVIRONMENTS: tuple[dict[str, str], ...] = (
    {},
    {},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1"},
    {"PYTHONIOENCODING": "cp1252"},
    {"LANG": "C", "LC_ALL": "C"},
    {"LC_ALL": "no_such.locale"},
    {"COLUMNS": "1"},
    {"COLUMNS": "0"},
    {"COLUMNS": "-5"},
    {"COLUMNS": "text"},
    {"COLUMNS": "100000"},
    {"HOME": "/nonexistent"},
    {"HOME": "", "USER": "", "LOGNAME": ""},
    {"TMPDIR": "/nonexistent"},
    {"TMPDIR": "/proc"},
    {"MPLCONFIGDIR": "/proc/none", "HOME": "/proc"},
    {"MPLBACKEND": "no_such"},
    {"PYTHONWARNINGS": "error"},
    {"PYTHONOPTIMIZE": "2"},
    {"PYTHONHASHSEED": "0", "PYTHONDEVMODE": "1"},
    {"TERM": "dumb", "NO_COLOR": "1"},
    {"PATH": ""},
    {"OMP_NUM_THREADS": "1"},
    {"TZ": "Nowhere/None"},
    {"BROWSER": "/bin/false"},
    {"PYTHONPATH_EXTRA": "x", "PYTHONSAFEPATH": "1"},
)


def _number(rng: np.random.Generator) -> str:
    return str(rng.choice(_NUMBERS))


def _text(rng: np.random.Generator) -> str:
    return _TEXTS[rng.integers(len(_TEXTS))]


def _arguments(rng: np.random.Generator) -> list[str]:
    """A call that ends soon, whatever is accepted."""
    quick = ["--set", "simulation_duration=0.02"]
    command = str(
        rng.choice(
            [
                "none",
                "list",
                "blocks",
                "run",
                "run",
                "run",
                "check",
                "check",
                "stability",
                "robustness",
                "ablate",
                "sweep",
                "odd",
            ]
        )
    )
    scenario = "line" if rng.random() < 0.75 else _text(rng)
    pick = rng.random()
    brief = ["--no-replay"] if rng.random() < 0.15 else ["--no-replay", "--no-figures"]
    if command == "none":
        return [[], ["--help"], ["--version"], ["-v"], [""], ["--no"], ["--", "list"]][
            rng.integers(7)
        ]
    if command == "odd":
        return [_text(rng) for _ in range(rng.integers(1, 5))]
    if command == "list":
        return ["list", *([] if pick < 0.6 else [_text(rng)])]
    if command == "blocks":
        box = [
            "phase",
            "pattern",
            "cables",
            "optimization_layer",
            "scene",
            "Phase",
            "no",
            _text(rng),
        ]
        return ["blocks", *([] if pick < 0.3 else [str(rng.choice(box))])]
    if command == "run":
        options = [
            ["--realtime", _number(rng)],
            ["--port", _number(rng)],
            ["--quiet"],
            ["--no-figures"],
            ["--live", "--realtime", _number(rng)],
            ["--live", "--port", _number(rng)],
            ["--live", "--realtime", "0"],
            ["--set"],
            ["--set", _text(rng)],
            ["--trust"],
            ["--out"],
            ["--out", "é"],
            ["--out", "🛩"],
            ["--set=simulation_duration=0.01"],
            ["--se", "simulation_duration=0.01"],
            ["--set", "optimization_layer.speed_bound=0.7"],
            ["--quiet"],
            ["--set", "phase=PaperPhase"],
            ["--set", "engine=compiled"],
            ["--help"],
            [_text(rng)],
        ]
        drawn = [options[k] for k in rng.choice(len(options), rng.integers(0, 4), replace=False)]
        return ["run", scenario, *quick, *(a for o in drawn for a in o), *brief]
    if command == "check":
        options = [
            ["--out"],
            ["--out", _text(rng)],
            ["--trust"],
            ["--set", f"{_text(rng)}={_text(rng)}"],
            ["--set", f"system.aircraft.model={_text(rng)}"],
            ["--set", f"system.aircraft.max_lift={_number(rng)}"],
            ["--set", f"wind=!SteadyWind {{velocity: [{_number(rng)}, 0, 0]}}"],
            ["--help"],
            ["--seed", "1"],
            [_text(rng)],
            [],
        ]
        drawn = [options[k] for k in rng.choice(len(options), rng.integers(1, 3), replace=False)]
        name = "aircraft_rest" if rng.random() < 0.7 else scenario
        return ["check", name, *(a for o in drawn for a in o)]
    if command in ("stability", "robustness"):
        more = ["--seed", _number(rng)] if command == "robustness" else []
        return [
            command,
            scenario,
            *more,
            "--set",
            f"{_text(rng)}={_text(rng)}",
            "system.load_mass=0",
        ]
    if command == "ablate":
        options = [
            ["--swap", "phase=PaperPhase"],
            ["--swap", _text(rng)],
            ["--swap"],
            ["--grid", _text(rng)],
            ["--grid", "paper"],
            ["--swap", f"simulation_duration={_number(rng)[:8]}", "a=b"],
            ["--swap", "é=1"],
            ["--swap", "phase=PaperPhase", "--swap", "phase=PaperPhase"],
            ["--swap", "=1"],
            [],
            ["--swap", f"system.load_mass={_number(rng)}"],
            ["--swap", f"phase={_text(rng)}"],
        ]
        drawn = [options[k] for k in rng.choice(len(options), rng.integers(1, 3), replace=False)]
        return ["ablate", scenario, *quick, *(a for o in drawn for a in o), "--no-replay"]
    if command == "sweep":
        form = rng.integers(4)
        end = [["--run", _number(rng)], ["--restart"], ["--serial"], [_text(rng)]][form]
        return ["sweep", scenario, "s.yaml", *quick, *end]
    return [*command.split(), scenario, *quick, "--set", "system.load_mass=0"]


def draw(rng: np.random.Generator) -> Case:
    arguments = _arguments(rng)
    environment = dict(_ENVIRONMENTS[rng.integers(len(_ENVIRONMENTS))])
    stdout = str(rng.choice(["", "", "", "", "full", "closed", "pipe"]))
    is_fresh = bool(rng.random() < 0.35) or set(environment) - {"PYTHONIOENCODING"} != set()
    without = ("HOME",) if rng.random() < 0.1 else ()
    place = str(rng.choice(["", "", "", "", "", "read-only", "removed"]))
    arguments = [a.replace("\0", "") for a in arguments]
    shown = " ".join(a if len(a) < 200 else a[:50] + "…" for a in arguments)
    settings = " ".join(f"{name}={value}" for name, value in environment.items())
    end = f" > {stdout}" if stdout else ""
    where = f" in a {place} folder" if place else ""
    text = f"{settings} drake-nonstop {shown}{end}{where}{' (fresh)' if is_fresh else ''}"
    return Case(
        text=text.encode("utf-8", "replace").decode(),
        attempt=lambda folder: _attempt(
            folder, arguments, environment, without, stdout, place, is_fresh
        ),
        limit=90,
    )


def _attempt(
    folder: Path,
    arguments: list[str],
    environment: dict[str, str],
    without: tuple[str, ...],
    stdout: str,
    place: str,
    is_fresh: bool,
) -> Verdict:
    here = folder / "work"
    here.mkdir()
    (here / "s.yaml").write_text(
        "overrides: ['system.load_mass=!Uniform {min: 0.9, max: 1.1}', "
        "simulation_duration=0.02]\nseeds: 2\n"
    )
    if place == "read-only":
        here.chmod(0o500)
    program = None
    script = ""
    if place == "removed":
        is_fresh, script = (
            True,
            (
                "import os, shutil, sys; shutil.rmtree(os.getcwd()); "
                "from drake_nonstop.cli.main import main; sys.exit(main())"
            ),
        )
    command = Command(
        arguments=arguments,
        folder=here,
        environment=environment,
        without=without,
        stdout=stdout,
        is_fresh=is_fresh,
        program=program,
        script=script,
    )
    verdict = ended(command, 60)
    if command.code == 1 and stdout == "pipe":  # the reader has closed it: nothing more to say
        verdict.faults = [fault for fault in verdict.faults if fault[0] == TRACEBACK]
    if stdout == "full" and verdict.ending == ACCEPTED and _prints(arguments):
        verdict.add(EXIT_CODE, "0 though nothing could be printed")
    return verdict


def _prints(arguments: list[str]) -> bool:
    return arguments[:1] in (["list"], ["blocks"], ["check"], ["--help"], ["--version"]) or (
        arguments[:1] == ["run"] and "--quiet" not in arguments
    )
