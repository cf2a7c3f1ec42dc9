"""Loops and simulations of the user's own are logged, judged and drawn from as the figure's."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.common import RandomGenerator
from pydrake.geometry import Role, SceneGraph
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    Simulator,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from drake_nonstop import (
    AddGeometry,
    Block,
    LogSignals,
    Run,
    ScenarioError,
    changed,
    compute_metrics,
    connect_by_name,
    connect_remaining,
    largest_step,
    load_scenario,
    make_blocks,
    make_nonstop,
    make_simulator,
    set_default_equilibrium,
    set_equilibrium,
    simulate,
    verify_step,
)

DURATION = 0.2  # s
CONSTANT = "optimization_layer=ConstantParameters"
DRAWN = (
    "simulated.load_mass=!Gaussian {mean: 1, stddev: 0.1}",
    "load_disturbance=!DisturbanceForce {force: [!Gaussian {mean: 0, stddev: 0.2}, 0, 0], "
    "gust_force: !Uniform {min: 0, max: 0.3}, seed: !Uniform {min: 0, max: 1e9}}",
    "wrench_controller.position_gain=!Uniform {min: 4, max: 6}",
)


def by_diagram(name, *overrides):
    """A scenario that flies as a Simulator of one's own does."""
    return load_scenario(
        name, [CONSTANT, "engine=diagram", f"simulation_duration={DURATION}", *overrides]
    )


@pytest.fixture(scope="module", params=nightly_beyond(1, "flights", [0.01, 0.0]))
def scenario(request):
    return by_diagram("line", f"control_period={request.param}")


@pytest.fixture(scope="module")
def shipped(scenario):
    return simulate(scenario)


def wrapped(scenario, **replacements):
    """The figure's blocks under other names, inside of a larger diagram."""
    blocks = make_blocks(scenario, **replacements)
    inner, builder = DiagramBuilder(), DiagramBuilder()
    connect_by_name(inner, {f"my_{name}": block for name, block in blocks.items()})
    loop = builder.AddNamedSystem("inner", inner.Build())
    for k in range(loop.num_output_ports()):
        builder.ExportOutput(loop.get_output_port(k), loop.get_output_port(k).get_name())
    return builder.Build()


def by_hand(scenario, **replacements):
    """The blocks one by one, and a system of Drake's beside them."""
    builder = DiagramBuilder()
    blocks = make_blocks(scenario, **replacements)
    for name, block in blocks.items():
        builder.AddNamedSystem(f"my_{name}", block)
    builder.AddSystem(ConstantVectorSource([1.0]))
    connect_remaining(builder)
    return builder.Build()


def assert_same(run, shipped):
    """Signals, steps and metrics to the bit, but for the names of blocks and for wall times."""
    np.testing.assert_array_equal(run.time, shipped.time)
    assert len(run.signals) == len(shipped.signals)
    for name, values in shipped.signals.items():
        assert run.signal(name.partition(".")[2]).tobytes() == values.tobytes(), name
    for name in shipped.steps.keys() - {"solve_time"}:
        assert run.steps[name].tobytes() == shipped.steps[name].tobytes(), name
    assert run.step == shipped.step
    measured = ("wall_s", "real_time_factor")
    of_both = [compute_metrics(each).items() for each in (run, shipped)]
    ours, theirs = ({k: v for k, v in items if k not in measured} for items in of_both)
    assert ours == theirs


@pytest.mark.parametrize("make_loop", [wrapped, by_hand])
def test_simulate_flies_a_loop_of_ones_own_like_the_figure(make_loop, scenario, shipped):
    run = simulate(scenario, make_loop=make_loop)
    assert_same(run, shipped)
    assert "my_load_plant.load_state" in run.signals
    assert verify_step(run).half_step == {"step_s": run.step / 2, "moved": {}}


@dataclass(kw_only=True)
class ScalarLastConfig:
    pass


class ScalarLast(Block):
    """A feedback with the quaternion in the order x, y, z, w."""

    reads = ("load_state",)
    makes = ("measured_load_state",)

    @staticmethod
    def equations(load_state):
        return np.concatenate([load_state[1:4], load_state[:1], load_state[4:]])


class ScalarLastRest(ScalarLast):
    """A reference at rest without a rotation, in the same order."""

    reads = ()
    makes = ("reference",)

    @staticmethod
    def equations():
        return np.eye(22)[3]


def started(diagram, turns=False):
    """A Simulator of a hand-made context; it may have a state in the order x, y, z, w."""
    simulator = Simulator(diagram)
    context = diagram.GetSubsystemByName("my_load_plant").GetMyMutableContextFromRoot(
        simulator.get_mutable_context()
    )
    state = context.get_continuous_state_vector().CopyToVector()
    state[:4] = np.roll(state[:4], -int(turns))
    context.SetContinuousState(state)
    simulator.Initialize()


def test_a_start_from_which_no_flight_begins_is_told_at_the_first_evaluation():
    scenario = by_diagram("line", "control_period=0.01")
    diagram = by_hand(scenario)
    with pytest.warns(match=r"^start = all carriers in one place: call set_equilibrium") as told:
        started(diagram)
    assert told[0].filename == __file__
    set_default_equilibrium(diagram)
    for engine in ("compiled", "diagram"):
        with pytest.warns(
            match=r"^measured_load_state = \[0.0.*, 1.0\], .*: begin .* w, x, y, z"
        ) as told:
            simulate(scenario, load_feedback=ScalarLast, engine=engine)
        assert told[0].filename == __file__
    continuous = by_hand(by_diagram("line", "control_period=0"))
    set_default_equilibrium(continuous)
    for loop in (diagram, continuous):
        with pytest.warns(match=r"^measured_load_state = \[0.0.*, 1.0\]"):
            started(loop, turns=True)
    with pytest.warns(match=r"^reference = \[0, 0, 0, 1\], .*: .* w, x, y, z"):
        simulate(scenario, load_trajectory=ScalarLastRest)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        started(diagram)
        simulate(scenario)


