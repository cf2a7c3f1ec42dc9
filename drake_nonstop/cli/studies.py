"""`drake-nonstop stability`: Floquet multipliers of the loop around a resting load.

`drake-nonstop robustness`: errors that the controllers do not know of, one by one.
`drake-nonstop ablate`: compare variants of a scenario: a table, figures, all replays on one page.
`drake-nonstop study`: every combination of some values, over seeds: a table, figures with bands.
`drake-nonstop sweep`: a study that a file asks for.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drake_nonstop.analysis.stability import linearize
from drake_nonstop.cli.arguments import Commands, add_study, read_scenario, study_folder
from drake_nonstop.cli.ending import FAILED
from drake_nonstop.cli.run import run_into
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.scenario.yaml_text import parse_plain
from drake_nonstop.studies.attempts import COMPLETED, DIVERGED
from drake_nonstop.studies.presets import (
    ablate,
    grid_names,
    name_overrides,
    read_grid,
    robustness,
    stability_ranges,
    sweep,
)
from drake_nonstop.studies.study import Study, planned_calls, study, study_settings
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, require
from drake_nonstop.view.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommands."""
    parser = commands.add_parser(
        "stability", help="Floquet multipliers of the loop around a resting load"
    )
    parser.set_defaults(action=_stability)
    add_study(parser, "out/stability/NAME")
    about = "also over ranges of the carriers' mass and gains, the delay and the control period"
    parser.add_argument("--ranges", action="store_true", help=about)
    parser = commands.add_parser(
        "robustness", help="errors that the controllers do not know of, one by one"
    )
    parser.set_defaults(action=_robustness)
    add_study(parser, "out/robustness/NAME")
    _add_seeds(parser)
    parser = commands.add_parser(
        "ablate",
        help="compare variants of a scenario: a table, figures, and all replays on one page",
        description="Flies the scenario as it is and each variant. Exit code 1 where a variant "
        "cannot be built or one of its blocks fails; one that diverges is a result like others.",
    )
    parser.set_defaults(action=_ablate)
    add_study(parser, "out/ablate/NAME[_GRID]")
    about = f"variants: {', '.join(grid_names())}, or a file"
    parser.add_argument("--grid", metavar="NAME|FILE.yaml", help=about)
    about = "one more variant, with these overrides together (as in --set); may be repeated"
    _add_lists(parser, "--swap", "BOX=BLOCK", about)
    _add_seeds(parser)
    parser.add_argument("--no-replay", action="store_true", help="write no replays")
    parser = commands.add_parser(
        "study",
        help="every combination of some values, over seeds: a table, figures with bands",
        description="Exit code 1 where a run cannot be built or one of its blocks fails.",
    )
    parser.set_defaults(action=_study)
    add_study(parser, "out/study/NAME")
    about = "a factor: a field or a box, and its values; may be repeated"
    _add_lists(parser, "--vary", "PATH VALUE", about)
    _add_seeds(parser)
    about = "keep the results of one run of each combination, with replays"
    parser.add_argument("--replay", action="store_true", help=about)
    parser = commands.add_parser(
        "sweep",
        help="a study that a file asks for",
        description="Exit code 1 where a run cannot be built or one of its blocks fails.",
    )
    parser.set_defaults(action=_sweep)
    add_study(parser, "out/sweep/NAME_SPEC")
    parser.add_argument("spec", type=Path, metavar="SPEC.yaml", help="see docs/sweep.md")
    about = "only this run, as `run` does it (results' folder: .../run_K)"
    parser.add_argument("--run", type=int, metavar="K", help=about)


def _add_seeds(parser: argparse.ArgumentParser) -> None:
    about = "runs of each, which differ in noise, gusts and draws (the scenario's own seed)"
    parser.add_argument("--seeds", type=int, metavar="N", help=about)


def _add_lists(parser: argparse.ArgumentParser, name: str, metavar: str, about: str) -> None:
    more: dict[str, Any] = {"nargs": "+", "action": "append", "default": []}
    parser.add_argument(name, metavar=metavar, help=about, **more)


