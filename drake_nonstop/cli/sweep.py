"""`drake-nonstop sweep`: fly the study that a file describes."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import (
    Commands,
    add_study,
    make_study,
    read_scenario,
    result_folder,
)
from drake_nonstop.cli.run import run_into
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.presets import read_grid, sweep
from drake_nonstop.studies.study import listed_seeds, planned_calls, settings_of_factors
from drake_nonstop.validation import require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "sweep",
        description="Exit code 1 where a run cannot be built or one of its blocks fails.",
    )
    parser.set_defaults(action=_sweep)
    add_study(parser, "out/sweep/NAME_SPEC")
    parser.add_argument("spec", type=Path, metavar="SPEC.yaml", help="see docs/sweep.md")
    about = "only this run, as `run` does it (results' folder: .../run_K)"
    parser.add_argument("--run", type=int, metavar="K", help=about)


def _sweep(options: argparse.Namespace) -> int:
    scenario = read_scenario(options, sampled=False)
    grid = read_grid(options.spec, "SPEC")
    base = changed(scenario, grid.overrides, trust=options.trust)
    folder = result_folder(options, f"{scenario.name}_{options.spec.stem}", base)
    if options.run is None:
        return make_study(options, sweep, scenario, grid, folder, trust=options.trust)
    settings = settings_of_factors(grid.factors)
    calls = planned_calls(base, settings, listed_seeds(grid.seeds), options.trust)
    require(0 <= options.run < len(calls), "--run", options.run, f"give 0 to {len(calls) - 1}")
    made, _, _ = calls[options.run].scenario()
    return run_into(options.out or folder / f"run_{options.run}", made.sampled())
