"""The command `drake-nonstop`."""

import argparse
import contextlib
import dataclasses
import os
import sys
import textwrap
import threading
import time
import warnings
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from drake_nonstop.cli.file_server import serve_folder
from drake_nonstop.scenario.describe import Parameter, Port, box_names, describe
from drake_nonstop.scenario.loading import Scenario, changed, load_scenario, scenario_names
from drake_nonstop.simulation.metrics import find_warnings, metrics_table
from drake_nonstop.simulation.simulate import Run, RunInterrupted, RunStopped, simulate
from drake_nonstop.studies.ablation import ablate, as_text, grid_names, name_settings, read_grid
from drake_nonstop.studies.figures import make_margins_figure, make_robustness_figure
from drake_nonstop.studies.files import replacing_file, require_writable, write_json
from drake_nonstop.studies.margins import find_margins
from drake_nonstop.studies.results_folder import write_results
from drake_nonstop.studies.robustness import robustness, robustness_table
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, SerialExecutor
from drake_nonstop.studies.stability import linearize
from drake_nonstop.studies.sweep import SweepInterrupted, sweep
from drake_nonstop.studies.sweep_spec import read_sweep
from drake_nonstop.validation import (
    ScenarioError,
    ScenarioWarning,
    require,
    require_seed,
    show_warning,
)
from drake_nonstop.version import __version__
from drake_nonstop.visualization.live import run_live
from drake_nonstop.visualization.meshcat_server import start_meshcat

_FINE_STEP = 0.001  # s, at which integrators damp nothing that matters here
_LINE, _WIDEST = 100, 30  # characters, of the lines and of a column of `blocks`
FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130  # exit codes; 130 is the shell's for Ctrl-C


