"""Flights side by side show what each shows alone, to the bit."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import CompiledLoop, changed, load_scenario, make_nonstop
from drake_nonstop.systems.compiled_flight import advance_together

CONSTANT = "optimization_layer=ConstantParameters"


def makers(name, numbers, **options):
    """For each list of overrides of a scenario a function that starts its flight."""
    found = []
    for overrides in numbers:
        scenario = changed(load_scenario(name), overrides)
        diagram = make_nonstop(scenario)
        loop = CompiledLoop(diagram, scenario.simulator_config, scenario.control_period, **options)
        loop.prepare_lanes()

        def start(loop=loop, diagram=diagram):
            flight = loop.fly(diagram.CreateDefaultContext())
            flight.start()
            return flight

        found.append(start)
    return found


def masses(*values):
    return [[CONSTANT, f"simulated.load_mass={mass}"] for mass in values]


IN_LANES = [
    (
        "quintic",  # short, so that it compiles soon
        [[*own, "control_period=0.005"] for own in masses(1, 1.05, 1.1, 1.15, 1.2)],
        {"signals": ["load_state"]},
    ),
    (
        "aircraft_transfer_gusty",
        [[f"simulated.load_mass={9 + m}", f"random_seed={m}"] for m in range(5)],
        {},
    ),
    (
        "aircraft_rest_cables",  # calls functions
        [
            [f"simulated.cable_drag={drag}", "simulator_config.max_step_size=0.002"]
            for drag in (0.9, 1.0, 1.1, 1.2, 1.3)
        ],
        {"signals": ["load_state"]},
    ),
]


def alone(flight, samples):
    """Signals and signals of steps, in rows, of all these samples."""
    end, rows = flight.samples + samples, []
    while flight.samples < end:
        rows.append(flight.advance(end - flight.samples))
    return [np.concatenate(kind) for kind in zip(*rows, strict=True)]


@pytest.mark.parametrize(("name", "numbers", "options"), nightly_beyond(1, "engines", IN_LANES))
def test_flights_in_lanes_show_the_bits_of_each_alone(name, numbers, options, monkeypatch):
    """Each has other numbers, and is at another sample; they go on again and again."""
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)  # by which layers show their solve_time
    starts = makers(name, numbers, **options)
    counts = [1 + 5 * k % 7 for k in range(len(starts))]
    flights, expected = ([start() for start in starts] for _ in range(2))
    for flight, other, count in zip(flights, expected, counts, strict=True):
        if flight.loop.lanes() is None:
            pytest.skip("there is no C compiler")
        alone(flight, count)
        alone(other, count)
    for factor in (1, 40, 3):
        shown = advance_together(flights, [factor * count for count in counts])
        for flight, other, count, own in zip(flights, expected, counts, shown, strict=True):
            assert own.error is None
            for rows, own_rows in zip(alone(other, factor * count), own[:2], strict=True):
                np.testing.assert_array_equal(own_rows, rows)
            np.testing.assert_array_equal(flight.state, other.state)
