"""A scenario to a Simulator of Drake's, which is ready to run."""

from collections.abc import Callable
from typing import Any

from pydrake.common import RandomGenerator
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, System

from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.model.system import Model
from drake_nonstop.run.monitor import SampleInstants
from drake_nonstop.run.preparation import check_simulation
from drake_nonstop.run.recording import control_period_of
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.systems.wiring import output_names
from drake_nonstop.validation import require


def make_simulator(
    scenario: Scenario,
    generator: RandomGenerator | None = None,
    **replacements: Callable[[Model], System] | Any,
) -> Simulator:
    """A Simulator of a scenario's loop, which flies as `simulate` does, without its records.

    `functools.partial(make_simulator, scenario)` is what `MonteCarloSimulation` and
    `RandomSimulation` of pydrake.systems.analysis take as `make_simulator`. The numbers that are
    drawn for the scenario's distributions, and the equilibrium with them, are the declared defaults
    of the loop, to which both functions reset the context. The k-th call with a generator of the
    seed s flies run k of a sweep with `seed: s`, with `engine: diagram` to the bit.

    The root diagram has each signal of the loop as an output port of its name.

    Args:
        scenario: what to run.
        generator: as of `Scenario.sampled`: one number of it is the `random_seed` of this
            simulator. None: the scenario's own.
        replacements: as of `make_nonstop`.

    Raises:
        ScenarioError: the scenario cannot be built, or not with the drawn numbers.
    """
    for name, block in replacements.items():
        require(block is not None, f"replacement {name}", None, "give a block; see make_nonstop")
    scenario, replacements = replaced(scenario, replacements)
    scenario, _ = sample(scenario, generator)
    check_simulation(scenario)
    nonstop = make_nonstop(scenario, **replacements)
    config = with_largest_step(scenario.simulator_config, nonstop, nonstop.CreateDefaultContext())
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    builder.AddNamedSystem("sample_instants", SampleInstants(control_period_of(nonstop)))
    for name in output_names(nonstop):
        builder.ExportOutput(nonstop.GetOutputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    ApplySimulatorConfig(config, simulator)
    return simulator
