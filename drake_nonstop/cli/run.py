"""`drake-nonstop run`: runs a scenario and writes its results."""

import argparse
import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.exit_codes import FAILED, INTERRUPTED
from drake_nonstop.cli.progress import RunProgress
from drake_nonstop.scenario.loading import Scenario
from drake_nonstop.simulation.simulate import Run, RunInterrupted, RunStopped, simulate
from drake_nonstop.studies.results_folder import require_writable, write_results
from drake_nonstop.validation import ScenarioError, require
from drake_nonstop.visualization.live import run_live
from drake_nonstop.visualization.scene import start_meshcat


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("run", help="run a scenario and write its results")
    parser.set_defaults(action=_run)
    add_scenario(parser)
    parser.add_argument("--no-figures", action="store_true", help="write no figures/")
    parser.add_argument("--no-replay", action="store_true", help="write no replay.html")
    parser.add_argument(
        "--live", action="store_true", help="show it in Meshcat while it runs, with controls"
    )
    parser.add_argument(
        "--realtime",
        type=float,
        metavar="RATE",
        help="simulated s per s of a live run (1; 0: free)",
    )
    parser.add_argument("--port", type=int, help="of the live page (any from 7000 that is free)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def _run(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    for name in ("realtime", "port"):
        value = getattr(options, name)
        require(options.live or value is None, f"--{name}", value, "give --live with it")
    return run_into(
        options.out or Path("out") / scenario.name,
        scenario,
        is_live=options.live,
        realtime_rate=1.0 if options.realtime is None else options.realtime,
        port=options.port,
        figures=not options.no_figures,
        replay=not options.no_replay,
        is_quiet=options.quiet,
    )


def run_into(
    folder: Path,
    scenario: Scenario,
    *,
    is_live: bool = False,
    realtime_rate: float = 1.0,
    port: int | None = None,
    figures: bool = True,
    replay: bool = True,
    is_quiet: bool = False,
) -> int:
    """Runs a scenario, writes its results and prints its table; returns the exit code.

    Args:
        folder: of the results; a new one is removed where the scenario cannot be run.
        scenario: what to run.
        is_live: whether to show the run in Meshcat, with controls, while it goes on; restarts
            in the page are further runs, whose results replace those of the one before.
        realtime_rate: of a live run: simulated s per s, 0 for as fast as it goes.
        port: of the live page; None: any from 7000 that is free.
        figures: whether to write figures/.
        replay: whether to write replay.html.
        is_quiet: whether to print errors only.

    Raises:
        ScenarioError: the scenario cannot be built, or the folder not be written.
    """
    is_new = not folder.exists()
    progress = None if is_quiet else RunProgress(scenario.name, scenario.duration)

    def runs() -> Iterator[Run]:
        if not is_live:
            yield simulate(scenario, progress=progress)
            return
        meshcat = start_meshcat(port)
        print(f"watch and steer it at {meshcat.web_url()}", flush=True)
        yield from run_live(scenario, meshcat, realtime_rate=realtime_rate, progress=progress)

    def write(run: Run) -> dict[str, Any]:
        return write_results(run, folder, figures=figures, replay=replay)

    try:
        require_writable(folder)
        for run in runs():
            if progress is not None:
                progress.close()
            metrics = write(run)
            if not is_quiet:
                _report(metrics, run.scenario, folder)
                if is_live:
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
        if progress is not None:
            progress.close()
    print(f"drake-nonstop: {message}", file=sys.stderr)
    if len(run.time) > 0:
        metrics = write(run)
        print(
            f"drake-nonstop: the results up to {metrics['simulated_s']:.3f} s are in {folder}",
            file=sys.stderr,
        )
    return code


def _report(metrics: dict[str, Any], scenario: Scenario, folder: Path) -> None:
    print(_table(metrics))
    if metrics["is_steered"]:
        print("steered while it ran: scenario.yaml alone does not repeat it")
    for warning in _warnings(metrics, scenario):
        print(f"warning: {warning}")
    print(f"results: {folder}")


def _warnings(metrics: dict[str, Any], scenario: Scenario) -> list[str]:
    """What a run did that nobody would want of real carriers, a line each."""
    carriers, cables, optimizer = (metrics[key] for key in ("carriers", "cables", "optimizer"))
    unsolved = optimizer["relaxed"] + optimizer["held"]
    found = [
        (cables["slack_time_s"], f"a cable was slack for {cables['slack_time_s']:.3g} s"),
        (
            carriers["time_below_bound_s"],
            f"a carrier was below the bound for {carriers['time_below_bound_s']:.3g} s",
        ),
        (unsolved, f"no parameters fulfilled the bound at {unsolved} updates (relaxed, held)"),
    ]
    for what, safe in (
        ("carriers", scenario.safe_carrier_distance),
        ("cables", scenario.safe_cable_distance),
    ):
        closest = metrics[what]["separation_min_m"]
        text = f"{what} came within {round(closest, 3):g} m of each other, {safe:g} m is safe"
        found.append((closest < safe, text))
    return [text for is_so, text in found if is_so]


def _table(metrics: dict[str, Any]) -> str:
    load, carriers = metrics["load"], metrics["carriers"]
    cables, optimizer = metrics["cables"], metrics["optimizer"]
    rows = [
        (
            "simulated",
            f"{metrics['simulated_s']:g} s in {metrics['wall_s']:.2f} s "
            f"({metrics['real_time_factor']:.1f} x real time)",
        ),
        (
            "load position error",
            f"mean {1e3 * load['position_error_mean_m']:.3g} mm, "
            f"max {1e3 * load['position_error_max_m']:.3g} mm",
        ),
        (
            "load orientation error",
            f"mean {1e3 * load['orientation_error_mean_rad']:.3g} mrad, "
            f"max {1e3 * load['orientation_error_max_rad']:.3g} mrad",
        ),
        (
            "carrier speed",
            f"{carriers['speed_min_m_s']:.3f} to {carriers['speed_max_m_s']:.3f} m/s, bound "
            f"{carriers['speed_bound_m_s']:g} m/s, below it for "
            f"{carriers['time_below_bound_s']:.3g} s",
        ),
        (
            "closest",
            f"carriers {round(carriers['separation_min_m'], 3):g} m, "
            f"cables {round(cables['separation_min_m'], 3):g} m",
        ),
        (
            "tension",
            f"{cables['tension_min_N']:.3g} to {cables['tension_max_N']:.3g} N, slack for "
            f"{cables['slack_time_s']:.3g} s",
        ),
    ]
    if optimizer["updates"]:
        counts = [f"{optimizer[k]} {k}" for k in ("kept", "solved", "relaxed", "held")]
        rows.append(("optimizer", f"{optimizer['updates']} updates: {', '.join(counts)}"))
    return "\n".join(f"{name:24}{value}" for name, value in rows)
