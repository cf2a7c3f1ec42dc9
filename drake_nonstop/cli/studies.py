"""`drake-nonstop stability`: Floquet multipliers of the loop around a resting load, and margins.

`drake-nonstop robustness`: errors that the controllers do not know of, one by one.
`drake-nonstop ablate`: compare variants of a scenario: a table, plots, all replays on one page.
`drake-nonstop sweep`: many runs over grids and random draws of any fields, in one table.
"""

import argparse
import dataclasses
from pathlib import Path

from drake_nonstop.analysis.stability import Stability, linearize
from drake_nonstop.cli.arguments import (
    Commands,
    add_study,
    read_scenario,
    study_folder,
    write_figure,
)
from drake_nonstop.cli.ending import FAILED
from drake_nonstop.cli.run import run_into
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.ablation import (
    ablate,
    ablation_settings,
    grid_names,
    name_overrides,
    read_grid,
)
from drake_nonstop.studies.ablation_report import as_text
from drake_nonstop.studies.figures import make_margins_figure, make_robustness_figure
from drake_nonstop.studies.files import require_writable, write_json
from drake_nonstop.studies.robustness import robustness, robustness_settings, robustness_table
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, Progress, SerialExecutor
from drake_nonstop.studies.stability_ranges import Margin, find_margins, margins_settings
from drake_nonstop.studies.sweep import sweep, sweep_settings
from drake_nonstop.studies.sweep_spec import read_sweep
from drake_nonstop.studies.variants import labels, varied
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, message_of, require, require_seed
from drake_nonstop.view.figure_style import require_drawing
from drake_nonstop.view.progress import TaskProgress

_FINE_STEP = 0.001  # s, at which integrators damp nothing that matters here


def add_to(commands: Commands) -> None:
    """Adds the subcommands."""
    parser = commands.add_parser(
        "stability",
        help="Floquet multipliers of the loop around a resting load, and margins",
        description="Linearizes the loop around a resting load at some 60 to 110 settings, in a "
        "process per core: one or two minutes on two cores, several where it is unstable. The "
        "loop as it is comes first, and the blocks that its least stable mode is in; a "
        "setting with which it cannot be built is a row that says so. Interrupted, the same "
        "command continues.",
    )
    parser.set_defaults(action=_stability)
    add_study(parser, "out/stability/NAME")
    about = "print what is said of the loop as it is, and end: seconds; writes nothing"
    parser.add_argument("--quick", action="store_true", help=about)
    parser = commands.add_parser(
        "robustness", help="errors that the controllers do not know of, one by one"
    )
    parser.set_defaults(action=_robustness)
    add_study(parser, "out/robustness/NAME")
    parser.add_argument("--seed", type=int, default=0, help="of what is random (0)")
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


def _stability(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    if not options.quick:
        require_drawing()
        folder = study_folder(options, scenario.name, margins_settings(scenario))
        require_writable(folder)
    with TaskProgress() as progress:
        found = _linearized(scenario, progress)
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    told = ", ".join(f"{name} {share:.0%}" for name, share in shares if share > 0.005)
    print(
        f"largest multiplier     {found.largest:.4g} in a turn of {found.period:.3g} s "
        f"({found.rate:+.3g} 1/s): {'stable' if found.is_stable else 'unstable'}\n"
        f"least stable mode      {told}, {found.frequency:.3g} rad/s",
        flush=True,  # the rest takes a minute, or several
    )
    if options.quick:
        return 0
    fine_step = min(_FINE_STEP, scenario.simulator_config.max_step_size)
    fine = changed(scenario, [f"simulator_config.max_step_size={fine_step}"], trust=options.trust)
    with TaskProgress() as progress:
        found_finely = _linearized(fine, progress)
        margins = find_margins(scenario, progress, folder=folder, restart=options.restart)
    write_json(
        folder / "stability.json",
        {
            "scenario": scenario.name,
            "period_s": found.period,
            "largest_multiplier": found.largest,
            "rate_1_s": found.rate,
            "largest_multiplier_at_fine_step": found_finely.largest,
            "fine_step_s": fine_step,
            "margins": [dataclasses.asdict(margin) for margin in margins],
        },
    )
    write_figure(folder / "stability.png", make_margins_figure(scenario.name, margins))
    print(
        f"with steps of {fine_step * 1e3:g} ms     {found_finely.largest:.4g}: "
        f"{'stable' if found_finely.is_stable else 'unstable'}"
    )
    if found.is_stable and not found_finely.is_stable:
        print("warning: the loop is stable by the damping of the integrator's step alone")
    for margin in margins:
        name = f"{margin.name}, {margin.unit}"
        range_ = _stable_range(margin) if found.is_stable else "unstable here"
        print(f"{name:22} {margin.nominal:.4g}, {range_}")
        for value, reason in margin.refused.items():
            print(f"{'':22} {value:.4g} is refused: {reason}")
    print(f"results: {folder}")
    return 0


def _linearized(scenario: Scenario, progress: Progress) -> Stability:
    try:
        return linearize(scenario, progress)
    except (ScenarioError, NotFiniteError) as error:
        raise ScenarioError(f"stability: {message_of(error)}") from None


def _stable_range(margin: Margin) -> str:
    """From where to where the loop is stable, as far as values of the parameter were tried."""
    if margin.nominal in margin.refused:
        return "refused here"
    ends = [
        f"{value:.4g}" if edge is None else f"{edge:.4g}"
        for edge, value in ((margin.low, margin.values[0]), (margin.high, margin.values[-1]))
    ]
    untried = [
        f"{side} that {'refused' if any(map(is_beyond, margin.refused)) else 'not tried'}"
        for side, edge, is_beyond in (
            ("below", margin.low, margin.values[0].__gt__),
            ("above", margin.high, margin.values[-1].__lt__),
        )
        if edge is None
    ]
    return f"stable from {' to '.join(ends)}{''.join(f', {text}' for text in untried)}"


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