def main(arguments: list[str] | None = None) -> int:
    """Runs the command with the given or the process's arguments; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("once", ScenarioWarning)
            warnings.showwarning = show_warning
            return options.action(options)
    except ScenarioError as error:
        print(f"drake-nonstop: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("drake-nonstop: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # whoever read the output has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drake-nonstop",
        description="Simulate carriers that fly a load on cables without ever stopping.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    lister = commands.add_parser("list", help="list the scenarios")
    lister.set_defaults(action=_list)
    blocks = commands.add_parser(
        "blocks", help="what each box of the figure can be: blocks, parameters, ports"
    )
    blocks.set_defaults(action=_blocks)
    blocks.add_argument("box", nargs="?", metavar="BOX", help="this one only, such as phase")
    run = commands.add_parser("run", help="run a scenario and write its results")
    run.set_defaults(action=_run)
    _add_scenario(run)
    run.add_argument("--no-figures", action="store_true", help="write no figures/")
    run.add_argument("--no-replay", action="store_true", help="write no replay.html")
    run.add_argument(
        "--live", action="store_true", help="show it in Meshcat while it runs, with controls"
    )
    run.add_argument(
        "--realtime",
        type=float,
        metavar="RATE",
        help="simulated s per s of a live run (1; 0: free)",
    )
    run.add_argument("--port", type=int, help="of the live page (any from 7000 that is free)")
    run.add_argument("--quiet", action="store_true", help="print errors only")
    view = commands.add_parser("view", help="watch the replay of a run")
    view.set_defaults(action=_view)
    view.add_argument("folder", type=Path, metavar="DIR", help="the results of `run`")
    view.add_argument("--port", type=int, default=0, help="to serve it on (any that is free)")
    view.add_argument("--no-open", action="store_true", help="leave opening it to you")
    stability = commands.add_parser(
        "stability", help="Floquet multipliers of the loop around a resting load, and margins"
    )
    stability.set_defaults(action=_stability)
    _add_scenario(stability)
    robust = commands.add_parser(
        "robustness", help="errors that the controllers do not know of, one by one"
    )
    robust.set_defaults(action=_robustness)
    _add_scenario(robust)
    robust.add_argument("--seed", type=int, default=0, help="of what is random (0)")
    ablation = commands.add_parser(
        "ablate",
        help="compare variants of a scenario: a table, plots, and all replays on one page",
        description="Runs the scenario as it is and each variant. Exit code 1 where a variant "
        "cannot be built or one of its blocks fails; one that diverges is a result like others.",
    )
    ablation.set_defaults(action=_ablate)
    _add_scenario(ablation, "out/ablate/NAME[_GRID]")
    ablation.add_argument(
        "--grid", metavar="NAME|FILE.yaml", help=f"variants: {', '.join(grid_names())}, or a file"
    )
    ablation.add_argument(
        "--swap",
        nargs="+",
        action="append",
        default=[],
        metavar="BOX=BLOCK",
        help="one more variant, with these settings together (as in --set); may be repeated",
    )
    ablation.add_argument("--no-replay", action="store_true", help="write no replays")
    sweeper = commands.add_parser(
        "sweep",
        help="many runs over grids and random draws of any fields: one table, a row each",
        description="Runs all that SPEC.yaml asks for; what is there of it already is not run "
        "again. Exit code 1 where a run cannot be built or one of its blocks fails; one that "
        "diverges is a result like others.",
    )
    sweeper.set_defaults(action=_sweep, live=False, quiet=False, realtime=None, port=None)
    sweeper.set_defaults(no_figures=False, no_replay=False)
    _add_scenario(sweeper, "out/sweep/NAME_SPEC")
    sweeper.add_argument("spec", type=Path, metavar="SPEC.yaml", help="grid, draws; see README")
    sweeper.add_argument(
        "--run",
        type=int,
        metavar="K",
        help="only this run, as `run` does it (results' folder: .../run_K)",
    )
    sweeper.add_argument(
        "--restart", action="store_true", help="drop what the folder has of a sweep"
    )
    sweeper.add_argument(
        "--serial", action="store_true", help="in this process, not in one per core"
    )
    pictures = commands.add_parser("pictures", help="take the README's pictures of the line task")
    pictures.set_defaults(action=_pictures)
    pictures.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/pictures"), help="(out/pictures)"
    )
    report = commands.add_parser(
        "report", help="measure every number that the README prints, and take its pictures"
    )
    report.set_defaults(action=_report_claims)
    report.add_argument(
        "--readme", type=Path, metavar="FILE", default=Path("README.md"), help="(README.md)"
    )
    report.add_argument("--out", type=Path, metavar="DIR", default=Path("out/report"))
    report.add_argument(
        "--quick",
        action="store_true",
        help="the runs only: no pictures, no solvers' benchmark, no tests/evals",
    )
    bench = commands.add_parser("bench", help="measure speed and quality")
    benches = bench.add_subparsers(required=True, metavar="WHAT")
    optimizer = benches.add_parser(
        "optimizer", help="the solvers of the optimization layer, on random and recorded problems"
    )
    optimizer.set_defaults(action=_bench_optimizer)
    optimizer.add_argument("--instances", type=int, default=1000, metavar="N", help="(1000)")
    optimizer.add_argument("--seed", type=int, default=0, help="of the instances (0)")
    optimizer.add_argument(
        "--solvers", nargs="+", metavar="NAME", default=[], help="these only, of all in the table"
    )
    optimizer.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/bench"), help="(out/bench)"
    )
    viewer = benches.add_parser("viewer", help="what a live view of a scenario costs")
    viewer.set_defaults(action=_bench_viewer)
    _add_scenario(viewer)
    running = benches.add_parser(
        "run",
        help="how fast a scenario runs and where the time goes, or faster than with what",
        description="Times a scenario and its blocks. With --against or --against-revision it is "
        "run in turns with itself otherwise, for a ratio that other load on the machine spares.",
    )
    running.set_defaults(action=_bench_run)
    _add_scenario(running, "out/bench")
    _add_repeats(running, 5)
    running.add_argument(
        "--against",
        nargs="+",
        action="extend",
        default=[],
        metavar="PATH=VALUE",
        help="compare with these settings besides, as in --set",
    )
    running.add_argument(
        "--against-revision",
        metavar="REV",
        help="compare with this git revision of the checkout",
    )
    accuracy = benches.add_parser(
        "accuracy", help="how fast and how exact a scenario's run is, by integrator and step"
    )
    accuracy.set_defaults(action=_bench_accuracy)
    _add_scenario(accuracy, "out/bench", default="quintic")
    _add_repeats(accuracy, 3)
    scale = benches.add_parser(
        "scale", help="how a scenario's speed falls with the number of carriers"
    )
    scale.set_defaults(action=_bench_scale)
    _add_scenario(scale, "out/bench", default="quintic")
    _add_repeats(scale, 3)
    scale.add_argument("--max-n", type=int, default=64, metavar="N", help="carriers, at most (64)")
    scale.add_argument("--duration", type=float, default=3.0, metavar="S", help="of a run (3)")
    return parser


def _add_repeats(parser: argparse.ArgumentParser, default: int) -> None:
    parser.add_argument(
        "--repeats",
        type=int,
        default=default,
        metavar="N",
        help=f"of each run; medians are taken ({default})",
    )


def _add_scenario(
    parser: argparse.ArgumentParser, folder: str = "out/NAME", default: str | None = None
) -> None:
    parser.add_argument(
        "scenario",
        metavar="NAME|FILE.yaml",
        nargs=None if default is None else "?",
        default=default,
        help=f"a scenario's name or file{'' if default is None else f' ({default})'}",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"results' folder ({folder})")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="PATH=VALUE",
        help="change the scenario: system.load_mass=1.2, phase=PaperPhase",
    )
    parser.add_argument(
        "--trust",
        action="store_true",
        help="let it import blocks of your own, such as phase=my_blocks.MyPhase",
    )


def _list(options: argparse.Namespace) -> int:
    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:{width}}  {load_scenario(name).description}")
    return 0


def _blocks(options: argparse.Namespace) -> int:
    names = box_names() if options.box is None else [options.box]
    boxes = [describe(name) for name in names]
    print("Sizes are in brackets, for n carriers and m internal-force coordinates.")
    for box in boxes:
        needed = _ports([port for port in box.signals if not port.is_optional])
        optional = _ports([port for port in box.signals if port.is_optional])
        signals = f" -> {needed}{f'; optional {optional}' if optional else ''}" if needed else ""
        print(f"\n{box.name}{signals}")
        for i, choice in enumerate(box.choices):
            print(f"\n  {choice.name}{' (default)' if i == 0 else ''}")
            _print_wrapped(choice.summary, "    ")
            for label, ports in (("in", choice.inputs), ("out", choice.outputs)):
                if ports:
                    _print_wrapped(_ports(ports), f"    {label:3}  ")
            if choice.unbuildable:
                _print_wrapped(f"not with its defaults: {choice.unbuildable}", "    ")
            _print_parameters(choice.parameters)
    return 0


def _ports(ports: Sequence[Port]) -> str:
    return ", ".join(f"{port.name} ({port.size})" for port in ports)


def _print_parameters(parameters: Sequence[Parameter]) -> None:
    """A line for each parameter, its unit and meaning in a column of their own.

    A name, type or default that is wider than a column pushes them to the next line.
    """
    widths = [
        max((len(text) for text in column if len(text) <= _WIDEST), default=0)
        for column in zip(*((p.name, p.type, p.default) for p in parameters), strict=True)
    ]
    for parameter in parameters:
        cells = (parameter.name, parameter.type, parameter.default)
        start = "".join(f"{cell:{width}}  " for cell, width in zip(cells, widths, strict=True))
        start, indent = f"    {start}", sum(widths) + 10
        if len(start) > indent:
            print(start.rstrip())
            start = " " * indent
        _print_wrapped(parameter.meaning, start)


def _print_wrapped(text: str, start: str) -> None:
    """The text after its start, in lines that fit, the later ones below the first's text."""
    lines = textwrap.wrap(text, _LINE - len(start), break_on_hyphens=False) or [""]
    for line in lines:
        print(f"{start}{line}".rstrip())
        start = " " * len(start)


