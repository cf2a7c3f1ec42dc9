"""`drake-nonstop stability`: print Floquet multipliers of the loop around a resting load."""

import argparse

from drake_nonstop.analysis.stability import linearize
from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("stability")
    parser.set_defaults(action=_stability)
    add_scenario(parser, None)


def _stability(options: argparse.Namespace) -> int:
    try:
        with TaskProgress() as progress:
            found = linearize(read_scenario(options), progress)
    except NotFiniteError as error:
        raise ScenarioError(f"stability: {error!s}") from None
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    told = ", ".join(f"{name} {share:.0%}" for name, share in shares if share > 0.005)
    print(
        f"largest multiplier     {found.largest:.4g} in a turn of {found.period:.3g} s "
        f"({found.rate:+.3g} 1/s): {'stable' if found.is_stable else 'unstable'}\n"
        f"least stable mode      {told}, {found.frequency:.3g} rad/s"
    )
    return 0
