import dataclasses

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.load_trajectory import RestToRest, RestToRestConfig
from drake_nonstop.blocks.receding_horizon import (
    RecedingHorizonOptimizer,
    RecedingHorizonOptimizerConfig,
)
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.planning.diagnostics import Diagnostics

MOVE = RestToRestConfig(displacement=[1.5, 0.5, 0.2], start_time=1.0, move_time=6.0)
SAMPLE = 0.01
BOUND = 0.5  # m/s, that the first ξ and A do not keep on the way


def previewed(move=MOVE):
    trajectory = RestToRest(model(), move)
    return trajectory.GetOutputPort("reference_preview").Eval(trajectory.CreateDefaultContext())


def layer(control_period=SAMPLE, **fields):
    fields = {"speed_bound": BOUND, "instants": 10, "tightening": 0.02} | fields
    return RecedingHorizonOptimizer(
        model(4, control_period), RecedingHorizonOptimizerConfig(**fields)
    )


def fix_time(block, context, time):
    """Tells the sample's time (s) to a layer that reads it."""
    if block.HasInputPort("sample_time"):
        fix(block, context, sample_time=np.array([float(time)]))


class Flight:
    """The layer alone in a simulator, with the preview of a move; its outputs at samples."""

    def __init__(self, block, preview):
        self.block, self.simulator = block, Simulator(block)
        self.context = self.simulator.get_mutable_context()
        fix(block, self.context, reference=preview(0.0))
        block.GetInputPort("reference_preview").FixValue(self.context, Value(preview))
        fix_time(block, self.context, 0.0)
        self.simulator.Initialize()

    def advanced(self, start, end, step=SAMPLE):
        """`plan` (k, 8) at the samples from a time to another, both in s."""
        rows = []
        for time in np.arange(round(start / step), round(end / step)) * step:
            fix_time(self.block, self.context, time)
            self.simulator.AdvanceTo(time + step / 2)
            rows.append(output(self.block, self.context, "plan").copy())
        return np.array(rows)

    @property
    def diagnostics(self):
        return Diagnostics.view(output(self.block, self.context, "diagnostics"))


def carrier_speeds(planned, preview, times):
    """Speeds (k, n), by differences of the carriers' positions: from first principles."""
    system = model()
    rigid = system.load
    step = times[1] - times[0]

    def positions(row, time):
        reference = preview(time)
        angle, _, amplitude = row[:3]
        weight = np.array([0, 0, 0, 0, 0, rigid.mass * rigid.gravity])
        push = rigid.mass * reference[16:19] + rigid.drag * reference[10:13]
        wrench = weight + np.concatenate([np.zeros(3), push])
        internal = system.pattern.basis @ (amplitude * np.cos(angle + system.pattern.phases))
        forces = (system.pseudo_inverse @ wrench + internal).reshape(-1, 3)
        return carrier_motion(
            reference,
            forces,
            0 * forces,
            attachments=system.attachments,
            rest_length=system.cable_length,
            compliance=system.cable_compliance,
        )[0]

    places = np.array([positions(*pair) for pair in zip(planned, times, strict=True)])
    return np.linalg.norm((places[2:] - places[:-2]) / (2 * step), axis=-1)


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
    assert np.min(carrier_speeds(kept, preview, times)) < 0.9 * BOUND
    assert np.min(carrier_speeds(planned, preview, times)) > 1.015 * BOUND


def test_a_plan_goes_on_smoothly_from_the_last_and_returns(flown):
    flight, _, planned = flown
    parts = PlannedParameters.view(planned)

    def change(values):
        return np.gradient(values[:, 0], SAMPLE)[1:-1]

    def close(values, rates, tolerance):
        scale = np.max(np.abs(rates)) + 1e-9
        np.testing.assert_allclose(change(values), rates[1:-1, 0], atol=tolerance * scale)

    close(parts.angle, parts.frequency, 1e-4)
    close(parts.frequency, parts.frequency_rate, 1e-2)
    close(parts.amplitude, parts.amplitude_rate, 1e-2)
    close(parts.frequency_rate, parts.frequency_second_rate, 3e-2)
    close(parts.amplitude_second_rate, parts.amplitude_third_rate, 5e-2)
    np.testing.assert_allclose(planned[0], [0, 2.0, 1.2, 0, 0, 0, 0, 0], atol=1e-10)
    np.testing.assert_allclose(planned[-1, 1:3], [2.0, 1.2], rtol=1e-3)
    assert np.max(np.abs(planned[:, 1] - 2.0)) > 0.05
    updates = flight.diagnostics
    assert updates.updates == updates.kept + updates.solved + updates.relaxed == 29
    assert updates.relaxed == 0
    np.testing.assert_array_equal(
        output(flight.block, flight.context, "parameters"), planned[-1, 1:3]
    )


def test_plans_depend_on_the_context_alone(flown):
    flight, preview, planned = flown
    np.testing.assert_array_equal(Flight(flight.block, preview).advanced(0, 3), planned[:300])
    other = Flight(flight.block.Clone(), preview)
    np.testing.assert_array_equal(other.advanced(0, 1.5), planned[:150])


@pytest.mark.slow
def test_a_bound_takes_effect_with_the_next_plan():
    at_rest = previewed(RestToRestConfig())
    block = layer()
    flight = Flight(block, at_rest)
    assert np.ptp(flight.advanced(0, 1)[:, 1]) < 1e-12
    block.set_speed_bound(flight.context, 1.1)
    raised = flight.advanced(1, 3.5)
    speeds = carrier_speeds(raised, at_rest, 1 + SAMPLE * np.arange(len(raised)))
    assert np.min(speeds[:20]) < 1.0
    assert np.min(speeds[200:]) > 1.1
    assert output(block, flight.context, "speed_bound") == 1.1
    block.set_speed_bound(flight.context, 0.0)
    np.testing.assert_allclose(flight.advanced(3.5, 9.5)[-1, 1:3], [2.0, 1.2], rtol=1e-3)


def under_way(time):
    """The preview of a move of 4 s from a time in s on, at which nothing goes before."""
    preview = previewed(dataclasses.replace(MOVE, start_time=0.0, move_time=4.0))
    return ReferencePreview(lambda later: preview(time + later))


@pytest.mark.parametrize(
    ("start", "bound", "is_nominal"),
    [
        (3.5, 0.6, False),  # the initial ξ and A are too slow until after the first instant
        (3.62, 0.6, False),  # at the start alone
        (3.7, 0.6, True),
    ],
)
def test_a_first_plan_keeps_the_bound_from_the_start_itself_on(start, bound, is_nominal):
    preview = under_way(start)
    flight = Flight(layer(speed_bound=bound), preview)
    planned = flight.advanced(0, 0.1)
    assert np.min(carrier_speeds(planned, preview, SAMPLE * np.arange(10))) > 1.02 * bound
    assert flight.diagnostics.relaxed == 0
    assert np.allclose(planned[0], [0, 2.0, 1.2, 0, 0, 0, 0, 0]) == is_nominal


def test_parameters_of_the_context_are_those_of_the_first_plan():
    block = layer(speed_bound=0.0)
    preview = previewed()
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, reference=preview(0.0))
    fix_time(block, context, 0.0)
    place = block.parameters.place("frequency").start
    context.get_mutable_numeric_parameter(0).SetAtIndex(place, 2.5)
    block.begin_anew(context)
    np.testing.assert_array_equal(output(block, context, "plan")[:3], [0, 2.5, 1.2])
    simulator.Initialize()
    np.testing.assert_allclose(output(block, context, "parameters"), [2.5, 1.2])
