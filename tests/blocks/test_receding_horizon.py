"""The horizon's layer alone: its plans on a move, the bound, and what aircraft need."""

import dataclasses

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator

from drake_nonstop import Diagnostics, Model, ReferencePreview, carrier_speeds, load_scenario
from drake_nonstop.blocks.load_trajectory import RestToRest, RestToRestConfig
from drake_nonstop.blocks.receding_horizon import (
    RecedingHorizonOptimizer,
    RecedingHorizonOptimizerConfig,
)
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.signals import LoadReference

MOVE = RestToRestConfig(displacement=[1.5, 0.5, 0.2], start_time=1.0, move_time=6.0)
SAMPLE = 0.01
BOUND = 0.5  # m/s, that the first ξ and A do not keep on the way
NOMINAL = [0, 2.0, 1.2, 0, 0, 0, 0, 0]


def previewed(move=MOVE):
    trajectory = RestToRest(model(), move)
    return trajectory.GetOutputPort("reference_preview").Eval(trajectory.CreateDefaultContext())


def layer(**fields):
    fields = {"speed_bound": BOUND, "instants": 10, "tightening": 0.02} | fields
    return RecedingHorizonOptimizer(model(4, SAMPLE), RecedingHorizonOptimizerConfig(**fields))


class Flight:
    """The layer alone in a simulator, with the preview of a move; its outputs at samples."""

    def __init__(self, block, preview, frequency=None):
        self.block, self.simulator = block, Simulator(block)
        self.context = self.simulator.get_mutable_context()
        fix(block, self.context, reference=preview(0.0), sample_time=np.zeros(1))
        block.GetInputPort("reference_preview").FixValue(self.context, preview)
        if frequency is not None:
            place = block.parameters.place("frequency").start
            self.context.get_mutable_numeric_parameter(0).SetAtIndex(place, frequency)
            block.begin_anew(self.context)
        self.first = self.shown("plan")
        self.simulator.Initialize()

    def shown(self, name):
        return output(self.block, self.context, name)

    def advanced(self, start, end):
        """`plan` (k, 8) at the samples from a time to another, both in s."""
        rows = []
        for time in np.arange(round(start / SAMPLE), round(end / SAMPLE)) * SAMPLE:
            fix(self.block, self.context, sample_time=np.array([time]))
            self.simulator.AdvanceTo(time + SAMPLE / 2)
            rows.append(self.shown("plan"))
        return np.array(rows)

    @property
    def diagnostics(self):
        return Diagnostics.view(self.shown("diagnostics"))


def speeds_by_differences(planned, preview, times):
    """Speeds (k, n), by differences of the carriers' positions: from first principles."""
    own, places = model(), []
    cables = {"rest_length": own.cable_length, "compliance": own.cable_compliance}
    for (angle, _, amplitude, *_), time in zip(planned, times, strict=True):
        now, load = LoadReference.view(preview(time)), own.load
        push = load.mass * now.acceleration + load.drag * now.velocity
        wrench = np.array([0, 0, 0, *push]) + load.mass * load.gravity * np.eye(6)[5]
        internal = own.pattern.basis @ (amplitude * np.cos(angle + own.pattern.phases))
        forces = (own.pseudo_inverse @ wrench + internal).reshape(-1, 3)
        carriers = carrier_motion(
            preview(time), forces, 0 * forces, attachments=own.attachments, **cables
        )
        places.append(carriers[0])
    places = np.array(places)
    return np.linalg.norm((places[2:] - places[:-2]) / (2 * (times[1] - times[0])), axis=-1)


@pytest.fixture(scope="module")
def flown():
    preview = previewed()
    flight = Flight(layer(), preview)
    return flight, preview, flight.advanced(0, 11)


@pytest.mark.slow
def test_carriers_on_the_plan_keep_the_bound_that_the_first_parameters_do_not(flown):
    _, preview, planned = flown
    times = np.arange(len(planned)) * SAMPLE
    kept = planned.copy()
    kept[:, 0], kept[:, 1:3] = planned[0, 1] * times, planned[0, 1:3]
    assert np.min(speeds_by_differences(kept, preview, times)) < 0.9 * BOUND
    assert np.min(speeds_by_differences(planned, preview, times)) > 1.015 * BOUND


def test_a_plan_begins_with_the_first_parameters_and_returns_to_them(flown):
    flight, _, planned = flown
    np.testing.assert_allclose(planned[0], NOMINAL, atol=1e-10)
    np.testing.assert_allclose(planned[-1, 1:3], [2.0, 1.2], rtol=1e-3)
    assert np.max(np.abs(planned[:, 1] - 2.0)) > 0.05
    updates = flight.diagnostics
    assert updates.updates == updates.kept + updates.solved == 29
    np.testing.assert_array_equal(flight.shown("parameters"), planned[-1, 1:3])