def _stability(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    try:
        with TaskProgress() as progress:
            found = linearize(scenario, progress)
    except (ScenarioError, NotFiniteError) as error:
        raise ScenarioError(f"stability: {error!s}") from None
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    told = ", ".join(f"{name} {share:.0%}" for name, share in shares if share > 0.005)
    print(
        f"largest multiplier     {found.largest:.4g} in a turn of {found.period:.3g} s "
        f"({found.rate:+.3g} 1/s): {'stable' if found.is_stable else 'unstable'}\n"
        f"least stable mode      {told}, {found.frequency:.3g} rad/s",
        flush=True,
    )
    if not options.ranges:
        return 0
    folder = _folder(options, scenario.name, scenario, "linearize_each")
    _shown(lambda **how: stability_ranges(scenario, folder, **how), options)
    return 0


def _robustness(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    folder = _folder(options, scenario.name, scenario)
    _shown(lambda **how: robustness(scenario, folder, seeds=options.seeds, **how), options)
    return 0


def _ablate(options: argparse.Namespace) -> int:
    require(options.grid or options.swap, "--grid, --swap", "none", "give at least one of them")
    scenario = read_scenario(options, sampled=False)
    variants: list[tuple[str, Any]] = []
    name, title, seeds = scenario.name, scenario.name, options.seeds
    if options.grid:
        grid = read_grid(options.grid)
        scenario = changed(scenario, grid.overrides, trust=options.trust)
        variants += grid.named().items()
        name, seeds = f"{name}_{grid.name}", seeds or grid.seeds
        title += f": {grid.description or grid.name}"
    for overrides in options.swap:
        for override in overrides:
            remedy = "give BOX=BLOCK, such as phase=PaperPhase"
            require("=" in override[1:], "--swap", override, remedy)
        variants.append((name_overrides(overrides), overrides))
    given: dict[str, Any] = {"seeds": seeds, "title": title, "replay": not options.no_replay}
    given["trust"] = options.trust
    folder = _folder(options, name, scenario)
    return _shown(lambda **how: ablate(scenario, variants, folder, **given, **how), options)


def _study(options: argparse.Namespace) -> int:
    require(options.vary or options.seeds, "--vary, --seeds", "none", "give at least one of them")
    scenario = read_scenario(options, sampled=False)
    factors: dict[str, list[Any]] = {}
    for path, *values in options.vary:
        require(values, "--vary", path, "give values after the path")
        factors[path] = [parse_plain(value, f"--vary {path}", path) for value in values]
    given: dict[str, Any] = {"replay": options.replay, "trust": options.trust}
    folder = _folder(options, scenario.name, scenario)
    return _shown(
        lambda **how: study(scenario, factors, options.seeds, folder, **given, **how), options
    )


def _sweep(options: argparse.Namespace) -> int:
    scenario = read_scenario(options, sampled=False)
    grid = read_grid(options.spec, "SPEC")
    base = changed(scenario, grid.overrides, trust=options.trust)
    folder = _folder(options, f"{scenario.name}_{options.spec.stem}", base)
    if options.run is not None:
        calls = planned_calls(base, grid.settings, grid.seeds, trust=options.trust)
        require(0 <= options.run < len(calls), "--run", options.run, f"give 0 to {len(calls) - 1}")
        made, _, _ = calls[options.run].scenario()
        return run_into(options.out or folder / f"run_{options.run}", made.sampled())
    given: dict[str, Any] = {"trust": options.trust}
    return _shown(lambda **how: sweep(scenario, grid, folder, **given, **how), options)


def _folder(
    options: argparse.Namespace, name: str, scenario: Scenario, kind: str = "flights"
) -> Path:
    return study_folder(options, name, study_settings(kind, dump_scenario(scenario)))


def _shown(make: Callable[..., Study], options: argparse.Namespace) -> int:
    """Makes a study and prints its table; returns the exit code."""
    with TaskProgress() as progress:
        made = make(restart=options.restart, progress=progress)
    assert made.folder is not None
    print(made)
    print(f"results: {made.folder / 'index.html'}")
    return 0 if {*made.table["ending"]} <= {COMPLETED, DIVERGED} else FAILED
