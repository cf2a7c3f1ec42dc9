"""A loop wired by hand with a block beyond the figure's: a low-pass behind noisy sensors.

In the place of `load_feedback`, `sensors` makes a signal of its own, and `low_pass` of that the
one that all controllers read.
"""

from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Demultiplexer, FirstOrderLowPassFilter, Multiplexer

import drake_nonstop as dn


def low_pass(time_constant: float) -> System:
    """Passes the sensed pose (7) on, and the velocities (6) through Drake's own filter."""
    builder = DiagramBuilder()
    parts = builder.AddSystem(Demultiplexer([7, 6]))
    velocities = builder.AddSystem(FirstOrderLowPassFilter(time_constant, 6))
    whole = builder.AddSystem(Multiplexer([7, 6]))
    builder.Connect(parts.get_output_port(0), whole.get_input_port(0))
    builder.Connect(parts.get_output_port(1), velocities.get_input_port())
    builder.Connect(velocities.get_output_port(), whole.get_input_port(1))
    builder.ExportInput(parts.get_input_port(), "sensed_load_state")
    builder.ExportOutput(whole.get_output_port(), "measured_load_state")
    return builder.Build()


def sensors(model: dn.Model) -> System:
    """The package's noisy feedback, with another name for its output."""
    builder = DiagramBuilder()
    noisy = builder.AddSystem(dn.NoisyFeedback(model, dn.NoisyFeedbackConfig(velocity_noise=0.1)))
    builder.ExportInput(noisy.GetInputPort("load_state"), "load_state")
    builder.ExportOutput(noisy.GetOutputPort("measured_load_state"), "sensed_load_state")
    return builder.Build()


def main(duration: float = 15.0) -> None:
    """Compares two time constants: the load's error and the carriers' largest acceleration."""
    scenario = dn.load_scenario("quintic", [f"simulation_duration={duration}"])
    for time_constant in (0.003, 0.03):
        blocks = dn.make_blocks(scenario, load_feedback=None, extra={"sensors": sensors})
        builder, root = DiagramBuilder(), DiagramBuilder()
        dn.connect_by_name(builder, blocks | {"low_pass": low_pass(time_constant)})
        loop = root.AddSystem(builder.Build())
        logs = dn.LogSignals.AddToBuilder(root, loop)
        simulator = Simulator(root.Build())
        context = simulator.get_mutable_context()
        dn.set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
        config = dn.with_largest_step(scenario.simulator_config, simulator.get_system(), context)
        ApplySimulatorConfig(config, simulator)
        simulator.AdvanceTo(duration)
        run = dn.Run.from_logs(logs, context, scenario)
        metrics = dn.compute_metrics(run)  # write_results(run, folder): figures and a replay, too
        error = 1e3 * metrics["load"]["position_error_mean_m"]
        most = metrics["carriers"]["acceleration_max_m_s2"]
        print(f"{1e3 * time_constant:2.0f} ms: mean load error {error:.2f} mm, {most:.0f} m/s^2")


if __name__ == "__main__":
    main()
