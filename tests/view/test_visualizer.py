"""The visualizer beside the loop: what it shows, and that it changes nothing else."""

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.blocks.optimization_layer import ConstantParameters
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view import nonstop_visualizer
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.nonstop_visualizer import NonstopVisualizer, show_in
from drake_nonstop.view.scene import ROOT


@pytest.fixture(scope="module")
def meshcat():
    return start_meshcat()


def short(name="quintic", duration=0.3, *changes):
    return load_scenario(name, [f"simulation_duration={duration}", *changes])


def test_a_run_is_the_same_to_the_bit_with_any_number_of_viewers():
    alone = simulate(short(), engine="diagram")
    watched = simulate(short(), viewers=[show_in(start_meshcat()) for _ in range(2)])
    assert alone.signals.keys() == watched.signals.keys()
    for name, values in alone.signals.items():
        np.testing.assert_array_equal(values, watched.signals[name], err_msg=name)
    np.testing.assert_array_equal(alone.steps["time"], watched.steps["time"])


def beside(scenario, meshcat):
    """A simulator of the loop with a visualizer, the latter, and the times that it shows."""
    builder = DiagramBuilder()
    nonstop = builder.AddSystem(make_nonstop(scenario))
    visualizer = NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, meshcat)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    shown = []
    visualizer.scene.show = lambda canvas, snapshot: shown.append(snapshot.time)
    return simulator, visualizer, shown


@pytest.mark.parametrize(("period", "least", "most"), [(1e3, 1, 1), (1e-6, 20, 1000)])
def test_it_shows_the_start_and_frames_at_the_frame_rate_and_what_is_forced(
    meshcat, monkeypatch, period, least, most
):
    monkeypatch.setattr(nonstop_visualizer, "FRAME_TIME", period)
    simulator, visualizer, shown = beside(short(), meshcat)
    simulator.AdvanceTo(0.1)
    assert shown[0] == 0.0
    assert least <= len(shown) <= most
    assert shown == sorted(shown)
    visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(simulator.get_context()))
    assert shown[-1] == 0.1


def test_all_but_load_carriers_and_tensions_may_come_from_ports_or_not_at_all(meshcat):
    run, instants = aircraft_run(0.1, wind=(2.0, 0.0, 0.0)), []
    visualizer = NonstopVisualizer(run.scenario, meshcat)
    visualizer.scene.show = lambda canvas, snapshot: instants.append(snapshot)
    context = visualizer.CreateDefaultContext()
    given = {name: run.signal(name)[3] for name in NonstopVisualizer.reads[:4]}
    others = {name: run.signal(name)[3] for name in ("aircraft_state", "wind")}
    for values in (given, others | {"speed_bound": [0.7]}, {"tensions": [1.0, np.nan, 1.0, 1.0]}):
        for name, value in values.items():
            visualizer.GetInputPort(name).FixValue(context, value)
        visualizer.ForcedPublish(context)
    without, with_all = instants  # what is not finite is left to the blocks
    assert without.speed_bound == run.scenario.speed_bound
    assert with_all.speed_bound == 0.7
    for name, value in others.items():
        assert getattr(without, name) is None
        np.testing.assert_array_equal(getattr(with_all, name), value)
    assert not meshcat.HasPath(f"{ROOT}/carriers/0/mark")


def test_it_can_stand_beside_a_loop_whose_layer_has_no_bound(meshcat):
    class Plain(ConstantParameters):
        """A layer of a user's own."""

        def DeclareVectorOutputPort(self, name, *arguments):  # noqa: N802
            if name != "speed_bound":
                super().DeclareVectorOutputPort(name, *arguments)

    run = simulate(short(), viewers=[show_in(meshcat)], optimization_layer=Plain)
    assert run.time[-1] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("name", "changes", "last"),
    [
        ("three_carriers", [], "carriers/2/mark"),
        ("static_hold_open_loop", [], "carriers/3/mark"),
        ("line", [], "carriers/3/mark"),
        ("aircraft_rest", ["cables=LumpedCables", "cables.nodes=2"], "cables/3/2"),
    ],
)
def test_it_shows_any_scenario(meshcat, name, changes, last):
    simulate(short(name, 0.02, *changes), viewers=[show_in(meshcat)])
    assert meshcat.HasPath(f"{ROOT}/{last}")
    count = len(load_scenario(name).system.attachments)
    assert not meshcat.HasPath(f"{ROOT}/carriers/{count}")


def test_viewers_have_to_be_functions(meshcat):
    with pytest.raises(ScenarioError, match=r"^viewers = .*: give a list of functions, such"):
        simulate(short(), viewers=[meshcat])


def test_help_shows_the_ports_with_their_sizes():
    ports = "`load_state` (13)", "`reference` (22)", "`carrier_state` (6n)", "`tensions` (n)"
    for line in (*ports, "`aircraft_state` (4n, may", "`wind` (3n, may"):
        assert line in NonstopVisualizer.__doc__
