"""Measurements for who changes the code: `python -m tests.benchmarks scale`, in the checkout."""

import argparse
import sys
import warnings
from functools import partial
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

import drake_nonstop.studies.one_blas_thread  # noqa: E402, F401
from benchmarks import (  # noqa: E402
    accuracy,
    claims,
    many,
    scaling,
    shell,
    viewer,
    whole_tasks,
)
from drake_nonstop.cli.arguments import (  # noqa: E402
    Commands,
    add_repeats,
    add_scenario,
    read_scenario,
    require_repeats,
)
from drake_nonstop.cli.bench import run_benchmark  # noqa: E402
from drake_nonstop.cli.ending import BAD_INPUT, FAILED  # noqa: E402
from drake_nonstop.scenario.loading import scenario_names  # noqa: E402
from drake_nonstop.studies.files import replacing_file, require_writable  # noqa: E402
from drake_nonstop.validation import (  # noqa: E402
    ScenarioError,
    ScenarioWarning,
    message_of,
    require,
    require_installed,
    require_whole,
    show_warning,
)
from drake_nonstop.view.browser import open_browser  # noqa: E402
from drake_nonstop.view.figure_style import require_drawing  # noqa: E402
from drake_nonstop.view.progress import TaskProgress  # noqa: E402


def _add_accuracy(commands: Commands) -> None:
    parser = commands.add_parser(
        "accuracy", help="how fast and how exact a scenario's run is, by integrator and step"
    )
    parser.set_defaults(action=_accuracy)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 3)


def _accuracy(options: argparse.Namespace) -> int:
    require_repeats(options)
    scenario = read_scenario(options)
    measure = partial(accuracy.benchmark_accuracy, scenario, repeats=options.repeats)
    return run_benchmark(options, "accuracy", measure, accuracy.table)


def _add_scale(commands: Commands) -> None:
    parser = commands.add_parser(
        "scale", help="how a scenario's speed falls with the number of carriers"
    )
    parser.set_defaults(action=_scale)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 3)
    parser.add_argument("--max-n", type=int, default=64, metavar="N", help="carriers, at most (64)")
    parser.add_argument("--duration", type=float, default=3.0, metavar="S", help="of a run (3)")


def _scale(options: argparse.Namespace) -> int:
    require_repeats(options)
    require(options.duration > 0, "--duration", options.duration, "give more than 0 s")
    measure = partial(
        scaling.benchmark_scale,
        read_scenario(options),
        max_n=options.max_n,
        duration=options.duration,
        repeats=options.repeats,
    )
    return run_benchmark(options, "scale", measure, scaling.table, scaling.make_scale_figure)


def _add_viewer(commands: Commands) -> None:
    parser = commands.add_parser("viewer", help="what a live view of a scenario costs")
    parser.set_defaults(action=_viewer)
    add_scenario(parser, "out/bench")


def _viewer(options: argparse.Namespace) -> int:
    measure = partial(viewer.benchmark_viewer, read_scenario(options))
    return run_benchmark(options, "viewer", measure, viewer.table)


def _add_shell(commands: Commands) -> None:
    parser = commands.add_parser("shell", help="how long `drake-nonstop run` takes, with pictures")
    parser.set_defaults(action=_shell)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 5)
    parser.add_argument("--against-revision", metavar="REV", help="run that one, too")


def _shell(options: argparse.Namespace) -> int:
    require_repeats(options)
    read_scenario(options)
    measure = partial(
        shell.benchmark_shell,
        [options.scenario, *(f"--set={change}" for change in options.set)],
        options.against_revision,
        repeats=options.repeats,
    )
    return run_benchmark(options, "shell", measure, shell.table)


def _add_many(commands: Commands) -> None:
    parser = commands.add_parser(
        "many", help="how long a run of a sweep takes, and a step of environments side by side"
    )
    parser.set_defaults(action=_many)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 5)
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="of a sweep (100)")


