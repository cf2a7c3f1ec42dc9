"""Flights side by side show what each shows alone, to the bit."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import load_scenario, make_nonstop
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.systems.compiled_flight import advance_together
from drake_nonstop.systems.compiled_loop import CompiledLoop
from drake_nonstop.systems.native import compiler
from drake_nonstop.systems.tracing import NotFiniteError

CONSTANT = "optimization_layer=ConstantParameters"


def makers(name, numbers, *, prepares_lanes=False, **options):
    """For each list of overrides of a scenario a function that starts its flight."""
    found = []
    for overrides in numbers:
        scenario = changed(load_scenario(name), overrides)
        diagram = make_nonstop(scenario)
        loop = CompiledLoop(diagram, scenario.simulator_config, scenario.control_period, **options)
        if prepares_lanes:
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
    ("quintic", masses(1.0, 1.05, 1.1), {}),
    ("three_carriers", [[f"simulated.load_mass={m}"] for m in (0.95, 1.0, 1.05, 1.1, 1.15)], {}),
    (
        "aircraft_transfer_gusty",
        [[f"simulated.load_mass={9 + m}", f"random_seed={m}"] for m in range(5)],
        {},
    ),
    (
        "aircraft_rest",
        [
            ["cables=!LumpedCables {nodes: 2}", f"simulated.cable_diameter={d}"]
            for d in (0.0007, 0.001, 0.0012)
        ],
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


def test_flights_go_on_by_their_own_samples():
    counts = [3, 1, 5]
    starts = makers("quintic", masses(1.0, 1.1, 1.2), compiles=False)
    flights = [start() for start in starts]
    shown = [advance_together(flights, counts) for _ in range(2)][1]
    for start, flight, count, own in zip(starts, flights, counts, shown, strict=True):
        expected = start()
        alone(expected, count)
        for rows, own_rows in zip(alone(expected, count), own[:2], strict=True):
            np.testing.assert_array_equal(own_rows, rows)
        assert flight.samples == 2 * count
        np.testing.assert_array_equal(flight.state, expected.state)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.parametrize(("name", "numbers", "options"), nightly_beyond(1, "engines", IN_LANES))
def test_flights_in_lanes_show_the_bits_of_each_alone(name, numbers, options, monkeypatch):
    """Each has other numbers, and is at another sample; they go on again and again."""
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)  # by which layers show their solve_time
    starts = makers(name, numbers, prepares_lanes=True, **options)
    counts = [1 + 5 * k % 7 for k in range(len(starts))]
    flights, expected = ([start() for start in starts] for _ in range(2))
    for flight, alone_flight, count in zip(flights, expected, counts, strict=True):
        alone(flight, count)
        alone(alone_flight, count)
        assert flight.loop.lanes() is not None
    for factor in (1, 40, 3):
        shown = advance_together(flights, [factor * count for count in counts])
        for flight, alone_flight, count, own in zip(flights, expected, counts, shown, strict=True):
            assert own.error is None
            for rows, own_rows in zip(alone(alone_flight, factor * count), own[:2], strict=True):
                np.testing.assert_array_equal(own_rows, rows)
            np.testing.assert_array_equal(flight.state, alone_flight.state)


def test_a_flight_that_diverges_keeps_what_it_showed_and_harms_no_other():
    start, start_bad = makers("quintic", masses(1.0, 1.1), compiles=False)
    flight, bad = start(), start_bad()
    advance_together([flight, bad], [2, 2])
    bad.go_to(2, np.full(len(bad.state), np.nan))
    (signals, _, error), (nothing, steps, raised) = advance_together([flight, bad], [2, 2])
    assert error is None
    expected = start()
    alone(expected, 2)
    np.testing.assert_array_equal(signals, alone(expected, 2)[0])
    assert isinstance(raised, NotFiniteError)
    assert len(nothing) == len(steps) == 0
    assert bad.samples == 2
