"""`drake-nonstop ablate`: variants of a scenario, compared."""

import argparse

from drake_nonstop.cli.arguments import Commands, add_study, read_scenario, study_folder
from drake_nonstop.cli.ending import FAILED
from drake_nonstop.studies.ablation import (
    ablate,
    ablation_settings,
    grid_names,
    name_overrides,
    read_grid,
)
from drake_nonstop.studies.ablation_report import as_text
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED
from drake_nonstop.validation import require
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "ablate",
        help="compare variants of a scenario: a table, plots, and all replays on one page",
        description="Runs the scenario as it is and each variant. Exit code 1 where a variant "
        "cannot be built or one of its blocks fails; one that diverges is a result like others.",
    )
    parser.set_defaults(action=_ablate)
    add_study(parser, "out/ablate/NAME[_GRID]")
    parser.add_argument(
        "--grid", metavar="NAME|FILE.yaml", help=f"variants: {', '.join(grid_names())}, or a file"
    )
    parser.add_argument(
        "--swap",
        nargs="+",
        action="append",
        default=[],
        metavar="BOX=BLOCK",
        help="one more variant, with these overrides together (as in --set); may be repeated",
    )
    parser.add_argument("--no-replay", action="store_true", help="write no replays")


def _ablate(options: argparse.Namespace) -> int:
    require(options.grid or options.swap, "--grid, --swap", "none", "give at least one of them")
    scenario = read_scenario(options, sampled=False)
    variants: list[tuple[str, list[str]]] = []
    name, title = scenario.name, scenario.name
    if options.grid:
        grid = read_grid(options.grid)
        variants += grid.variants.items()
        name = f"{name}_{grid.name}"
        title += f": {grid.description or grid.name}"
    for overrides in options.swap:
        for override in overrides:
            remedy = "give BOX=BLOCK, such as phase=PaperPhase"
            require("=" in override[1:], "--swap", override, remedy)
        variants.append((name_overrides(overrides), overrides))
    replay = not options.no_replay
    folder = study_folder(options, name, ablation_settings(scenario, variants, replay=replay))
    with TaskProgress() as progress:
        rows = ablate(
            scenario,
            variants,
            folder,
            title=title,
            replay=replay,
            trust=options.trust,
            restart=options.restart,
            progress=progress,
        )
    print(as_text(rows))
    print(f"results: {folder / 'index.html'}")
    return 0 if all(row.ending in (COMPLETED, DIVERGED) for row in rows) else FAILED