def _run(options: argparse.Namespace) -> int:
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    for name in ("realtime", "port"):
        value = getattr(options, name)
        require(options.live or value is None, f"--{name}", value, "give --live with it")
    return _run_into(options.out or Path("out") / scenario.name, scenario, options)


def _run_into(folder: Path, scenario: Scenario, options: argparse.Namespace) -> int:
    is_new = not folder.exists()
    bar = None if options.quiet else _RunProgress(scenario)
    try:
        require_writable(folder)
        for run in _runs(scenario, options, bar):
            if bar is not None:
                bar.close()
            metrics = _write(run, folder, options)
            if not options.quiet:
                _report(metrics, run.scenario, folder)
                if options.live:
                    print(
                        "while a page is open: restart or stop there; Ctrl-C ends it",
                        flush=True,
                    )
        return 0
    except ScenarioError:
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
    except RunStopped as stopped:
        run, code, message = stopped.run, FAILED, str(stopped)
    except RunInterrupted as interrupted:
        run, code, message = interrupted.run, INTERRUPTED, "interrupted"
    finally:
        if bar is not None:
            bar.close()
    print(f"drake-nonstop: {message}", file=sys.stderr)
    if len(run.time) > 0:
        metrics = _write(run, folder, options)
        print(
            f"drake-nonstop: the results up to {metrics['simulated_s']:.3f} s are in {folder}",
            file=sys.stderr,
        )
    return code


