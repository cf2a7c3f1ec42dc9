"""The speed bound as a signal: the carriers have to fly faster for a while, and follow."""

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium, with_largest_step

LOW, HIGH = 0.55, 0.95  # m/s


def main(duration: float = 15.0) -> None:
    """Flies the quintic task while ε rises from LOW to HIGH, stays there, and falls again."""
    scenario = load_scenario("quintic", [f"optimization_layer.speed_bound={LOW}"])
    bound = PiecewisePolynomial.FirstOrderHold(
        [0.0, 2.0, 5.0, 8.0, 11.0], [[LOW, LOW, HIGH, HIGH, LOW]]
    )
    builder = DiagramBuilder()
    # The loop's optional input becomes one of the diagram; a block of the loop that makes the
    # signal `speed_bound_command` would be connected to it by its name.
    loop = builder.AddSystem(make_nonstop(scenario, inputs=["speed_bound_command"]))
    source = builder.AddSystem(TrajectorySource(bound))
    builder.Connect(source.get_output_port(), loop.GetInputPort("speed_bound_command"))
    names = ("carrier_state", "speed_bound", "load_state", "reference")
    sinks = {
        name: LogVectorOutput(loop.GetOutputPort(name), builder, publish_period=0.01)
        for name in names
    }
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    config = with_largest_step(scenario.simulator_config, diagram, context)
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(duration)

    logs = {name: sink.FindLog(context) for name, sink in sinks.items()}
    times = logs["carrier_state"].sample_times()
    states, bounds, load, reference = (logs[name].data() for name in names)
    velocities = np.split(states, 2)[1].reshape(-1, 3, len(times))
    slowest = np.linalg.norm(velocities, axis=1).min(axis=0)
    for time in np.linspace(0, duration, 7):
        k = np.searchsorted(times, time - 1e-6)
        print(f"t = {times[k]:5.2f} s: bound {bounds[0, k]:.3f}, slowest {slowest[k]:.3f} m/s")
    errors = np.linalg.norm((load - reference[:13])[4:7], axis=0)
    print(f"least speed above the bound {np.min(slowest - bounds[0]):.4f} m/s")
    print(f"mean load error {1e3 * errors.mean():.2f} mm")


if __name__ == "__main__":
    main()