def _many(options: argparse.Namespace) -> int:
    require_repeats(options)
    require_whole("--runs", options.runs, 1, 100_000)
    scenario, given = read_scenario(options), {"runs": options.runs, "repeats": options.repeats}
    measure = partial(many.benchmark_many, scenario, **given)
    return run_benchmark(options, "many", measure, many.table)


def _add_optimizer(commands: Commands) -> None:
    parser = commands.add_parser(
        "optimizer",
        help="layers that fly whole tasks, compared with the best plan that knows all of a task",
    )
    parser.set_defaults(action=_optimizer)
    parser.add_argument(
        "--tasks",
        nargs="*",
        metavar="NAME",
        default=whole_tasks.TASKS,
        help=f"scenarios that layers fly ({', '.join(whole_tasks.TASKS)})",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="(out/bench)")


def _optimizer(options: argparse.Namespace) -> int:
    for name in options.tasks:
        remedy = f"give some of {', '.join(whole_tasks.TASKS)}"
        require(name in scenario_names(), "--tasks", name, remedy)
    measure = partial(whole_tasks.benchmark_tasks, options.tasks)
    return run_benchmark(options, "optimizer", measure, whole_tasks.tasks_table)


def _add_pictures(commands: Commands) -> None:
    parser = commands.add_parser("pictures", help="take the README's pictures")
    parser.set_defaults(action=_pictures)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/pictures"), help="(out/pictures)"
    )


def _pictures(options: argparse.Namespace) -> int:
    require_installed("pictures", PIL="pillow")
    require_drawing()
    from benchmarks.pictures import FILES, make_pictures

    _require_browser()
    require_writable(options.out, FILES)
    with TaskProgress() as progress:
        paths = make_pictures(options.out, progress=progress)
    for path in paths:
        print(path)
    return 0


def _require_browser() -> None:
    with open_browser(64, 64):
        pass


def _add_report(commands: Commands) -> None:
    parser = commands.add_parser(
        "report",
        help="measure the numbers that the README marks as measured, and take its pictures",
    )
    parser.set_defaults(action=_report)
    parser.add_argument(
        "--readme",
        type=Path,
        metavar="FILE",
        default=Path("README.md"),
        help="with docs beside it (README.md)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/report"))
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the runs only: no benchmarks, no pictures, no tests/evals",
    )


def _report(options: argparse.Namespace) -> int:
    text = claims.documentation(options.readme)
    measurable = [
        claim for claim in claims.read_claims(text) if not (options.quick and claim.is_of_speed)
    ]
    files = ["report.md"]
    if not options.quick:  # what is missing is said before all is measured
        require_installed("report", PIL="pillow", pytest="pytest")
        require_drawing()
        from benchmarks.pictures import FILES, make_pictures

        _require_browser()
        files += FILES
    require_writable(options.out, files)
    with TaskProgress() as progress:
        measured = claims.measure(measurable, progress=progress)
    failed = claims.wrong_claims(measured)
    if not options.quick:
        with TaskProgress() as progress:
            make_pictures(options.out, progress=progress)
        print("running tests/evals, which measure the rest ...", flush=True)
        failed += claims.failing_evals(options.readme.parent)
    with replacing_file(options.out / "report.md") as file:
        file.write(claims.report_text(measured, failed).encode())
    for claim in failed:
        print(claim, file=sys.stderr)
    print(f"{len(measurable)} numbers measured, {len(failed) or 'no'} claims failed")
    print(f"results: {options.out / 'report.md'}")
    return FAILED if failed else 0


_COMMANDS = (
    *(_add_optimizer, _add_viewer, _add_accuracy, _add_scale, _add_shell, _add_many),
    *(_add_pictures, _add_report),
)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in _COMMANDS:
        add(commands)
    options = parser.parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("once", ScenarioWarning)
            warnings.showwarning = show_warning
            return options.action(options)
    except ScenarioError as error:
        print(f"benchmarks: {message_of(error)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("benchmarks: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
