"""`drake-nonstop run`: run a scenario and write its results."""

import argparse
import contextlib
import os
import shutil
import signal
import tempfile
from pathlib import Path
from typing import Any

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario, result_folder
from drake_nonstop.cli.ending import (
    BAD_INPUT,
    FAILED,
    INTERRUPTED,
    NOT_OK,
    complain,
    exit_code,
    say_end,
)
from drake_nonstop.run.interruption import ALL, current_interruption
from drake_nonstop.run.metrics import in_brief, metrics_table
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.run.recording import least_size
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped
from drake_nonstop.run.simulate import simulate
from drake_nonstop.run.verify_step import TOLERANCES, verify_step
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.files import require_writable
from drake_nonstop.studies.results_folder import (
    RUN_FILES,
    stopped_folder,
    write_data,
    write_pictures,
)
from drake_nonstop.studies.workers import no_progress
from drake_nonstop.validation import ScenarioError, one_line, require
from drake_nonstop.view.figure_style import FORMATS
from drake_nonstop.view.progress import RunProgress, TaskProgress

_EXIT_CODES = {RunOutcome.OK: 0, RunOutcome.STOPPED: FAILED}  # NOT_OK for all others


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    others = [outcome.value for outcome in RunOutcome if outcome not in _EXIT_CODES]
    parser = commands.add_parser(
        "run",
        epilog=f"Exit codes: 0 where the outcome is ok, {NOT_OK} where it is "
        f"{', '.join(others[:-1])} or {others[-1]}, {FAILED} where the run stopped before its "
        f"time or results, pictures or the output could not be written, {BAD_INPUT} for bad "
        f"input, {INTERRUPTED} after Ctrl-C, {exit_code(signal.SIGTERM)} after SIGTERM, "
        f"{exit_code(signal.SIGHUP)} after SIGHUP.",
    )
    parser.set_defaults(action=_run)
    add_scenario(parser)
    of_figures = parser.add_mutually_exclusive_group()
    about = f"the format of figures/: {', '.join(FORMATS)} ({FORMATS[0]})"
    of_figures.add_argument("--figures", choices=FORMATS, default=FORMATS[0], help=about)
    of_figures.add_argument("--no-figures", action="store_true", help="write no figures/")
    parser.add_argument("--no-replay", action="store_true", help="write no replay.html")
    parser.add_argument(
        "--live", action="store_true", help="show it in Meshcat while it runs, with controls"
    )
    parser.add_argument(
        "--realtime",
        type=float,
        metavar="RATE",
        help="simulated s per s of a live run (1; 0: as fast as it can)",
    )
    parser.add_argument(
        "--verify-step",
        action="store_true",
        help="fly again with half the step and say which metrics move",
    )
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def _run(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    is_usable = options.live or options.realtime is None
    require(is_usable, "--realtime", options.realtime, "give --live with it")
    remedy = "give one of them: a live run may be changed while it goes on"
    require(not (options.live and options.verify_step), "--verify-step", "--live", remedy)
    rate = 1.0 if options.realtime is None else options.realtime
    return run_into(
        result_folder(options, scenario.name, scenario),
        scenario,
        figures=not options.no_figures and options.figures,
        replay=not options.no_replay,
        verifies_step=options.verify_step,
        live_rate=rate if options.live else None,
        is_quiet=options.quiet,
    )


def run_into(
    folder: Path,
    scenario: Scenario,
    *,
    figures: str | bool = True,
    replay: bool = True,
    verifies_step: bool = False,
    live_rate: float | None = None,
    is_quiet: bool = False,
) -> int:
    """Runs a scenario, writes its results and prints its table; returns the exit code.

    A new folder is removed where the scenario cannot be run. A run that ends before its time does
    not replace the results of a whole one: `stopped_folder`.

    Raises:
        ScenarioError: the scenario cannot be built, or the folder not be written.
    """
    is_new, is_live = not os.path.lexists(folder), live_rate is not None
    bar = None if is_quiet else RunProgress(scenario.name, scenario.simulation_duration)

    def write(run: Run) -> tuple[dict[str, Any], str, bool]:
        """Writes the results; returns the metrics, where all is, and whether pictures are there."""
        if bar is not None:
            bar.close()
        place = stopped_folder(folder) if run.stopped else folder
        interruption.is_writing = True
        metrics, missing = _write_somewhere(run, place), ""
        interruption.is_writing = False
        try:
            interruption.patience = 0
            if interruption.count > 1:
                raise KeyboardInterrupt
            with TaskProgress() as task:
                show = no_progress if is_quiet else task
                write_pictures(run, place, figures=figures, replay=replay, progress=show)
        except KeyboardInterrupt:
            missing = ", without all pictures"
        except Exception as error:  # what was flown is kept
            missing = f", without all pictures ({one_line(error)})"
        finally:
            interruption.patience = ALL
        earlier = "" if place == folder else f"; those of an earlier run stay in {folder}"
        return metrics, f"{place}{missing}{earlier}", missing == ""

    with current_interruption() as interruption, interruption.patient(ALL):
        run = None
        try:
            require_writable(folder, RUN_FILES, room=least_size(scenario))
            run = _flown(scenario, bar, verifies_step, live_rate)
            metrics, where, is_whole = write(run)
            if interruption.number:
                return say_end(interruption, f"the results are in {where}")
            code = _EXIT_CODES.get(RunOutcome(metrics["outcome"]), NOT_OK)
            if is_live and code == FAILED:
                code = 0  # somebody pressed "stop" in the page
            if not is_quiet:
                _report(metrics, run, where)
            if code != 0:
                complain(f"{metrics['outcome']}: {in_brief(metrics['reasons'])}")
            if not is_whole:
                complain(f"the results are in {where}")
                return FAILED
            return code
        except (RunStopped, RunInterrupted) as ended:
            kept = "nothing had been flown yet"
            if len(ended.run.time) > (1 if isinstance(ended, RunInterrupted) else 0):
                metrics, where, _ = write(ended.run)
                kept = f"the results up to {metrics['simulated_s']:.3f} s are in {where}"
                run = ended.run
            if interruption.number:
                return say_end(interruption, kept)
            complain(f"{ended.run.stopped or ended}; {kept}")
            return FAILED
        finally:
            if bar is not None:
                bar.close()
            if is_new and run is None:
                with contextlib.suppress(OSError):
                    folder.rmdir()


def _flown(
    scenario: Scenario, bar: RunProgress | None, verifies_step: bool, live_rate: float | None
) -> Run:
    """The run, of which a page is shown where it has a rate."""
    if live_rate is None:
        run = simulate(scenario, progress=bar)
        if not verifies_step:
            return run
        if bar is not None:
            bar = RunProgress(f"{scenario.name} with half the steps", scenario.simulation_duration)
        return verify_step(run, progress=bar)
    from drake_nonstop.view.live import run_live
    from drake_nonstop.view.meshcat_server import start_meshcat

    meshcat = start_meshcat()
    print(f"watch and steer it at {meshcat.web_url()}", flush=True)
    return run_live(scenario, meshcat, realtime_rate=live_rate, progress=bar)


def _write_somewhere(run: Run, folder: Path) -> dict[str, Any]:
    """Writes a run's data to the folder and returns the metrics.

    Raises:
        ScenarioError: the folder cannot be written; says in what other folder the data are.
    """
    try:
        return write_data(run, folder)
    except ScenarioError as error:
        other = Path(tempfile.mkdtemp(prefix="drake-nonstop-"))
        try:
            write_data(run, other)
        except ScenarioError:
            shutil.rmtree(other, ignore_errors=True)
            raise error from None
        raise ScenarioError(f"{error}; the results are in {other}") from None


def _report(metrics: dict[str, Any], run: Run, place: str) -> None:
    print(metrics_table(metrics))
    if metrics["is_steered"]:
        print("steered while it ran: scenario.yaml alone does not repeat it")
    if run.half_step is not None and not run.unresolved:
        print(
            f"with steps of {1e3 * run.half_step['step_s']:.3g} ms no metric moves ({TOLERANCES})"
        )
    print(f"results: {place}", flush=True)
