"""The block that made a value which is not finite is named, not the one that read it."""

from functools import partial

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop import Cables, RunStopped, load_scenario, make_blocks, simulate
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.systems.wiring import output_names, wires


class Faulty(LeafSystem):
    """Makes constant signals; one of them becomes something else after 0.1 s."""

    def __init__(self, signal, fault):
        super().__init__()
        signals = {signal, *ALSO.get(signal, ())}
        for name in sorted(signals):
            value = VALUES[name]

            def calc(context, output, name=name, value=value):
                is_wrong = name == signal and context.get_time() > 0.1
                output.SetFromVector(np.array(value) + (fault if is_wrong else 0.0))

            self.DeclareVectorOutputPort(name, len(value), calc)


VALUES = {
    "disturbance_wrench": np.zeros(6),
    "parameters": [2.0, 1.2],
    "phase": np.zeros(2),
    "planned": [0.0, 2.0, 1.2, *np.zeros(5)],
    "internal_force": np.zeros(8),
    "internal_force_higher_rates": np.zeros(8),
}
# What other blocks read of the one that makes a signal.
ALSO = {
    "phase": ["planned"],
    "planned": ["phase"],
    "internal_force": ["internal_force_higher_rates"],
    "internal_force_higher_rates": ["internal_force"],
}
SIGNALS = [
    ("load_disturbance", "disturbance_wrench", []),
    ("optimization_layer", "parameters", []),
    ("phase", "planned", []),
    ("internal_force", "internal_force", []),
    ("internal_force", "internal_force_higher_rates", []),
]
CASES = [  # the signals with NaN first
    (*signal, fault) for fault in (np.nan, 1e12, np.inf) for signal in SIGNALS
]


@pytest.mark.parametrize(
    ("box", "signal", "settings", "fault"), nightly_beyond(7, "adversary", CASES)
)
def test_the_source_of_a_value_is_named(box, signal, settings, fault):
    overrides = ["simulation_duration=0.2", *settings]
    if box != "optimization_layer":
        overrides.append("optimization_layer=ConstantParameters")
    if box != "load_disturbance":
        overrides.append("load_feedback=DesiredStateFeedback")
    scenario = load_scenario("quintic", overrides)
    with pytest.raises(RunStopped, match=f"diverged at t = 0.1.* s: {box} made a value"):
        simulate(scenario, **{box: lambda model: Faulty(signal, fault)})


def test_a_fault_inside_the_loop_is_blamed_on_its_block():
    class FaultyCables(LeafSystem):
        """Cables whose forces are no numbers after 0.1 s."""

        def __init__(self, model):
            super().__init__()
            load = self.DeclareVectorInputPort("load_state", 13)
            carriers = self.DeclareVectorInputPort("carrier_state", 6 * model.n)
            cables = Cables(model)

            def forces(context, output):
                own = cables.CreateDefaultContext()
                cables.GetInputPort("load_state").FixValue(own, load.Eval(context))
                cables.GetInputPort("carrier_state").FixValue(own, carriers.Eval(context))
                values = cables.GetOutputPort("cable_forces").Eval(own)
                output.SetFromVector(values * (np.nan if context.get_time() > 0.1 else 1.0))

            self.DeclareVectorOutputPort("cable_forces", 3 * model.n, forces)
            self.DeclareVectorOutputPort("tensions", model.n, lambda context, output: None)

    with pytest.raises(RunStopped, match=r"diverged at t = 0\.1\d* s: cables made a value"):
        simulate(load_scenario("quintic", ["simulation_duration=0.3"]), cables=FaultyCables)


def _wired_by_hand(blocks, names):
    """A diagram without a name of its own, of blocks by these names; "" for those without one."""
    builder = DiagramBuilder()
    for name, block in blocks.items():
        block.set_name(name if names else "")
        builder.AddSystem(block)
    for source, signal, reader, port in wires(blocks):
        builder.Connect(blocks[source].GetOutputPort(signal), blocks[reader].GetInputPort(port))
    for block in blocks.values():
        for port in output_names(block):
            builder.ExportOutput(block.GetOutputPort(port), port)
    return builder.Build()


def _loop(scenario, *, names, **replacements):
    return _wired_by_hand(make_blocks(scenario, **replacements), names)


def faulty_disturbance(model):
    return Faulty("disturbance_wrench", np.nan)


BRIEF = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]


@pytest.mark.parametrize("plant", ["LoadPlant", "MultibodyLoadPlant"])
@pytest.mark.parametrize("is_inside", [False, True])
@pytest.mark.parametrize("names", [False, True])
def test_blocks_wired_by_hand_are_called_by_their_names_or_classes(plant, is_inside, names):
    scenario = load_scenario("quintic", [*BRIEF, f"load_plant={plant}"])
    loop = _loop(
        scenario, names=names, load_disturbance=lambda model: Faulty("disturbance_wrench", np.nan)
    )
    block = "load_plant" if names else plant
    if is_inside:
        outer = DiagramBuilder()
        outer.AddNamedSystem("own", loop)
        loop, block = outer.Build(), f"own.{block}"
    context = loop.CreateDefaultContext()
    context.SetTime(1.0)
    with pytest.raises(NotFiniteError, match=rf"^{block} was given a value that is not finite"):
        loop.EvalTimeDerivatives(context)


@pytest.mark.parametrize(("names", "block"), [(False, "Faulty"), (True, "load_disturbance")])
def test_the_source_of_a_value_is_named_in_a_loop_wired_by_hand(names, block):
    with pytest.raises(RunStopped, match=rf"diverged at t = 0.1\d+ s: {block} made a value"):
        simulate(
            load_scenario("quintic", ["simulation_duration=0.2", *BRIEF[1:]]),
            make_loop=partial(_loop, names=names),
            load_disturbance=faulty_disturbance,
        )


def test_a_load_of_many_tonnes_does_not_count_as_diverged():
    """Masses of 500 t on cables as strong: forces of 5 MN are sound."""
    factor = 5e5
    overrides = [
        f"system.load_mass={factor}",
        f"system.load_inertia={(0.01 * factor * np.eye(3)).tolist()}",
        f"system.load_drag={0.7 * factor}",
        f"system.cable_stiffness={500 * factor}",
        f"system.cable_damping={0.1 * factor}",
        f"system.carrier_mass={0.1 * factor}",
        "optimization_layer=!ConstantParameters {}",
        f"optimization_layer.amplitude={1.2 * factor}",
        f"carrier_controller.position_gain={1000 * factor}",
        f"carrier_controller.velocity_gain={10 * factor}",
        *(
            f"wrench_controller.{name}={gain * factor}"
            for name, gain in (
                ("position_gain", 5.0),
                ("velocity_gain", 2.0),
                ("position_integral_gain", 0.9),
                ("orientation_gain", 0.5),
                ("angular_velocity_gain", 0.06),
                ("orientation_integral_gain", 0.1),
            )
        ),
        "simulation_duration=0.2",
    ]
    heavy = simulate(load_scenario("quintic", overrides))
    light = simulate(
        load_scenario(
            "quintic", ["optimization_layer=!ConstantParameters {}", "simulation_duration=0.2"]
        )
    )
    assert np.abs(heavy.signal("load_state") - light.signal("load_state")).max() < 1e-6
    assert heavy.signal("tensions").max() > 1e6
