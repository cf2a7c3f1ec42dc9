"""`drake-nonstop stability`: Floquet multipliers and margins."""

import argparse
import dataclasses

from drake_nonstop.cli.arguments import (
    Commands,
    add_study,
    read_scenario,
    study_folder,
    write_figure,
)
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.figures import make_margins_figure
from drake_nonstop.studies.files import require_writable, write_json
from drake_nonstop.studies.margins import Margin, find_margins, find_stability, margins_settings
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.progress import TaskProgress

_FINE_STEP = 0.001  # s, at which integrators damp nothing that matters here


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "stability",
        help="Floquet multipliers of the loop around a resting load, and margins",
        description="Linearizes the loop around a resting load at some 60 to 110 settings, in a "
        "process per core: one or two minutes on two cores. The loop as it is comes first; a "
        "setting with which it cannot be built is a row that says so. Interrupted, the same "
        "command continues.",
    )
    parser.set_defaults(action=_stability)
    add_study(parser, "out/stability/NAME")


def _stability(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    require_drawing()
    folder = study_folder(options, scenario.name, margins_settings(scenario))
    require_writable(folder)
    fine_step = min(_FINE_STEP, scenario.simulator_config.max_step_size)
    fine = changed(scenario, [f"simulator_config.max_step_size={fine_step}"], trust=options.trust)
    with TaskProgress() as progress:
        found = find_stability(scenario, progress)
    verdict = "stable" if found.is_stable else "unstable"
    print(
        f"largest multiplier     {found.largest:.4g} in a turn of {found.period:.3g} s "
        f"({found.rate:+.3g} 1/s): {verdict}",
        flush=True,  # the rest takes a minute
    )
    with TaskProgress() as progress:
        found_finely = find_stability(fine, progress)
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
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    print(
        "least stable mode      "
        + ", ".join(f"{name} {share:.0%}" for name, share in shares if share > 0.005)
        + f", {found.frequency:.3g} rad/s"
    )
    for margin in margins:
        name = f"{margin.name}, {margin.unit}"
        range_ = _stable_range(margin) if found.is_stable else "unstable here"
        print(f"{name:22} {margin.nominal:.4g}, {range_}")
        for value, reason in margin.refused.items():
            print(f"{'':22} {value:.4g} is refused: {reason}")
    print(f"results: {folder}")
    return 0


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
