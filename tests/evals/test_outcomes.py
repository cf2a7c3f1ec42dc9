"""The outcome of each flight of the fleet, and the words that say why."""

import pytest
from fleet import FLEET, long_ones_nightly

OK = ("ok", "")
BELOW = "(limits.time_below_bound: 0 s)"

# The outcome, and a part of the first reason.
OUTCOMES = {
    "line_without_optimization": ("bound_missed", BELOW),
    "paper_line": ("bound_missed", BELOW),
    "paper_line_without_optimization": ("bound_missed", BELOW),
    "paper_quintic": ("bound_missed", BELOW),
    "real_scale_carousel": ("collision", "(limits.cable_distance: "),
    "real_scale_cycle": ("collision", "(limits.carrier_distance: "),
    "aircraft_transfer_gusty": (
        "limit_missed",
        "(limits.saturated_share: ",
    ),
    "five_tilted_loaded": ("bound_missed", BELOW),
    "that_falls": ("load_lost", "(limits.position_error: "),
    "that_stalls": (
        "stalled",
        "carrier 2 stalled at t = 1.480 s: C_L was 1.16",
    ),
    "that_diverges": ("stopped", "the run diverged at t = 0.1175 s: load_plant made a value"),
    "with_bowed_cables": ("cable_broken", "cable "),  # which of equal ones is up to rounding
    "with_slack_cables": ("cables_slack", "(limits.slack_time: "),
}
# What else is said of a flight, in part.
ALSO = {
    "real_scale_cycle": "(limits.cable_distance: ",
    "that_stalls": BELOW,
    "that_falls": "(limits.slack_time: ",
    "that_diverges": "(limits.tilt_error: ",
}


@pytest.mark.parametrize("name", long_ones_nightly(FLEET))
def test_outcome_of_a_flight(fleet, name):
    run, metrics = fleet.evaluated(name)
    outcome, reason = OUTCOMES.get(name, OK)
    first, *others = metrics["reasons"] or [""]
    assert metrics["outcome"] == outcome, metrics["reasons"]
    assert reason in first
    assert bool(first) == bool(reason), first
    assert ALSO.get(name, "") in "; ".join(others)
    assert bool(run.stopped) == (outcome == "stopped")


def test_distances_of_the_flight_over_a_tower_follow_from_its_path_alone(fleet):
    """The load's path is 1.3 m high, the tower 0.7 m; it rests 2.3 m above the ground."""
    _, metrics = fleet.evaluated("quintic_over_tower")
    assert metrics["obstacles"]["load_distance_min_m"] == pytest.approx(0.6, abs=1e-4)
    said = " ".join(metrics["obstacles"]["approaches"])
    assert "the load came within 0.6 m of tower" in said
    assert "the load came within 2.3 m of ground" in said