@pytest.mark.parametrize("box", ["load_plant", "carrier_dynamics", "load_trajectory"])
def test_a_block_around_the_loop_flies_as_one_of_it(box, scenario, shipped):
    """The loop takes what it makes as an input, and logs, geometry and equilibrium take that."""
    builder, blocks = DiagramBuilder(), make_blocks(scenario)
    loop = builder.AddSystem(make_nonstop(scenario, **{box: None}))
    block, scene_graph = builder.AddSystem(blocks[box]), builder.AddSystem(SceneGraph())
    connect_remaining(builder)
    logs = LogSignals.AddToBuilder(builder, loop)
    geometry = AddGeometry(builder, loop, scene_graph, scenario, collides=False)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    if box != "load_trajectory":  # whose state is none
        for own in (set_equilibrium, largest_step):
            with pytest.raises(
                ScenarioError, match=f"with the input {block.get_output_port(0).get_name()}: "
            ):
                own(loop, loop.GetMyMutableContextFromRoot(context))
    set_equilibrium(diagram, context)
    assert largest_step(diagram, context) > 0.005
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    simulator.AdvanceTo(DURATION)
    run = Run.from_logs(logs, context, scenario)
    for name in ("load_state", "carrier_state", "reference", "tensions"):
        np.testing.assert_allclose(run.signal(name), shipped.signal(name), rtol=0, atol=1e-9)
    poses = geometry.GetOutputPort("geometry_pose").Eval(geometry.GetMyContextFromRoot(context))
    seen = poses.value(geometry.load_frame).translation()
    np.testing.assert_allclose(seen, run.signal("load_state")[-1, 4:7], atol=1e-12)
    assert not scene_graph.model_inspector().GetAllGeometryIds(Role.kProximity)


@pytest.mark.parametrize("make_loop", [make_nonstop, by_hand])
def test_each_context_of_ones_own_simulation_has_a_run(make_loop, scenario, shipped):
    builder = DiagramBuilder()
    loop = builder.AddSystem(make_loop(scenario))
    logs = LogSignals.AddToBuilder(builder, loop)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    simulator.AdvanceTo(DURATION)
    run = Run.from_logs(logs, context, scenario)
    assert_same(run, shipped)
    with pytest.raises(ScenarioError, match=r"^run = from logs: give a run of simulate, which can"):
        verify_step(run)
    other = Simulator(simulator.get_system()).get_context()
    with pytest.raises(ScenarioError, match=r"^logs = no samples: advance a Simulator"):
        Run.from_logs(logs, other, scenario)
    # Again from the start, and initialized twice: the last flight counts.
    context.SetTime(0.0)
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    simulator.Initialize()
    simulator.Initialize()
    simulator.AdvanceTo(0.05)
    run = Run.from_logs(logs, context, scenario, wall_time=2.0)
    np.testing.assert_array_equal(run.time, shipped.time[:6])
    assert np.all(np.diff(run.steps["time"]) > 0)
    # The wrench controller's integral goes on from the first flight; the trajectory does not.
    expected = shipped.signal("reference")[:6]
    assert run.signal("reference").tobytes() == expected.tobytes()
    assert compute_metrics(run)["wall_s"] == 2.0


def test_a_loop_that_cannot_be_flown_is_refused(scenario):
    builder = DiagramBuilder()
    cables = {"cables": make_blocks(scenario)["cables"]}
    connect_by_name(builder, cables, inputs=["load_state", "carrier_state"])
    alone = builder.Build()
    for builder, loop, said in (
        (DiagramBuilder(), alone, "LogSignals = Diagram without output ports reference, .*: give"),
        (DiagramBuilder(), make_nonstop(scenario), "LogSignals = nonstop: add it to the builder"),
    ):
        with pytest.raises(ScenarioError, match=f"^{said}"):
            LogSignals.AddToBuilder(builder, loop)
    for make_loop, said in (
        (lambda scenario: alone, "Diagram without output ports"),
        (lambda scenario: 3, "3: return a"),
    ):
        with pytest.raises(ScenarioError, match=f"^make_loop = {said}"):
            simulate(scenario, make_loop=make_loop)


@pytest.mark.parametrize(
    "overrides",
    [
        ("control_period=0", "simulator_config.max_step_size=0.0023"),
        ("optimization_layer=RecedingHorizonOptimizer",),
    ],
)
def test_a_drawn_simulator_flies_as_simulate_does(overrides):
    """With the scenario's own random_seed, once the context was reset to its defaults."""
    scenario = changed(by_diagram("quintic", *DRAWN), [*overrides, "random_seed=8"])
    simulator = make_simulator(scenario)
    system, context = simulator.get_system(), simulator.get_mutable_context()
    system.SetRandomContext(context, RandomGenerator(1))
    simulator.AdvanceTo(DURATION)
    run = simulate(scenario)
    assert run.scenario == scenario.sampled()
    for name in ("load_state", "carrier_state", "tensions", "wrench"):
        value = system.GetOutputPort(name).Eval(context)
        np.testing.assert_array_equal(value, run.signal(name)[-1])
    with pytest.raises(ScenarioError, match="replacement cables = None: give a block"):
        make_simulator(scenario, cables=None)
