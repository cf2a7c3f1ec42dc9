"""Threads that fly one loop, each with a context of its own, do not disturb each other."""

import os
import sys
import threading

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium

TRIES = int(os.environ.get("THREAD_TRIES", "1"))
THREADS = 3
DURATION = 0.06  # s, of each flight
LOW = "optimization_layer.amplitude=0.6"  # too low for the bound: every update, or plan, is solved


@pytest.fixture
def impatient():
    """Threads that take turns every 10 µs."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(interval)


def flown(config, loop, start):
    """The states, but for wall times, after a flight from the start on; an error's text."""
    try:
        simulator = Simulator(loop, start.Clone())
        ApplySimulatorConfig(config.simulator_config, simulator)
        simulator.AdvanceTo(start.get_time() + DURATION)
    except Exception as error:
        return repr(error)
    end = simulator.get_context()
    groups = [end.get_discrete_state(i) for i in range(end.num_discrete_state_groups())]
    parts = [group.CopyToVector() for group in groups if group.size() != 1]
    return np.concatenate([end.get_continuous_state_vector().CopyToVector(), *parts]).tobytes()


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    "overrides",
    nightly_beyond(
        1,
        "engines",
        [
            ["optimization_layer=NonstopOptimizer", LOW, "optimization_layer.solver=snopt"],
            [LOW],
            [],
        ],
    ),
    ids=lambda overrides: ", ".join(overrides) or "default",
)
def test_flights_in_threads_are_those_one_after_the_other_to_the_bit(overrides):
    config = load_scenario("quintic", overrides)
    loop = make_nonstop(config)
    starts = [loop.CreateDefaultContext() for _ in range(THREADS)]
    for k, start in enumerate(starts):
        set_equilibrium(loop, start)
        start.SetTime(0.05 * k)
    expected = [flown(config, loop, start) for start in starts]
    assert len({*expected}) == THREADS
    for _ in range(TRIES):
        results = [""] * THREADS

        def fly(k, results=results):
            results[k] = flown(config, loop, starts[k])

        threads = [threading.Thread(target=fly, args=(k,)) for k in range(THREADS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert results == expected
