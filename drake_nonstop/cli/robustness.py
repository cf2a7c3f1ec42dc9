"""`drake-nonstop robustness`: errors that the controllers do not know of."""

import argparse
import dataclasses

from drake_nonstop.cli.arguments import (
    Commands,
    add_study,
    read_scenario,
    study_folder,
    write_figure,
)
from drake_nonstop.studies.figures import make_robustness_figure
from drake_nonstop.studies.files import write_json
from drake_nonstop.studies.robustness import robustness, robustness_settings, robustness_table
from drake_nonstop.validation import require_seed
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "robustness", help="errors that the controllers do not know of, one by one"
    )
    parser.set_defaults(action=_robustness)
    add_study(parser, "out/robustness/NAME")
    parser.add_argument("--seed", type=int, default=0, help="of what is random (0)")


def _robustness(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    require_drawing()
    require_seed("--seed", options.seed)
    settings = robustness_settings(scenario, options.seed)
    folder = study_folder(options, scenario.name, settings)
    with TaskProgress() as progress:
        cases = robustness(
            scenario,
            seed=options.seed,
            folder=folder,
            restart=options.restart,
            progress=progress,
        )
    write_json(
        folder / "robustness.json",
        {"scenario": scenario.name, "cases": [dataclasses.asdict(case) for case in cases]},
    )
    write_figure(folder / "robustness.png", make_robustness_figure(scenario.name, cases))
    print(robustness_table(cases))
    print(f"results: {folder}")
    return 0
