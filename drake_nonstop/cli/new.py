"""`drake-nonstop new`: a scenario file to start from."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.scenario.commented import commented_scenario
from drake_nonstop.scenario.loading import load_scenario, parse_scenario
from drake_nonstop.validation import ScenarioError, require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "new", help="write a scenario file to start from, with every field, unit and meaning"
    )
    parser.set_defaults(action=_new)
    parser.add_argument(
        "file", type=Path, metavar="NAME[.yaml]", help="the scenario's name, and that of its file"
    )
    parser.add_argument(
        "--from",
        dest="base",
        default="quintic",
        metavar="NAME|FILE.yaml",
        help="the scenario that it copies (quintic)",
    )
    add_trust(parser, "let that one import blocks of your own")


def _new(options: argparse.Namespace) -> int:
    path: Path = options.file
    if not path.suffix:
        path = path.with_name(f"{path.name}.yaml")
    require(path.suffix in (".yaml", ".yml"), "NAME", path, "give a name that ends in .yaml")
    scenario = load_scenario(options.base, trust=options.trust)
    text = commented_scenario(scenario, path.stem)
    parse_scenario(text, str(path), trust=options.trust)  # refuses a stem that names no scenario
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ScenarioError(f"NAME = {path}: it exists; give another name") from None
    except OSError as error:
        remedy = f"give a file that can be written ({error.strerror})"
        raise ScenarioError(f"NAME = {path}: {remedy}") from None
    print(f"{path}: change it, and run it by `drake-nonstop run {path}`")
    return 0
