"""Threads that fly one loop, each with a context of its own, do not disturb each other."""

import itertools
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop import CompiledLoop, load_scenario, make_nonstop, set_parameter

THREADS = 4
ONE_SAMPLE = "optimization_layer=NlpLayer"
LOW = "optimization_layer.amplitude=0.6"  # too low for the bound: every update is solved
BOUND = "optimization_layer.speed_bound"
BOUNDS = BOUND, [0.5, 0.55, 0.6, 0.65]  # m/s
# Of each flight the scenario, its overrides, its duration in s, and what differs from thread to
# thread: a layer each.
FLIGHTS = {
    "horizon": ("quintic", [], 0.4, BOUNDS),
    "program": ("quintic", [ONE_SAMPLE, LOW], 0.05, BOUNDS),
    "snopt": ("quintic", [ONE_SAMPLE, LOW, "optimization_layer.solver=snopt"], 0.05, BOUNDS),
    "governed": (
        *("quintic", [ONE_SAMPLE, "load_trajectory.move_time=3", "reference_governor={}"], 0.05),
        BOUNDS,
    ),
    "turn rate": (
        *("aircraft_co_rotating_rising_wind", ["optimization_layer.max_frequency_rate=1"], 0.08),
        (BOUND, [15.0, 15.5, 16.0, 16.5]),
    ),
    "constant": (
        *("quintic", ["optimization_layer=ConstantParameters"], 0.05),
        ("optimization_layer.frequency", [2.0, 2.1, 2.2, 2.3]),
    ),
    "horizon of aircraft": (
        *("aircraft_transfer_rising_wind", [], 0.04),
        (BOUND, [11.0, 13.4, 13.6, 14.0]),
    ),
}


@pytest.fixture
def impatient():
    """Threads that take turns every 10 µs."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(interval)


def by_diagram(scenario, diagram, duration):
    """Flies a context by Drake's Simulator."""

    def fly(context):
        simulator = Simulator(diagram, context.Clone())
        ApplySimulatorConfig(scenario.simulator_config, simulator)
        simulator.AdvanceTo(duration)
        ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
        end = simulator.get_context()
        return {port.get_name(): port.Eval(end) for port in ports}

    return fly


def by_compiled_loop(scenario, diagram, duration):
    """Flies a context by the compiled loop."""
    period = scenario.control_period
    loop = CompiledLoop(diagram, scenario.simulator_config, period, compiles=False)
    return lambda context: loop.run(context, duration)[1]


def signals_of(fly, context):
    """The signals of a flight but for wall times."""
    return {
        name: values.tobytes()
        for name, values in fly(context).items()
        if name != "solve_time" and hasattr(values, "tobytes")
    }


CASES = itertools.product([1, 100], [by_compiled_loop, by_diagram], FLIGHTS)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(("tries", "engine", "flight"), nightly_beyond(4, "engines", CASES))
def test_flights_in_threads_are_those_one_after_the_other_to_the_bit(flight, engine, tries):
    name, overrides, duration, (path, values) = FLIGHTS[flight]
    scenario = load_scenario(name, overrides)
    diagram = make_nonstop(scenario)
    starts = [diagram.CreateDefaultContext() for _ in range(THREADS)]
    for start, value in zip(starts, values, strict=True):
        set_parameter(diagram, start, path, value)
    fly = engine(scenario, diagram, duration)
    expected = [signals_of(fly, start) for start in starts]
    assert len({signals["parameters"] for signals in expected}) == THREADS
    for _ in range(tries):
        with ThreadPoolExecutor(THREADS) as pool:
            found = [*pool.map(lambda start: signals_of(fly, start), starts)]
        assert found == expected
