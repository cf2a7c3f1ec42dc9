"""The closed loop in Drake's other scalar types: linearized, differentiated, printed, cloned."""

import numpy as np
import pytest
from helpers import difference, nightly_beyond, output
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, Simulator_
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from drake_nonstop import ScenarioError, load_scenario, make_nonstop, set_equilibrium
from drake_nonstop.loop.parameters import set_parameter
from drake_nonstop.loop.step import largest_step
from drake_nonstop.systems.block import number
from drake_nonstop.systems.wiring import output_sizes

CONSTANT = "optimization_layer=ConstantParameters"
SWAPS = [  # the default optimizer, and constant parameters with everything else
    [],
    [CONSTANT, "load_feedback=!EstimatedFeedback {delay: 0.02, position_noise: 0.01}"],
    [
        *(CONSTANT, "load_plant=MultibodyLoadPlant"),
        "load_disturbance=!DisturbanceForce {gust_force: 1.0}",
    ],
    [
        CONSTANT,
        "carrier_dynamics=!LimitedCarriers {has_weight: true, feels_cable: true}",
    ],
    [
        *("control_period=0", CONSTANT, "carrier_trajectory=MeasuredCarrierTrajectory"),
        "carrier_controller=CarrierPid",
    ],
    ["control_period=0", CONSTANT, "phase=PaperPhase"],
    [CONSTANT, "load_feedback=!NoisyFeedback {delay: 0.02, position_noise: 0.01}"],
    [CONSTANT, "carrier_controller=!FeedforwardCarrierPid {integral_gain: 3}"],
    [CONSTANT, "carrier_dynamics=LimitedCarriers", "load_feedback=DesiredStateFeedback"],
]


def swaps(count):
    """The first few and, every night, all."""
    return pytest.mark.parametrize(
        "overrides",
        nightly_beyond(count, "engines", SWAPS),
        ids=lambda s: ", ".join(s) or "default",
    )


def started(overrides, scenario="quintic"):
    """A scenario, its loop and a context at the start, after its initialization events."""
    config = load_scenario(scenario, overrides)
    loop = make_nonstop(config)
    context = loop.CreateDefaultContext()
    set_equilibrium(loop, context)
    Simulator(loop, context).Initialize()
    return config, loop, context


def rate(loop, context):
    return loop.EvalTimeDerivatives(context).CopyToVector()


@pytest.fixture(scope="module")
def linearized():
    """The loop with continuous controllers, its context at the start, and A of ẋ = A x."""
    _, loop, context = started(["control_period=0", CONSTANT])
    return loop, context, FirstOrderTaylorApproximation(loop, context).A().copy()


def test_linearization_has_all_states_and_equals_central_differences(linearized):
    loop, context, matrix = linearized
    state = context.get_continuous_state_vector().CopyToVector()
    assert matrix.shape == (51, 51)

    def rate_at(values):
        context.SetContinuousState(values)
        return rate(loop, context)

    columns = [
        difference(lambda step, unit=unit: rate_at(state + step * unit), 0.0, 1e-4)
        for unit in np.eye(51)
    ]
    context.SetContinuousState(state)
    scale = np.maximum(1.0, np.abs(matrix))
    np.testing.assert_array_less(np.abs(np.stack(columns, axis=1) - matrix) / scale, 1e-6)


def test_spectrum_has_the_fastest_mode(linearized):
    loop, context, matrix = linearized
    fastest = np.max(np.abs(np.linalg.eigvals(matrix)))
    assert largest_step(loop, context) == pytest.approx(1.6 / fastest, rel=1e-4)


@swaps(len(SWAPS))
def test_rates_are_those_of_floats(overrides):
    _, loop, context = started(overrides)
    expected = rate(loop, context)
    for converted in (loop.ToAutoDiffXd(), loop.ToSymbolic()):
        copy = converted.CreateDefaultContext()
        copy.SetTimeStateAndParametersFrom(context)
        values = [number(value) for value in rate(converted, copy)]
        scale = np.max(np.abs(expected), initial=1.0)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-11 * scale)


def flown(config, loop, context, time):
    """All states at that time of a flight from the context on, and what the layer shows."""
    simulator = Simulator(loop, context)
    ApplySimulatorConfig(config.simulator_config, simulator)
    simulator.AdvanceTo(time)
    layer = loop.GetSubsystemByName("optimization_layer")
    parts = []
    for block in loop.GetSystems():
        own = loop.GetSubsystemContext(block, context)
        if block is not layer:  # whose state has the wall time
            groups = range(own.num_discrete_state_groups())
            parts += [own.get_discrete_state(i).CopyToVector() for i in groups]
    own = loop.GetSubsystemContext(layer, context)
    parts += [output(layer, own, name) for name in output_sizes(layer) if name != "solve_time"]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *parts])


@swaps(5)
def test_a_clone_flies_the_same_to_the_bit(overrides):
    config, loop, context = started(overrides)
    clone = loop.Clone()
    copy = clone.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    expected = flown(config, loop, context, 0.1)
    np.testing.assert_array_equal(flown(config, clone, copy, 0.1), expected)