def _runs(
    scenario: Scenario, options: argparse.Namespace, progress: "_RunProgress | None"
) -> Iterator[Run]:
    """The run that was asked for, or, live, all that are asked for in the page."""
    if not options.live:
        yield simulate(scenario, progress=progress)
        return
    meshcat = start_meshcat(options.port)
    print(f"watch and steer it at {meshcat.web_url()}", flush=True)
    rate = 1.0 if options.realtime is None else options.realtime
    yield from run_live(scenario, meshcat, realtime_rate=rate, progress=progress)


def _write(run: Run, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    return write_results(run, folder, figures=not options.no_figures, replay=not options.no_replay)


def _report(metrics: dict[str, Any], scenario: Scenario, folder: Path) -> None:
    print(_table(metrics))
    if metrics["is_steered"]:
        print("steered while it ran: scenario.yaml alone does not repeat it")
    for warning in _warnings(metrics, scenario):
        print(f"warning: {warning}")
    print(f"results: {folder}")


def _view(options: argparse.Namespace) -> int:
    page = options.folder / "replay.html"
    require(page.is_file(), "DIR", options.folder, "give a folder that `run` left a replay.html in")
    with serve_folder(options.folder, options.port) as address:
        address = f"{address}/replay.html"
        print(f"{address} (Ctrl-C ends it)", flush=True)
        if not options.no_open:
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    return 0


def _stability(options: argparse.Namespace) -> int:
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    folder: Path = options.out or Path("out") / scenario.name
    require_writable(folder)
    fine_step = min(_FINE_STEP, scenario.simulator.max_step_size)
    fine = changed(scenario, [f"simulator.max_step_size={fine_step}"], trust=options.trust)
    with contextlib.closing(_ProgressLine()) as line:
        found, found_finely = linearize(scenario), linearize(fine)
        margins = find_margins(scenario, progress=line.show_share)
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
    with replacing_file(folder / "stability.png") as file:
        make_margins_figure(scenario.name, margins).savefig(file, format="png", dpi=150)
    verdict = "stable" if found.is_stable else "unstable"
    print(
        f"largest multiplier     {found.largest:.4g} in a turn of {found.period:.3g} s "
        f"({found.rate:+.3g} 1/s): {verdict}"
    )
    print(
        f"with steps of {fine_step * 1e3:g} ms     {found_finely.largest:.4g}: "
        f"{'stable' if found_finely.is_stable else 'unstable'}"
    )
    if found.is_stable and not found_finely.is_stable:
        print("warning: the loop is stable by the damping of the integrator's step alone")
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    print(
        "least stable mode      "
        + ", ".join(f"{name} {share:.0%}" for name, share in shares if share > 0.005)
        + f", {found.frequency:.3g} rad/s"
    )
    for margin in margins:
        low, high = (
            "no end" if value is None else f"{value:.4g}" for value in (margin.low, margin.high)
        )
        name = f"{margin.name}, {margin.unit}"
        is_stable = found.is_stable
        print(
            f"{name:22} {margin.nominal:.4g}, "
            + (f"stable from {low} to {high}" if is_stable else "unstable here")
        )
    print(f"results: {folder}")
    return 0


def _robustness(options: argparse.Namespace) -> int:
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    require_seed("--seed", options.seed)
    folder: Path = options.out or Path("out") / scenario.name
    require_writable(folder)
    with contextlib.closing(_ProgressLine()) as line:
        cases = robustness(scenario, seed=options.seed, progress=line.show_share)
    write_json(
        folder / "robustness.json",
        {"scenario": scenario.name, "cases": [case.as_json() for case in cases]},
    )
    with replacing_file(folder / "robustness.png") as file:
        make_robustness_figure(scenario.name, cases).savefig(file, format="png", dpi=150)
    print(robustness_table(cases))
    print(f"results: {folder}")
    return 0


def _ablate(options: argparse.Namespace) -> int:
    require(options.grid or options.swap, "--grid, --swap", "none", "give at least one of them")
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    variants: list[tuple[str, list[str]]] = []
    name, title = scenario.name, scenario.name
    if options.grid:
        grid = read_grid(options.grid)
        variants += grid.variants.items()
        name = f"{name}_{grid.name}"
        title += f": {grid.description or grid.name}"
    for settings in options.swap:
        for setting in settings:
            remedy = "give BOX=BLOCK, such as phase=PaperPhase"
            require("=" in setting[1:], "--swap", setting, remedy)
        variants.append((name_settings(settings), settings))
    folder: Path = options.out or Path("out/ablate") / name
    with contextlib.closing(_ProgressLine()) as line:
        rows = ablate(
            scenario,
            variants,
            folder,
            title=title,
            replay=not options.no_replay,
            trust=options.trust,
            progress=line.show_share,
        )
    print(as_text(rows))
    print(f"results: {folder / 'index.html'}")
    return 0 if all(row.outcome in (COMPLETED, DIVERGED) for row in rows) else FAILED


def _sweep(options: argparse.Namespace) -> int:
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    spec = read_sweep(options.spec)
    folder: Path = options.out or Path("out/sweep") / f"{scenario.name}_{options.spec.stem}"
    if options.run is not None:
        planned = spec.run(options.run)
        print(f"run {planned.number}: {', '.join(planned.overrides)}", flush=True)
        scenario = changed(scenario, planned.overrides, trust=options.trust)
        return _run_into(options.out or folder / f"run_{planned.number}", scenario, options)
    try:
        with contextlib.closing(_ProgressLine()) as line:
            done = sweep(
                scenario,
                spec,
                folder,
                executor=SerialExecutor() if options.serial else None,
                restart=options.restart,
                trust=options.trust,
                progress=line.show_share,
            )
    except SweepInterrupted as interrupted:
        print(f"drake-nonstop: interrupted: {interrupted}", file=sys.stderr)
        return INTERRUPTED
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(done.outcomes.items())))
    print(f"results: {done.table}")
    return 0 if done.outcomes.keys() <= {COMPLETED, DIVERGED} else FAILED


