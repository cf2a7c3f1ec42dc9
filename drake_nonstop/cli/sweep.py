"""`drake-nonstop sweep`: many runs over grids and random draws."""

import argparse
import sys
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.exit_codes import FAILED, INTERRUPTED
from drake_nonstop.cli.run import run_into
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, SerialExecutor
from drake_nonstop.studies.sweep import SweepInterrupted, sweep
from drake_nonstop.studies.sweep_spec import read_sweep
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "sweep",
        help="many runs over grids and random draws of any fields: one table, a row each",
        description="Runs all that SPEC.yaml asks for; what is there of it already is not run "
        "again. Exit code 1 where a run cannot be built or one of its blocks fails; one that "
        "diverges is a result like others.",
    )
    parser.set_defaults(action=_sweep)
    add_scenario(parser, "out/sweep/NAME_SPEC")
    parser.add_argument("spec", type=Path, metavar="SPEC.yaml", help="grid, draws; see README")
    parser.add_argument(
        "--run",
        type=int,
        metavar="K",
        help="only this run, as `run` does it (results' folder: .../run_K)",
    )
    parser.add_argument(
        "--restart", action="store_true", help="drop what the folder has of a sweep"
    )
    parser.add_argument(
        "--serial", action="store_true", help="in this process, not in one per core"
    )


def _sweep(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    spec = read_sweep(options.spec)
    folder: Path = options.out or Path("out/sweep") / f"{scenario.name}_{options.spec.stem}"
    if options.run is not None:
        planned = spec.run(options.run)
        print(f"run {planned.number}: {', '.join(planned.overrides)}", flush=True)
        scenario = changed(scenario, planned.overrides, trust=options.trust)
        return run_into(options.out or folder / f"run_{planned.number}", scenario)
    try:
        with TaskProgress() as progress:
            done = sweep(
                scenario,
                spec,
                folder,
                executor=SerialExecutor() if options.serial else None,
                restart=options.restart,
                trust=options.trust,
                progress=progress,
            )
    except SweepInterrupted as interrupted:
        print(f"drake-nonstop: interrupted: {interrupted}", file=sys.stderr)
        return INTERRUPTED
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(done.outcomes.items())))
    print(f"results: {done.table}")
    return 0 if done.outcomes.keys() <= {COMPLETED, DIVERGED} else FAILED
