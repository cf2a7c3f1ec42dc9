"""The visualizer beside the loop: what it shows, and that it changes nothing else."""

import base64
import re

import msgpack
import numpy as np
import pytest
from aircraft_runs import aircraft_run
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from drake_nonstop.blocks.optimization_layer import ConstantParameters
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError
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


def beside(scenario, meshcat, **options):
    """A simulator of the loop with a visualizer, and the latter."""
    nonstop = make_nonstop(scenario)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    visualizer = NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, meshcat, **options)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    return simulator, visualizer


def test_it_shows_the_start_and_frames_at_the_frame_rate(meshcat):
    frames = {}
    for rate in (1e-3, 1e6):
        simulator, visualizer = beside(short(), meshcat, frame_rate=rate)
        shown = []
        visualizer.scene.show = lambda canvas, snapshot, shown=shown: shown.append(snapshot.time)
        simulator.AdvanceTo(0.1)
        frames[rate] = shown
    assert frames[1e-3] == [0.0]
    assert len(frames[1e6]) >= 20  # every step
    assert frames[1e6] == sorted(frames[1e6])


def test_a_forced_publish_shows_the_instant(meshcat):
    simulator, visualizer = beside(short(), meshcat, frame_rate=1e-3)
    simulator.AdvanceTo(0.2)
    before = transforms(meshcat)
    visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(simulator.get_context()))
    assert all(a != b for a, b in zip(before[2:], transforms(meshcat)[2:], strict=True))


def test_a_new_run_is_drawn_from_its_start(meshcat):
    simulator, visualizer = beside(short(), meshcat, frame_rate=1e-3)
    simulator.Initialize()
    at_start = transforms(meshcat)
    simulator.AdvanceTo(0.2)
    context = visualizer.GetMyContextFromRoot(simulator.get_context())
    visualizer.ForcedPublish(context)
    assert transforms(meshcat) != at_start
    simulator, visualizer = beside(short(), meshcat, frame_rate=1e-3)
    simulator.Initialize()
    assert transforms(meshcat) == at_start


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


@pytest.mark.parametrize("rate", [0.0, -1.0, float("inf"), "fast"])
def test_bad_frame_rate(meshcat, rate):
    with pytest.raises(ScenarioError, match=r"visualizer\.frame_rate = "):
        NonstopVisualizer(SystemParameters(), meshcat, frame_rate=rate)


def test_viewers_have_to_be_functions(meshcat):
    with pytest.raises(ScenarioError, match=r"^viewers = .*: give a list of functions, such"):
        simulate(short(), viewers=[meshcat])


def animation(meshcat):
    """The tracks of the published animation: (path, name) -> {frame: value}."""
    meshcat.PublishRecording()
    commands = re.findall(r"octet-binary;base64,([\w+/=]+)", meshcat.StaticHtml())
    (sent,) = (
        message
        for message in (msgpack.unpackb(base64.b64decode(each)) for each in commands[-3:])
        if message["type"] == "set_animation"
    )
    return {
        (each["path"], track["name"]): {key["time"]: key["value"] for key in track["keys"]}
        for each in sent["animations"]
        for track in each["clip"]["tracks"]
    }