def _report_claims(options: argparse.Namespace) -> int:
    # Imported here: other commands need none of it.
    from drake_nonstop.benchmarks import claims as report

    try:
        text = options.readme.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        remedy = f"run it in a checkout, or give the file ({error})"
        raise ScenarioError(f"--readme = {options.readme}: {remedy}") from None
    claims = report.read_claims(text)
    require_writable(options.out)
    with contextlib.closing(_ProgressLine()) as line:
        measured = report.measure(claims, progress=line.show_share)
    table = report.as_markdown(measured)
    failed = [
        f"{claim.arguments}: {claim.quantity} = {value:.4g}, not {claim.printed}"
        for claim, value in measured.items()
        if not claim.holds(value)
    ]
    if not options.quick:
        from drake_nonstop.benchmarks.optimizer import benchmark_optimizer
        from drake_nonstop.benchmarks.optimizer import table as solvers_table
        from drake_nonstop.benchmarks.pictures import make_pictures

        with contextlib.closing(_ProgressLine()) as line:
            make_pictures(options.out, progress=line.show_share)
            results = benchmark_optimizer(1000, 0, [], progress=line.show_share)
        table += f"\n```\n{solvers_table(results)}\n```\n"
        failed += report.wrong_shares(text, results)
        print("running tests/evals, which measure the rest ...", flush=True)
        failed += report.failing_evals(options.readme.parent)
    table += "".join(f"\nFails: {line}\n" for line in failed)
    with replacing_file(options.out / "report.md") as file:
        file.write(table.encode())
    for claim in failed:
        print(claim, file=sys.stderr)
    print(f"{len(claims)} numbers measured, {len(failed) or 'no'} claims failed")
    print(f"results: {options.out / 'report.md'}")
    return FAILED if failed else 0


