"""Arguments that several subcommands share, and how they read a scenario and write results."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from drake_nonstop.scenario.schema import Scenario

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


def add_scenario(parser: argparse.ArgumentParser, folder: str = "out/NAME") -> None:
    """Adds the scenario, --out, whose default the help names, --set and --trust."""
    parser.add_argument("scenario", metavar="NAME|FILE.yaml", help="a scenario's name or file")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"results' folder ({folder})")
    add_changes(parser, "--set", "change the scenario: system.load_mass=1.2, phase=PaperPhase")
    add_trust(parser, "let it import blocks of your own, such as phase=my_blocks.MyPhase")


def add_study(parser: argparse.ArgumentParser, folder: str) -> None:
    """Adds the arguments of `add_scenario`, and --restart."""
    add_scenario(parser, folder)
    parser.set_defaults(default_folder=Path(folder).parent)
    about = "drop what the folder has of a call that was interrupted"
    parser.add_argument("--restart", action="store_true", help=about)


def study_folder(options: argparse.Namespace, name: str, settings: str) -> Path:
    """Where the results of a study go: --out, or the default folder of that name.

    With --restart that folder is taken whatever it holds.
    """
    from drake_nonstop.studies.results_folder import default_folder

    folder: Path = options.default_folder / name
    if options.out or options.restart:
        return options.out or folder
    return default_folder(folder, settings)


def read_scenario(options: argparse.Namespace, *, sampled: bool = True) -> "Scenario":
    """The scenario that the arguments of `add_scenario` name; raises ScenarioError.

    Where it is `sampled`, numbers have been drawn for its distributions.
    """
    from drake_nonstop.scenario.loading import load_scenario

    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    return scenario.sampled() if sampled else scenario


def write_figure(path: Path, figure: Any) -> None:
    """Writes a Matplotlib figure to a file of the format that its name ends in."""
    from drake_nonstop.studies.files import replacing_file

    with replacing_file(path) as file:
        figure.savefig(file, format=path.suffix.removeprefix("."))