def test_a_recording_has_a_frame_per_instant_at_the_signals_poses():
    meshcat, rate = start_meshcat(), 50.0
    nonstop, builder = make_nonstop(short()), DiagramBuilder()
    builder.AddSystem(nonstop)
    NonstopVisualizer.AddToBuilder(builder, nonstop, short(), meshcat, frame_rate=1e-3)
    logs = [
        LogVectorOutput(nonstop.GetOutputPort(name), builder)
        for name in ("load_state", "reference", "carrier_state")
    ]
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(short().simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    simulator.Initialize()  # which shows the start already
    meshcat.StartRecording(frames_per_second=rate)
    simulator.AdvanceTo(0.3)
    meshcat.StopRecording()
    simulator.AdvanceTo(0.4)
    load, reference, carriers = (log.FindLog(context) for log in logs)
    times = load.sample_times()
    recorded = np.flatnonzero((times > 0) & (times <= 0.3))
    frames, first = np.unique(np.floor(times[recorded] * rate), return_index=True)
    assert len(frames) == 16
    tracks = animation(meshcat)
    for path, log, rows in (
        ("load", load, slice(4, 7)),
        ("reference", reference, slice(4, 7)),
        ("carriers/0", carriers, slice(0, 3)),
        ("carriers/3", carriers, slice(9, 12)),
    ):
        keys = tracks[f"{ROOT}/{path}", ".position"]
        if path.startswith("carriers"):
            assert list(keys) == frames.tolist()
        for frame, value in keys.items():
            expected = log.data()[rows, recorded[first[int(frame)]]]
            np.testing.assert_allclose(value, expected, atol=1e-12)
    ends = load.data()[4:7, 0] + np.array(short().system.attachments[1])
    length = np.linalg.norm(carriers.data()[3:6, 0] - ends)
    np.testing.assert_allclose(tracks[f"{ROOT}/cables/1", ".scale"][0], [1, 1, length], rtol=1e-2)
    assert (f"{ROOT}/carriers/0/mark/<object>", ".material.color") in tracks
    assert not any(path.startswith("/Cameras") for path, _ in tracks)


def test_nothing_is_recorded_where_the_meshcat_does_not(meshcat):
    simulator, _ = beside(short(), meshcat)
    simulator.AdvanceTo(0.1)
    assert not [path for path, name in animation(meshcat) if name == ".position"]


def fixed(meshcat, position, **options):
    """A forced publish of a visualizer of a load at a position."""
    visualizer = NonstopVisualizer(SystemParameters(), meshcat, **options)
    context = visualizer.CreateDefaultContext()
    load = np.array([1.0, 0, 0, 0, *position, *np.zeros(15)])
    for name, value in (
        ("load_state", load[:13]),
        ("reference", load),
        ("carrier_state", np.linspace(0, 1, 24)),
        ("tensions", np.ones(4)),
    ):
        visualizer.GetInputPort(name).FixValue(context, value)
    visualizer.ForcedPublish(context)


def test_two_loops_share_a_meshcat():
    meshcat = start_meshcat()
    fixed(meshcat, [0, 0, 0])
    camera = "/Cameras/default/rotated/<object>", "position"
    view = meshcat._GetPackedProperty(*camera)
    first = transforms(meshcat)
    fixed(meshcat, [30.0, 0, 0], path="/second/loop")
    assert transforms(meshcat) == first
    assert meshcat._GetPackedProperty(*camera) == view
    assert meshcat.HasPath("/second/loop/carriers/3/mark")
    sent = msgpack.unpackb(meshcat._GetPackedTransform("/second/loop/load"))
    assert sent["matrix"][12:15] == [30.0, 0, 0]
    fixed(meshcat, [1.0, 0, 0])  # again, in the place of the first alone
    assert meshcat.HasPath("/second/loop/carriers/3/mark")
    assert meshcat._GetPackedProperty(*camera) != view


@pytest.mark.parametrize(
    "path", ["", "/", "second", "/a/", "/a//b", "/Cameras/a", "/Grid", 3, None]
)
def test_bad_path(meshcat, path):
    with pytest.raises(
        ScenarioError, match=r"visualizer\.path = .*: give a path such as /nonstop_2"
    ):
        NonstopVisualizer(SystemParameters(), meshcat, path=path)


def test_help_shows_the_ports_with_their_sizes():
    ports = "`load_state` (13)", "`reference` (22)", "`carrier_state` (6n)", "`tensions` (n)"
    for line in (*ports, "`aircraft_state` (4n, may", "`wind` (3n, may", "`load_wind` (3, may"):
        assert line in NonstopVisualizer.__doc__
