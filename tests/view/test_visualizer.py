"""The visualizer beside the loop: what it shows, and that it changes nothing else."""

import time

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from helpers import circling_run
from pydrake.math import RigidTransform
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from scenes import Screen, instant, shown, watch

from drake_nonstop import (
    ConstantParameters,
    NonstopVisualizer,
    ScenarioError,
    SceneConfig,
    make_nonstop,
    set_equilibrium,
    show_in,
    start_meshcat,
)
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario


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


@pytest.mark.parametrize(("tick", "least", "most"), [(0.0, 1, 1), (1.0, 20, 1000)])
def test_it_shows_the_start_and_frames_as_they_are_due_and_what_is_forced(
    monkeypatch, tick, least, most
):
    class Clocked(Screen):
        def SetSimulationTime(self, at):  # noqa: N802
            times.append(at)

    times, clock = [], iter(range(10**9))
    monkeypatch.setattr(time, "perf_counter", lambda: tick * next(clock))  # s
    scenario, builder = short(), DiagramBuilder()
    nonstop = builder.AddSystem(make_nonstop(scenario))
    visualizer = NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, Clocked())
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    simulator.AdvanceTo(0.1)
    assert times[0] == 0.0
    assert least <= len(times) <= most
    assert times == sorted(times)
    visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(context))
    assert times[-1] == 0.1


def test_all_but_load_carriers_and_tensions_may_be_left_out_or_not_be_finite():
    aircraft = aircraft_run(0.1, wind=(2.0, 0.0, 0.0))
    given = instant(aircraft, 3)
    left_out = {name: given[name] for name in given.keys() - {"aircraft_state", "wind"}}
    carrier = "/nonstop/carriers/0"
    with_all, without = (shown(aircraft.scenario, each) for each in (given, left_out))
    assert with_all.colours.keys() - without.colours.keys() == {
        f"/nonstop/carriers/{i}/wing" for i in range(4)
    }
    assert not np.allclose(with_all.matrices[carrier], without.matrices[carrier])
    run = circling_run()
    instants = [instant(run), instant(run, 1, tensions=[1.0, np.nan, 1.0, 1.0])]
    first, last = (screen.matrices[carrier] for screen in watch(run.scenario, instants, Screen()))
    np.testing.assert_array_equal(first, last)  # what is not finite is left to the blocks


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
def test_it_shows_any_scenario_in_place_of_an_earlier_one(meshcat, name, changes, last):
    meshcat.SetTransform("/mine", RigidTransform())
    simulate(short(name, 0.02, *changes), viewers=[show_in(meshcat)])
    assert meshcat.HasPath(f"/nonstop/{last}")
    count = len(load_scenario(name).system.attachments)
    assert not meshcat.HasPath(f"/nonstop/carriers/{count}")
    assert meshcat.HasPath("/mine")


def test_what_cannot_be_shown_or_shows_nothing_is_refused(meshcat):
    with pytest.raises(ScenarioError, match=r"^viewers = .*: give a list of functions, such"):
        simulate(short(), viewers=[meshcat])
    scenario = short()
    scenario.scene = SceneConfig(wing_span=0.0)
    with pytest.raises(ScenarioError, match=r"^scene\.wing_span = .*greater than zero"):
        NonstopVisualizer(scenario, meshcat)
