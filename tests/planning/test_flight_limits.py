"""The limits of aircraft as margins."""

import math

import numpy as np

from drake_nonstop.mechanics.aircraft import FlightNeeds, stall_speed, thrust_limits
from drake_nonstop.model.aircraft import AircraftParameters, make_aircraft
from drake_nonstop.planning.constraints import Constraints
from drake_nonstop.planning.limits import Of
from drake_nonstop.planning.problem_config import LimitsConfig

AIRCRAFT = make_aircraft(AircraftParameters(model="rascal_110"), cable_length=150.0, gravity=9.81)
CONFIG = LimitsConfig(
    tightening=0.0,
    max_lift_share=0.9,
    max_bank=math.radians(45),
    max_climb=math.radians(20),
    max_thrust_share=0.9,
)


def needs_at(rng, *shape):
    return FlightNeeds(
        airspeed=rng.uniform(9, 20, shape),
        force=rng.uniform(50, 120, shape),
        lift=np.zeros(shape),
        bank=rng.uniform(-1, 1, shape),
        climb=rng.uniform(-0.5, 0.5, shape),
        thrust=rng.uniform(-20, 50, shape),
    )


def test_a_margin_is_negative_beyond_its_limit(rng):
    needs = needs_at(rng, 400)
    margins = Constraints(CONFIG).of_flight(AIRCRAFT, needs)
    over_stall = needs.airspeed / stall_speed(AIRCRAFT)
    load_factor = needs.force / (AIRCRAFT.mass * 9.81)
    least, most = thrust_limits(AIRCRAFT, needs.airspeed)
    kept = [
        load_factor <= 0.9 * over_stall**2,
        np.abs(needs.bank) <= math.radians(45),
        np.abs(needs.climb) <= math.radians(20),
        needs.thrust <= most - 0.05 * (most - least),
        needs.thrust >= least + 0.05 * (most - least),
    ]
    for margin, is_kept in zip(margins, kept, strict=True):
        np.testing.assert_array_equal(margin >= 0, is_kept)
        assert is_kept.any()
        assert not is_kept.all()


def test_only_enabled_limits_have_margins_and_they_are_tightened(rng):
    assert Constraints(LimitsConfig()).names(*Of) == []
    limits = Constraints(LimitsConfig(tightening=0.1, max_bank=0.5))
    needs = needs_at(rng, 3)._replace(bank=np.array([0.44, -0.46, 0.5]))
    (margins,) = limits.of_flight(AIRCRAFT, needs)
    np.testing.assert_array_equal(margins >= 0, [True, False, False])