def test_plans_depend_on_the_context_alone(flown):
    flight, preview, planned = flown
    np.testing.assert_array_equal(Flight(flight.block, preview).advanced(0, 3), planned[:300])
    other = Flight(flight.block.Clone(), preview)
    np.testing.assert_array_equal(other.advanced(0, 1.5), planned[:150])
    # The first plan is that of the context's parameters.
    other = Flight(layer(speed_bound=0.0), preview, frequency=2.5)
    np.testing.assert_array_equal(other.first[:3], [0, 2.5, 1.2])
    np.testing.assert_allclose(other.shown("parameters"), [2.5, 1.2])


@pytest.mark.slow
def test_a_bound_takes_effect_with_the_next_plan():
    at_rest, block = previewed(RestToRestConfig()), layer()
    flight = Flight(block, at_rest)
    assert np.ptp(flight.advanced(0, 1)[:, 1]) < 1e-12
    block.set_speed_bound(flight.context, 1.1)
    raised = flight.advanced(1, 3.5)
    speeds = speeds_by_differences(raised, at_rest, 1 + SAMPLE * np.arange(len(raised)))
    assert np.min(speeds[:20]) < 1.0
    assert np.min(speeds[200:]) > 1.1
    assert flight.shown("speed_bound") == 1.1
    block.set_speed_bound(flight.context, 0.0)
    np.testing.assert_allclose(flight.advanced(3.5, 9.5)[-1, 1:3], [2.0, 1.2], rtol=1e-3)


@pytest.mark.parametrize(
    ("start", "is_nominal"),
    [
        (3.5, False),  # the initial ξ and A are too slow until after the first instant
        (3.62, False),  # at the start alone
        (3.7, True),
    ],
)
def test_a_first_plan_keeps_the_bound_from_the_start_itself_on(start, is_nominal):
    """Of a move of 4 s that is under way, and that nothing goes before."""
    move = previewed(dataclasses.replace(MOVE, start_time=0.0, move_time=4.0))
    preview = ReferencePreview(lambda later: move(start + later))
    flight = Flight(layer(speed_bound=0.6), preview)
    planned = flight.advanced(0, 0.1)
    speeds = speeds_by_differences(planned, preview, SAMPLE * np.arange(10))
    assert np.min(speeds) > 1.02 * 0.6
    assert flight.diagnostics.relaxed == 0
    assert np.allclose(planned[0], NOMINAL) == is_nominal


WIND, REST = np.array([2.0, 0.0, 0.0]), np.eye(22)[0]


@pytest.fixture(scope="module")
def aircraft_model():
    scenario = load_scenario("aircraft_rest")
    return Model(scenario.system, scenario.pattern, scenario.control_period)


def planned(model, told_wind=None, **fields):
    """ξ and A, the bound, diagnostics and counts after the first plan above a resting load."""
    fields = {"frequency": 0.595, "amplitude": 1.0, "instants": 4} | fields
    block = RecedingHorizonOptimizer(model, RecedingHorizonOptimizerConfig(**fields))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, reference=REST, sample_time=np.zeros(1))
    if told_wind is not None:
        fix(block, context, wind_estimate=told_wind)
    simulator.Initialize()
    names = ("parameters", "speed_bound", "diagnostics", "missed_limits")
    found, (bound,), told, missed = (output(block, context, name) for name in names)
    return found, bound, Diagnostics.view(told), missed.tolist()


def test_the_first_plan_keeps_the_airspeed_in_the_wind_that_is_told(aircraft_model):
    def least_airspeed(parameters, wind):
        load = aircraft_model.load
        wrench = np.array([0, 0, 0, *(-load.drag * wind)]) + load.mass * load.gravity * np.eye(6)[5]
        phases = np.linspace(0, 2 * np.pi, 64)
        return carrier_speeds(
            *(aircraft_model, REST, wrench, np.zeros(6)), *parameters, phases, wind
        ).min()

    bound = {"speed_bound": "1.45 V_s"}
    still, aim, *_ = planned(aircraft_model, **bound)
    windy, _, told, counts = planned(aircraft_model, WIND, **bound)
    assert aim == pytest.approx(1.45 * 8.37, rel=0.01)
    assert least_airspeed(still, 0 * WIND) > aim
    assert least_airspeed(still, WIND) < aim - 0.5
    assert least_airspeed(windy, WIND) > aim
    assert told.solved == 1
    assert told.speed_margin > 0
    assert counts == [0]  # of the airspeed
    without, *_ = planned(aircraft_model, WIND, wind=False, **bound)
    np.testing.assert_array_equal(without, still)


def test_a_limit_that_no_plan_keeps_is_counted(aircraft_model):
    bounds = {"frequency_bounds": [0.5, 0.65], "amplitude_bounds": [0.9, 1.1]}
    *_, told, counts = planned(aircraft_model, speed_bound=10.0, max_lift_share=0.4, **bounds)
    assert told.relaxed == 1
    assert counts == [0, 1]  # of the airspeed and the lift
