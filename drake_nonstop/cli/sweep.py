"""`drake-nonstop sweep`: many runs over grids and random draws."""

import argparse
import dataclasses
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_study, read_scenario, study_folder
from drake_nonstop.cli.ending import FAILED
from drake_nonstop.cli.run import run_into
from drake_nonstop.scenario.schema import AUTO, COMPILED
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, SerialExecutor
from drake_nonstop.studies.sweep import sweep, sweep_settings
from drake_nonstop.studies.sweep_spec import read_sweep
from drake_nonstop.studies.variants import labels, varied
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
    add_study(parser, "out/sweep/NAME_SPEC")
    parser.add_argument("spec", type=Path, metavar="SPEC.yaml", help="see docs/sweep.md")
    parser.add_argument(
        "--run",
        type=int,
        metavar="K",
        help="only this run, as `run` does it (results' folder: .../run_K)",
    )
    parser.add_argument(
        "--serial", action="store_true", help="in this process, not in one per core"
    )


def _sweep(options: argparse.Namespace) -> int:
    scenario = read_scenario(options, sampled=False)
    spec = read_sweep(options.spec)
    name = f"{scenario.name}_{options.spec.stem}"
    folder = study_folder(options, name, sweep_settings(scenario, spec))
    if options.run is not None:
        planned = spec.run(options.run)
        print(f"run {planned.number}: {', '.join(labels(planned.overrides))}", flush=True)
        scenario, _ = varied(scenario, planned.overrides, trust=options.trust)
        scenario = scenario.sampled()
        if scenario.engine == AUTO:  # as in the sweep, to the bit
            scenario = dataclasses.replace(scenario, engine=COMPILED)
        return run_into(options.out or folder / f"run_{planned.number}", scenario)
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
    print(done.summary())
    print(f"results: {done.table}")
    return 0 if done.endings.keys() <= {COMPLETED, DIVERGED} else FAILED