def test_the_optimizer_holds_its_parameters_and_refuses_to_update():
    _, loop, context = started([])
    converted = loop.ToAutoDiffXd()
    copy = converted.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    held = ExtractValue(converted.GetOutputPort("parameters").Eval(copy))[:, 0]
    np.testing.assert_array_equal(held, loop.GetOutputPort("parameters").Eval(context))
    with pytest.raises(ScenarioError) as error:
        Simulator_[AutoDiffXd](converted, copy).Initialize()
    assert str(error.value) == (
        "scalar type of optimization_layer = AutoDiffXd: it computes with floating-point numbers "
        "only; give ConstantParameters, with its frequency and amplitude, in place of "
        "RecedingHorizonOptimizer"
    )


class PlainPhase(LeafSystem):
    """A block as a user writes it, of floats."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("planned", 8, lambda context, output: output.SetZero())


def test_a_block_of_the_users_that_does_not_convert_is_named():
    loop = make_nonstop(load_scenario("quintic", [CONSTANT]), phase=PlainPhase)
    with pytest.raises(RuntimeError, match=r"::phase of type .*PlainPhase does not support"):
        loop.ToAutoDiffXd()


@pytest.mark.nightly("studies")
def test_gradient_of_a_flight_equals_central_differences():
    """Of the squared error of the load's position, by where and how fast the load starts."""
    config, loop, context = started([CONSTANT])
    converted = loop.ToAutoDiffXd()
    state = context.get_continuous_state_vector().CopyToVector()
    places = [4, 6, 8, 11]  # of x, z, the angular velocity about y and the velocity along y

    def error(loop, context, simulator, start):
        context.SetContinuousState(start)
        ApplySimulatorConfig(config.simulator_config, simulator)
        simulator.AdvanceTo(0.1)
        load = loop.GetOutputPort("load_state").Eval(context)[4:7]
        gap = load - loop.GetOutputPort("reference").Eval(context)[4:7]
        return gap @ gap

    start = InitializeAutoDiff(state, np.eye(len(state))[:, places])[:, 0]
    copy = converted.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    result = error(converted, copy, Simulator_[AutoDiffXd](converted, copy), start)

    def varied(place, step):
        trial = context.Clone()
        unit = np.eye(len(state))[place]
        return error(loop, trial, Simulator(loop, trial), state + step * unit)

    slopes = [difference(lambda step, p=p: varied(p, step), 0.0, 1e-4) for p in places]
    np.testing.assert_allclose(ExtractGradient(np.array([result]))[0], slopes, rtol=1e-5)


@pytest.mark.nightly("studies")
def test_gradient_by_every_gain_equals_central_differences():
    """Of the squared error of the load's position, of a load that starts off its reference."""
    config, loop, context = started([CONSTANT])
    state = context.get_continuous_state_vector().CopyToVector()
    state[4:7] += [0.001, -0.002, 0.001]
    state[1] += 0.004  # the quaternion's x
    context.SetContinuousState(state)
    gains = {
        f"{box}.{name}": float(value)
        for box in ("wrench_controller", "carrier_controller")
        for own in (loop.GetSubsystemByName(box).parameters,)
        for name, value in own.defaults.items()
        if name in own.own and value != 0  # one of zero is no part of the law
    }
    assert len(gains) == 9

    def error(diagram, trial, simulator, values):
        for path, value in values.items():
            set_parameter(loop, trial, path, value)
        ApplySimulatorConfig(config.simulator_config, simulator)
        simulator.AdvanceTo(0.1)
        load, reference = (
            diagram.GetOutputPort(name).Eval(trial)[:7] for name in ("load_state", "reference")
        )
        gap = load - reference
        return gap @ gap  # of the quaternion, too: the orientation's gains act on it first

    converted = loop.ToAutoDiffXd()
    copy = converted.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    values = InitializeAutoDiff(np.array([*gains.values()]))[:, 0]
    simulator = Simulator_[AutoDiffXd](converted, copy)
    result = error(converted, copy, simulator, dict(zip(gains, values, strict=True)))

    def varied(path, step):
        trial = context.Clone()
        return error(loop, trial, Simulator(loop, trial), gains | {path: gains[path] + step})

    # An integral has hardly any effect yet, and the error is nearly quadratic in its gain.
    steps = {path: (0.2 if "integral" in path else 0.02) * gain for path, gain in gains.items()}
    slopes = np.array(
        [
            difference(lambda step, path=path: varied(path, step), 0.0, step)
            for path, step in steps.items()
        ]
    )
    # The error is the square of a gap between positions of some 1 m, which are rounded.
    of_error = 2 * np.sqrt(result.value()) * np.finfo(float).eps
    rounding = of_error / np.array([*steps.values()])
    assert np.all(rounding < 1e-3 * np.abs(slopes))
    assert np.all(np.abs(result.derivatives() - slopes) <= 1e-5 * np.abs(slopes) + rounding)
