"""`drake-nonstop ablate`: compare variants of a scenario: a table, figures, all replays."""

import argparse
from typing import Any

from drake_nonstop.cli.arguments import (
    Commands,
    add_lists,
    add_seeds,
    add_study,
    make_study,
    read_scenario,
    result_folder,
)
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.presets import ablate, grid_names, read_grid
from drake_nonstop.studies.study import settings_of_factors
from drake_nonstop.validation import require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "ablate",
        description="Flies the scenario as it is and each variant. Exit code 1 where a variant "
        "cannot be built or one of its blocks fails; one that diverges is a result like any other.",
    )
    parser.set_defaults(action=_ablate)
    add_study(parser, "out/ablate/NAME[_GRID]")
    about = f"variants: {', '.join(grid_names())}, or a file"
    parser.add_argument("--grid", metavar="NAME|FILE.yaml", help=about)
    about = "one more variant, with these overrides together (as in --set); may be repeated"
    add_lists(parser, "--swap", "BOX=BLOCK", about)
    add_seeds(parser)
    parser.add_argument("--no-replay", action="store_true", help="keep no results of single runs")


def _ablate(options: argparse.Namespace) -> int:
    require(options.grid or options.swap, "--grid, --swap", "none", "give at least one of them")
    scenario = read_scenario(options, sampled=False)
    variants: dict[str, Any] = {}
    name, title, seeds = scenario.name, scenario.name, options.seeds
    if options.grid:
        grid = read_grid(options.grid)
        scenario = changed(scenario, grid.overrides, trust=options.trust)
        variants = {each.name: each.changes for each in settings_of_factors(grid.factors)}
        name, seeds = f"{name}_{grid.name}", seeds or grid.seeds
        title += f": {grid.description or grid.name}"
    for overrides in options.swap:
        for override in overrides:
            remedy = "give BOX=BLOCK, such as phase=PaperPhase"
            require("=" in override[1:], "--swap", override, remedy)
        variant = ", ".join(overrides)
        require(variant not in variants, "--swap", variant, "give each variant once")
        variants[variant] = overrides
    given = {"seeds": seeds, "title": title, "replay": not options.no_replay}
    folder = result_folder(options, name, scenario)
    return make_study(options, ablate, scenario, variants, folder, trust=options.trust, **given)
