"""Arguments that several subcommands share, and how they read a scenario and write results."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

    from drake_nonstop.scenario.schema import Scenario
    from drake_nonstop.studies.study import Study

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_changes(
    parser: argparse.ArgumentParser, option: str, about: str, metavar: str = "PATH=VALUE"
) -> None:
    """Adds an option that takes overrides, and may be repeated."""
    parser.add_argument(option, nargs="+", action="extend", default=[], metavar=metavar, help=about)


def add_trust(
    parser: argparse.ArgumentParser, about: str = "let the scenario import blocks of your own"
) -> None:
    """Adds --trust."""
    parser.add_argument("--trust", action="store_true", help=about)


def add_scenario(parser: argparse.ArgumentParser, folder: str | None = "out/NAME") -> None:
    """Adds the scenario, --set and --trust, and --out, whose default the help names.

    A command whose `folder` is None writes nothing.
    """
    parser.add_argument("scenario", metavar="NAME|FILE.yaml", help="a scenario's name or file")
    if folder is not None:
        parser.add_argument("--out", type=Path, metavar="DIR", help=f"results' folder ({folder})")
        parser.set_defaults(default_folder=Path(folder).parent, restart=False)
    add_changes(parser, "--set", "change the scenario: system.load_mass=1.2, phase=PaperPhase")
    add_trust(parser, "let it import blocks of your own, such as phase=my_blocks.MyPhase")


def add_study(parser: argparse.ArgumentParser, folder: str) -> None:
    """Adds the arguments of `add_scenario`, and --restart."""
    add_scenario(parser, folder)
    about = "begin again, without the results of an interrupted call"
    parser.add_argument("--restart", action="store_true", help=about)


def add_seeds(parser: argparse.ArgumentParser) -> None:
    """Adds --seeds."""
    about = "runs of each, which differ in noise, gusts and draws (the scenario's own seed)"
    parser.add_argument("--seeds", type=int, metavar="N", help=about)


def add_lists(parser: argparse.ArgumentParser, option: str, metavar: str, about: str) -> None:
    """Adds an option that takes several values, and may be repeated for further lists."""
    more: dict[str, Any] = {"nargs": "+", "action": "append", "default": []}
    parser.add_argument(option, metavar=metavar, help=about, **more)


def result_folder(options: argparse.Namespace, name: str, scenario: "Scenario") -> Path:
    """--out, or the default folder of that name: not over the results of another scenario.

    With --restart that folder is taken whatever it holds.
    """
    from drake_nonstop.run.stored_run import SCENARIO
    from drake_nonstop.scenario.loading import dump_scenario
    from drake_nonstop.studies.files import free_folder

    folder: Path = options.default_folder / name
    if options.out or options.restart:
        return options.out or folder
    return free_folder(folder, SCENARIO, dump_scenario(scenario))


def read_scenario(options: argparse.Namespace, *, sampled: bool = True) -> "Scenario":
    """The scenario that the arguments of `add_scenario` name; raises ScenarioError.

    Where it is `sampled`, numbers have been drawn for its distributions.
    """
    from drake_nonstop.scenario.loading import load_scenario

    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    return scenario.sampled() if sampled else scenario


def make_study(
    options: argparse.Namespace, make: "Callable[..., Study]", *arguments: Any, **given: Any
) -> int:
    """Makes a study and prints its table; returns the exit code."""
    from drake_nonstop.studies.attempts import COMPLETED, DIVERGED
    from drake_nonstop.view.progress import TaskProgress

    with TaskProgress() as progress:
        made = make(*arguments, restart=options.restart, progress=progress, **given)
    print(made)
    print(f"results: {made.folder}/index.html")
    return 0 if {*made.table["ending"]} <= {COMPLETED, DIVERGED} else 1


def write_figure(path: Path, figure: Any) -> None:
    """Writes a Matplotlib figure to a file of the format that its name ends in."""
    from drake_nonstop.studies.files import replacing_file

    with replacing_file(path) as file:
        figure.savefig(file, format=path.suffix.removeprefix("."))
