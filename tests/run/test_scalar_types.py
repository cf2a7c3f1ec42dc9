"""The closed loop in Drake's other scalar types: linearized, differentiated, printed, cloned."""

import numpy as np
import pytest
from helpers import difference, nightly_beyond
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, Simulator_
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium
from drake_nonstop.loop.step import largest_step
from drake_nonstop.systems.block import number

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
