"""`drake-nonstop study`: fly all combinations of values, over seeds: a table, figures, bands."""

import argparse

from drake_nonstop.cli.arguments import (
    Commands,
    add_lists,
    add_seeds,
    add_study,
    make_study,
    read_scenario,
    result_folder,
)
from drake_nonstop.scenario.yaml_text import parse_plain
from drake_nonstop.studies.study import study
from drake_nonstop.validation import require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "study",
        description="Exit code 1 where a run cannot be built or one of its blocks fails.",
    )
    parser.set_defaults(action=_study)
    add_study(parser, "out/study/NAME")
    about = "a factor: a field or a box, and its values; may be repeated"
    add_lists(parser, "--vary", "PATH VALUE", about)
    add_seeds(parser)
    about = "keep the results of one run of each combination, with replays"
    parser.add_argument("--replay", action="store_true", help=about)


def _study(options: argparse.Namespace) -> int:
    require(options.vary or options.seeds, "--vary, --seeds", "none", "give at least one of them")
    scenario = read_scenario(options, sampled=False)
    factors = {}
    for path, *values in options.vary:
        require(values, "--vary", path, "give values after the path")
        factors[path] = [parse_plain(value, f"--vary {path}", path) for value in values]
    folder = result_folder(options, scenario.name, scenario)
    given = {"replay": options.replay, "trust": options.trust}
    return make_study(options, study, scenario, factors, options.seeds, folder, **given)