def _pictures(options: argparse.Namespace) -> int:
    # Imported here: it needs Pillow and, in the end, a browser.
    from drake_nonstop.benchmarks.pictures import make_pictures

    require_writable(options.out)
    with contextlib.closing(_ProgressLine()) as line:
        paths = make_pictures(options.out, progress=line.show_share)
    for path in paths:
        print(path)
    return 0


def _bench_optimizer(options: argparse.Namespace) -> int:
    # Imported here: other commands need none of it, and it takes its time.
    from drake_nonstop.benchmarks.optimizer import (
        PEERS,
        SOLVERS,
        benchmark_optimizer,
        is_installed,
        table,
    )

    known = [*SOLVERS, *PEERS]
    for name in options.solvers:
        require(name in known, "--solvers", name, f"give some of {', '.join(known)}")
        require(is_installed(name), "--solvers", name, "install SciPy, the extra bench")
    require(options.instances > 0, "--instances", options.instances, "give at least 1")
    require_seed("--seed", options.seed)
    measure = partial(benchmark_optimizer, options.instances, options.seed, options.solvers)
    return _measured(options, "optimizer", measure, table)


def _bench_viewer(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.viewer import benchmark_viewer, table

    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    return _measured(options, "viewer", partial(benchmark_viewer, scenario), table)


def _bench_run(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks import comparing, running
    from drake_nonstop.benchmarks.figures import make_run_time_figure

    _require_repeats(options)
    source = comparing.Source(options.scenario, options.set, options.trust)
    source.load()  # what is wrong with it is said before a folder is made
    if options.against or options.against_revision is not None:
        measure = partial(
            comparing.compare,
            source,
            options.against,
            options.against_revision,
            repeats=options.repeats,
        )
        return _measured(options, "comparison", measure, comparing.table)
    measure = partial(running.benchmark_run, source, repeats=options.repeats)
    return _measured(options, "run", measure, running.table, make_run_time_figure)


def _bench_accuracy(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.accuracy import benchmark_accuracy, table

    _require_repeats(options)
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    measure = partial(benchmark_accuracy, scenario, repeats=options.repeats)
    return _measured(options, "accuracy", measure, table)


def _bench_scale(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.figures import make_scale_figure
    from drake_nonstop.benchmarks.scaling import benchmark_scale, table

    _require_repeats(options)
    require(options.duration > 0, "--duration", options.duration, "give more than 0 s")
    scenario = load_scenario(options.scenario, options.set, trust=options.trust)
    measure = partial(
        benchmark_scale,
        scenario,
        max_n=options.max_n,
        duration=options.duration,
        repeats=options.repeats,
    )
    return _measured(options, "scale", measure, table, make_scale_figure)


def _measured(
    options: argparse.Namespace,
    name: str,
    measure: Callable[..., dict[str, Any]],
    table: Callable[[dict[str, Any]], str],
    make_figure: Callable[[dict[str, Any]], Any] | None = None,
) -> int:
    """Runs a benchmark, writes what it found under its name and prints the table."""
    folder: Path = options.out or Path("out/bench")
    require_writable(folder)
    try:
        with contextlib.closing(_ProgressLine()) as line:
            results = measure(progress=line.show_share)
    except RunStopped as stopped:
        print(f"drake-nonstop: {stopped}", file=sys.stderr)
        return FAILED
    path = folder / f"{name}.json"
    write_json(path, results)
    if make_figure is not None:
        with replacing_file(folder / f"{name}.png") as file:
            make_figure(results).savefig(file, format="png", dpi=150)
    print(table(results))
    print(f"results: {path}")
    return 0


def _require_repeats(options: argparse.Namespace) -> None:
    require(options.repeats > 0, "--repeats", options.repeats, "give at least 1")


def _warnings(metrics: dict[str, Any], scenario: Scenario) -> list[str]:
    return find_warnings(metrics, scenario)


def _table(metrics: dict[str, Any]) -> str:
    return metrics_table(metrics)


class _ProgressLine:
    """A line of text that is written over, or, where the output is no terminal, now and then."""

    _PERIOD = 2.0  # s, between lines where the output is no terminal

    def __init__(self) -> None:
        self._is_terminal = sys.stderr.isatty()
        self._last_line = time.perf_counter()
        self._used = False

    def show(self, text: str) -> None:
        """Shows the text in place of the last one."""
        if self._is_terminal:
            print(f"\r{text}\033[K", end="", file=sys.stderr, flush=True)
        else:
            now = time.perf_counter()
            if now - self._last_line < self._PERIOD:
                return
            self._last_line = now
            print(text, file=sys.stderr, flush=True)
        self._used = True

    def show_share(self, what: str, share: float) -> None:
        """Shows how much of something is done."""
        self.show(f"{what} {_bar(share)} {share:.0%}")

    def close(self) -> None:
        """Ends the line."""
        if self._used and self._is_terminal:
            print(file=sys.stderr)


def _bar(share: float, width: int = 30) -> str:
    filled = round(min(1.0, share) * width)
    return f"[{'#' * filled}{'.' * (width - filled)}]"


class _RunProgress(_ProgressLine):
    """Simulated time and real-time factor while a run goes on."""

    def __init__(self, scenario: Scenario):
        super().__init__()
        self._scenario = scenario
        self._first: tuple[float, float] | None = None  # wall and simulated time

    def __call__(self, simulated: float) -> None:
        now = time.perf_counter()
        if self._first is None or simulated < self._first[1]:  # another run
            self._first = now, simulated
            return
        factor = (simulated - self._first[1]) / (now - self._first[0])
        self.show(
            f"{self._scenario.name} {_bar(simulated / self._scenario.duration)} "
            f"{simulated:6.2f} / {self._scenario.duration:g} s, {factor:.1f} x real time"
        )


if __name__ == "__main__":
    sys.exit(main())
