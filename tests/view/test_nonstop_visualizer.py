"""The visualizer beside the loop: what it shows, and that it changes nothing else."""

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.blocks.optimization_layer import ConstantParameters
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view import nonstop_visualizer
from drake_nonstop.view.canvas import ROOT
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.nonstop_visualizer import NonstopVisualizer, show_in


@pytest.fixture(scope="module")
def meshcat():
    return start_meshcat()


def transforms(meshcat):
    names = ["load", "reference", "carriers/0", "cables/3"]
    return [meshcat._GetPackedTransform(f"{ROOT}/{name}") for name in names]


def short(name="quintic", duration=0.3):
    return load_scenario(name, [f"simulation_duration={duration}"])


@pytest.mark.parametrize("count", [2])
def test_a_run_is_the_same_to_the_bit_with_any_number_of_viewers(count):
    alone = simulate(short(), engine="diagram")
    watched = simulate(short(), viewers=[show_in(start_meshcat()) for _ in range(count)])
    assert alone.signals.keys() == watched.signals.keys()
    for name, values in alone.signals.items():
        np.testing.assert_array_equal(values, watched.signals[name], err_msg=name)
    np.testing.assert_array_equal(alone.steps["time"], watched.steps["time"])


def beside(scenario, meshcat):
    """A simulator of the loop with a visualizer, and the latter."""
    nonstop = make_nonstop(scenario)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    visualizer = NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, meshcat)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    return simulator, visualizer


def test_it_shows_the_start_and_frames_at_the_frame_rate(meshcat, monkeypatch):
    frames = {}
    for period in (1e3, 1e-6):
        monkeypatch.setattr(nonstop_visualizer, "FRAME_TIME", period)
        simulator, visualizer = beside(short(), meshcat)
        shown = []
        visualizer.scene.show = lambda canvas, snapshot, shown=shown: shown.append(snapshot.time)
        simulator.AdvanceTo(0.1)
        frames[period] = shown
    assert frames[1e3] == [0.0]
    assert len(frames[1e-6]) >= 20  # every step
    assert frames[1e-6] == sorted(frames[1e-6])


def test_a_forced_publish_shows_the_instant(meshcat):
    simulator, visualizer = beside(short(), meshcat)
    simulator.AdvanceTo(0.2)
    before = transforms(meshcat)
    visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(simulator.get_context()))
    assert all(a != b for a, b in zip(before[2:], transforms(meshcat)[2:], strict=True))


def test_the_bound_may_come_from_a_port_or_not_at_all(meshcat):
    bounds = []
    visualizer = NonstopVisualizer(SystemParameters(), meshcat, speed_bound=0.3)
    visualizer.scene.show = lambda canvas, snapshot: bounds.append(snapshot.speed_bound)
    context = visualizer.CreateDefaultContext()
    upright = [1.0, *[0.0] * 21]
    for name, value in (
        ("load_state", upright[:13]),
        ("reference", upright),
        ("carrier_state", np.linspace(0, 1, 24)),
        ("tensions", np.ones(4)),
    ):
        visualizer.GetInputPort(name).FixValue(context, value)
    visualizer.ForcedPublish(context)
    visualizer.GetInputPort("speed_bound").FixValue(context, 0.7)
    visualizer.ForcedPublish(context)
    assert bounds == [0.3, 0.7]
    visualizer.GetInputPort("tensions").FixValue(context, [1.0, np.nan, 1.0, 1.0])
    visualizer.ForcedPublish(context)  # left to the blocks
    assert len(bounds) == 2


def test_it_can_stand_beside_a_loop_whose_layer_has_no_bound(meshcat):
    class Plain(ConstantParameters):
        """A layer of a user's own."""

        def DeclareVectorOutputPort(self, name, *arguments):  # noqa: N802
            if name != "speed_bound":
                super().DeclareVectorOutputPort(name, *arguments)

    run = simulate(short(), viewers=[show_in(meshcat)], optimization_layer=Plain)
    assert run.time[-1] == pytest.approx(0.3)


@pytest.mark.parametrize("name", ["three_carriers", "static_hold_open_loop", "line"])
def test_it_shows_any_scenario(meshcat, name):
    simulate(short(name, 0.1), viewers=[show_in(meshcat)])
    n = len(load_scenario(name).system.attachments)
    assert meshcat.HasPath(f"{ROOT}/carriers/{n - 1}/mark")
    assert not meshcat.HasPath(f"{ROOT}/carriers/{n}")


def test_it_shows_cables_with_nodes(meshcat):
    changes = ["cables=LumpedCables", "cables.nodes=2", "simulation_duration=0.01"]
    simulate(load_scenario("aircraft_rest", changes), viewers=[show_in(meshcat)])
    assert meshcat.HasPath(f"{ROOT}/cables/3/2")
    assert not meshcat.HasPath(f"{ROOT}/cables/3/3")


def test_aircraft_and_wind_may_come_from_ports(meshcat):
    run = aircraft_run(0.1, wind=(2.0, 0.0, 0.0))
    instants = []
    visualizer = NonstopVisualizer(run.scenario.system, meshcat)
    visualizer.scene.show = lambda canvas, snapshot: instants.append(snapshot)
    context = visualizer.CreateDefaultContext()
    plain = ["load_state", "reference", "carrier_state", "tensions"]
    for names in (plain, ["aircraft_state", "wind", "load_wind"]):
        for name in names:
            visualizer.GetInputPort(name).FixValue(context, run.signal(name)[3])
        visualizer.ForcedPublish(context)
    without, with_all = instants
    assert without.aircraft_state is None
    assert without.load_wind is None
    np.testing.assert_array_equal(with_all.aircraft_state, run.signal("aircraft_state")[3])
    np.testing.assert_array_equal(with_all.wind, np.tile([2.0, 0.0, 0.0], 4))
    assert meshcat.HasPath(f"{ROOT}/wind/shaft")
    assert not meshcat.HasPath(f"{ROOT}/carriers/0/mark")


def test_viewers_have_to_be_functions(meshcat):
    with pytest.raises(ScenarioError, match=r"^viewers = .*: give a list of functions, such"):
        simulate(short(), viewers=[meshcat])


def test_help_shows_the_ports_with_their_sizes():
    ports = "`load_state` (13)", "`reference` (22)", "`carrier_state` (6n)", "`tensions` (n)"
    for line in (*ports, "`aircraft_state` (4n, may", "`wind` (3n, may", "`load_wind` (3, may"):
        assert line in NonstopVisualizer.__doc__
