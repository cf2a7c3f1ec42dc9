"""The outcome of each flight of the fleet, and the words that say why."""

import pytest
from fleet import FLEET, long_ones_nightly

OK = ("ok", "")
BELOW = "a carrier was below the bound for {} s (limits.time_below_bound: 0 s)"

# The outcome, and the beginning of the first reason.
OUTCOMES = {
    "line_without_optimization": ("bound_missed", BELOW.format(3.63)),
    "paper_line": ("bound_missed", BELOW.format(0.0375)),
    "paper_line_without_optimization": ("bound_missed", BELOW.format(3.48)),
    "paper_quintic": ("bound_missed", BELOW.format(0.025)),
    "real_scale_carousel": ("collision", "two cables came within 0 m of each other"),
    "real_scale_cycle": ("collision", "two carriers came within 0 m of each other"),
    "aircraft_transfer_gusty": (
        "limit_missed",
        "commands of aircraft were at their limits for 11.7 % of the time (limits.saturated_share",
    ),
    "five_tilted_loaded": ("bound_missed", BELOW.format(0.245)),
    "that_falls": ("load_lost", "the load was 2.02 m from its reference"),
    "that_stalls": (
        "stalled",
        "carrier 2 stalled at t = 1.480 s, where the run ended: C_L was 1.16",
    ),
    "that_diverges": ("stopped", "the run diverged at t = 0.1175 s: load_plant made a value"),
    "with_bowed_cables": ("cable_broken", "cable "),  # which of equal ones is up to rounding
    "with_slack_cables": ("cables_slack", "a cable was slack for 0.845 s"),
}
# What else is said of a flight, in part.
ALSO = {
    "real_scale_cycle": "two cables came within 0 m of each other",
    "that_stalls": BELOW.format(0.415),
    "that_falls": "a cable was slack for 0.45 s",
    "that_diverges": "the load was turned by 1.53 rad from its reference",
}
WARNED = {
    "that_falls": ["was asked for an acceleration of "],
    "that_diverges": ["flew at 3.62e+04 m/s", "was accelerated by 1.19e+05", "rose to 1.01e+05 N"],
}


@pytest.mark.parametrize("name", long_ones_nightly(FLEET))
def test_outcome_of_a_flight(fleet, name):
    run, metrics = fleet.evaluated(name)
    outcome, reason = OUTCOMES.get(name, OK)
    first, *others = metrics["reasons"] or [""]
    assert metrics["outcome"] == outcome, metrics["reasons"]
    assert first.startswith(reason)
    assert bool(first) == bool(reason), first
    assert ALSO.get(name, "") in "; ".join(others)
    words = WARNED.get(name, [])
    assert len(metrics["warnings"]) == len(words), metrics["warnings"]
    for warning, word in zip(metrics["warnings"], words, strict=True):
        assert word in warning
    assert bool(run.stopped) == (outcome == "stopped")
