"""`drake-nonstop robustness`: errors that the controllers do not know of."""

import argparse
import dataclasses
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.progress import TaskProgress
from drake_nonstop.studies.results_folder import replacing_file, require_writable, write_json
from drake_nonstop.studies.robustness import robustness
from drake_nonstop.validation import require_seed
from drake_nonstop.visualization.plots import make_robustness_figure


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "robustness", help="errors that the controllers do not know of, one by one"
    )
    parser.set_defaults(action=_robustness)
    add_scenario(parser)
    parser.add_argument("--seed", type=int, default=0, help="of what is random (0)")


def _robustness(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    require_seed("--seed", options.seed)
    folder: Path = options.out or Path("out") / scenario.name
    require_writable(folder)
    with TaskProgress() as progress:
        cases = robustness(scenario, seed=options.seed, progress=progress)
    write_json(
        folder / "robustness.json",
        {"scenario": scenario.name, "cases": [dataclasses.asdict(case) for case in cases]},
    )
    with replacing_file(folder / "robustness.png") as file:
        make_robustness_figure(scenario.name, cases).savefig(file, format="png", dpi=150)
    columns = "e_p mean / final, mm", "slowest - bound", "below", "slack"
    print("{:42} {:>20} {:>16} {:>8} {:>8}".format("error", *columns))
    for case in cases:
        name = f"{case.error} {case.level:+g} {case.unit}" if case.unit else "none"
        errors = f"{1e3 * case.position_error_mean:.3g} / {1e3 * case.position_error_final:.3g}"
        print(
            f"{name:42} {errors:>20} {case.speed_margin:+12.3f} m/s {case.time_below_bound:6.3g} s "
            f"{case.slack_time:6.3g} s{'' if case.completed else '  diverged'}"
        )
    print(f"results: {folder}")
    return 0
