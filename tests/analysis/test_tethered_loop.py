"""The sampled loop of load, cables, carriers and controllers, against the linearized diagram."""

import numpy as np
from pydrake.systems.analysis import Simulator

from drake_nonstop.analysis.tethered_loop import Carriers, Feedback, Orbit, maps_at
from drake_nonstop.diagrams.nonstop import make_blocks, make_nonstop
from drake_nonstop.loop.start import PlantStates
from drake_nonstop.loop.step import rates_jacobian
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.model.system import Model
from drake_nonstop.scenario.loading import load_scenario

RESTING = [
    "carrier_controller=FeedforwardCarrierPid",
    "load_trajectory.start_time=100",
    "optimization_layer=ConstantParameters",
]
OVERSTRONG = ["wrench_controller.orientation_gain=5", "wrench_controller.angular_velocity_gain=0.1"]


def orbits(model, count, first=None, amplitude=1.2, frequency=2.0):
    """The first of so many phases of the orbits of ξ (rad/s) and A (N) above a load at rest."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    for angle in (2 * np.pi * np.arange(count) / count)[:first]:
        waves = angle + model.pattern.phases
        forces = model.pseudo_inverse @ weight + model.pattern.basis @ (amplitude * np.cos(waves))
        rates = model.pattern.basis @ (-amplitude * frequency * np.sin(waves))
        f, r = forces.reshape(-1, 3), rates.reshape(-1, 3)
        second_rates = model.pattern.basis @ (-amplitude * frequency**2 * np.cos(waves))
        third_rates = model.pattern.basis @ (amplitude * frequency**3 * np.sin(waves))
        higher = (part.reshape(-1, 3) for part in (second_rates, third_rates))
        yield Orbit(f, r, *higher)


def maps_of(model, gains, count, is_measured, **parameters):
    feedback = Feedback(gains=gains, is_measured=is_measured, delay=0, period=0.01)
    carriers = Carriers(position_gain=1e4, velocity_gain=100.0)
    return maps_at(model, model, carriers, feedback, orbits(model, count, **parameters))


def test_without_feedback_the_modes_are_those_of_the_linearized_diagram():
    scenario = load_scenario("three_carriers", RESTING)
    scenario.optimization_layer.amplitude = 1.2
    loop = make_nonstop(scenario)
    modes = np.linalg.eigvals(rates_jacobian(loop, loop.CreateDefaultContext()))
    expected = modes[np.abs(modes) > 1e-6]  # the quaternion's norm has none
    assert len(expected) == 12 + 6 * 3
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    gains = make_blocks(scenario)["wrench_controller"].gains
    (own,) = maps_of(model, gains, 1, np.zeros(12))
    multipliers = np.linalg.eigvals(own)
    for value in np.exp(0.01 * expected):
        assert np.min(np.abs(multipliers - value)) < 1e-5


def test_a_deviation_goes_on_as_in_a_run():
    orbit = ["optimization_layer.amplitude=3", "optimization_layer.frequency=2"]
    scenario = load_scenario("three_carriers", [*RESTING, *orbit, *OVERSTRONG])
    loop = make_nonstop(scenario)
    states, spin = [], 1e-5 * np.array([1.0, -0.5, 2.0])
    for by in (0.0, 1.0):
        context = loop.CreateDefaultContext()
        load = loop.GetOutputPort("load_state").Eval(context).copy()
        LoadState.view(load).angular_velocity[:] += by * spin
        PlantStates(loop).set_states(context, load_state=load)
        simulator = Simulator(loop, context)
        simulator.get_mutable_integrator().set_maximum_step_size(2e-4)
        states.append([])
        for sample in range(1, 31):
            simulator.AdvanceTo(0.01 * sample)
            states[-1].append(loop.GetOutputPort("load_state").Eval(context).copy())
    flown, deviating = (LoadState.view(np.array(part)) for part in states)
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    gains = make_blocks(scenario)["wrench_controller"].gains
    maps = maps_of(model, gains, 314, np.ones(12), first=30, amplitude=3.0, frequency=2.0)
    found = [np.zeros(len(maps[0]))]
    found[0][6:9] = spin
    for own in maps:
        found.append(own @ found[-1])
    expected = deviating.angular_velocity - flown.angular_velocity
    difference = np.array(found)[1:, 6:9] - expected
    assert np.max(np.abs(difference)) < 0.025 * np.max(np.abs(expected))
