"""The task of a scenario's load and carriers, for analyses that do not simulate it."""

import dataclasses
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.analysis.load_stability import LoadDeviations
from drake_nonstop.analysis.loop_response import LoopResponse, loop_response, reference_ahead
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.assembly import models_of
from drake_nonstop.mechanics.reference_preview import ReferencePreview, stretched
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import PLANNED_SIZE, LoadReference, PlannedParameters
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.model.descriptions import RESPONSE, TurnRate, Wind, described, described_air
from drake_nonstop.model.system import Model, given_fields
from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.plan import Plan
from drake_nonstop.planning.problem_config import LimitsConfig, with_fields_of
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import is_of_package
from drake_nonstop.validation import require

_ANALYSED = (  # the boxes between the load's state and its cables
    "load_feedback",
    "wrench_controller",
    "internal_force",
    "force_distribution",
    "carrier_trajectory",
    "cables",
    "load_plant",
)
_UPDATES = 300  # of a prediction of ξ, at most


class TurnAlong:
    """The turn of a load about the vertical, at ξ that is linear between some times.

    Args:
        trajectory: the block that makes the reference of the planned ξ.
        rates: (k,), rad/s, ξ.
        times: (k,), s, from 0 on; after the last one ξ stays.
    """

    def __init__(self, trajectory: System, rates: NDArray, times: NDArray):
        self.trajectory, self._context = trajectory, trajectory.CreateDefaultContext()
        self._rates, self._times = rates, times
        lengths, means = np.diff(times), (rates[1:] + rates[:-1]) / 2
        self._slopes = np.append(np.diff(rates) / lengths, 0.0)
        self._angles = np.concatenate([[0.0], np.cumsum(lengths * means)])

    def planned(self, time: float) -> tuple[float, float, float]:
        """The yaw θ in rad, ξ in rad/s and its rate in rad/s², at a time in s."""
        k = int(np.searchsorted(self._times, time, side="right")) - 1
        since, rate, slope = time - self._times[k], self._rates[k], self._slopes[k]
        angle = self._angles[k] + since * (rate + since / 2 * slope)
        return float(angle), float(rate + since * slope), float(slope)

    def reference(self, time: float) -> NDArray:
        """The load's reference (22,) at a time in s."""
        return self.reference_at(time, *self.planned(time))

    def reference_at(self, time: float, angle: float, rate: float, slope: float = 0.0) -> NDArray:
        """Returns the reference with a yaw in rad, and its rates in rad/s and rad/s²."""
        planned = np.zeros(PLANNED_SIZE)
        parts = PlannedParameters.view(planned)
        parts.angle[:], parts.frequency[:], parts.frequency_rate[:] = angle, rate, slope
        self._context.SetTime(time)
        self.trajectory.GetInputPort("planned").FixValue(self._context, planned)
        found: NDArray = self.trajectory.GetOutputPort("reference").Eval(self._context).copy()
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A load's motion, and what carries it."""

    name: str  # of the scenario
    model: Model  # what the controllers believe
    flown: Model  # the simulated plant's
    limits: LimitsConfig  # ε, the nominal ξ and A, and their bounds
    changes_parameters: bool  # whether the scenario's layer may change ξ and A
    reference: Callable[[float], NDArray]  # the load's (22,) at a time in s
    duration: float  # s
    response: LoopResponse  # what the blocks of the loop say of themselves
    air: Wind  # where its block says nothing, there is none
    counts_wind: bool  # whether the speeds that the layer bounds are those through the air
    horizon: HorizonConfig  # of plans of ξ and A
    turn: TurnAlong | None = None  # as the layer is predicted to change it; None: it does not

    @property
    def wind(self) -> NDArray:
        """The wind (3,), m/s, in W, without gusts, once it has risen."""
        return self.air.mean

    def wind_at(self, time: float) -> NDArray:
        """The wind (3,) at a time in s, without gusts; m/s, in W."""
        return self.air.at(time)

    def counted_wind(self, time: float) -> NDArray:
        """The wind (3,) as far as it counts for the speed bound, m/s, in W."""
        return self.wind_at(time) if self.counts_wind else STILL_AIR

    def planned_wind(self, time: float) -> NDArray:
        """The task's data as a layer takes them."""
        if self.air.believed is None or not self.counts_wind:
            return self.counted_wind(time)
        return self.air.believed

    @property
    def carried(self) -> Model:
        """The model whose load the carriers' references are above: what the controllers believe.

        References above the measured load come to follow the simulated one, whose height is fed
        back.
        """
        return self.flown if self.response.references.is_above_load else self.model

    @property
    def nominal(self) -> NDArray:
        """[ξ (rad/s), A (N)] (2,) at the start."""
        return np.array([self.limits.frequency, self.limits.amplitude])

    def planned(self, plan: Plan | None, times: NDArray) -> NDArray:
        """θ, ξ, A and their rates (k, 8) of a plan at times (k,), s; None: the nominal ξ and A."""
        values = np.zeros((len(times), PLANNED_SIZE))
        parts = PlannedParameters.view(values)
        if plan is None:
            parts.frequency[:], parts.amplitude[:] = self.nominal
            parts.angle[:] = times[:, None] * self.limits.frequency
            if self.turn is not None:
                turn = np.array([self.turn.planned(time) for time in times])
                parts.angle[:], parts.frequency[:], parts.frequency_rate[:] = np.split(
                    turn, 3, axis=1
                )
        else:
            values[:] = [plan.planned(time) for time in times]
        return values

    @cached_property
    def deviations(self) -> LoadDeviations:
        """Deviations of the load."""
        return LoadDeviations(
            self.flown,
            carrier_stiffness=self.response.carrier_stiffness,
            is_above_load=self.response.references.is_above_load,
            is_measured=self.response.measurement.is_measured,
        )

    def lifted(self, height: float) -> "Task":
        """The same motion so many m higher."""
        change = np.zeros_like(self.reference(0.0))
        LoadReference.view(change).position[2] = height
        return dataclasses.replace(self, reference=lambda time: self.reference(time) + change)

    def slowed(self, factor: float) -> "Task":
        """The same motion in a longer time; a factor of 2 takes twice as long."""
        rates = np.array([1 / factor, 0.0, 0.0])

        def reference(time: float) -> NDArray:
            return stretched(self.reference(time / factor), rates)

        return dataclasses.replace(self, reference=reference, duration=factor * self.duration)

    def changed(self, pattern: Any = None, **fields: Any) -> "Task":
        """The same with another pattern's config, or other fields of `SystemParameters`.

        Both of model and plant.

        Raises:
            ScenarioError: as of `Model`.
        """
        model, flown = (
            Model(
                dataclasses.replace(each.system, **fields),
                pattern or each.pattern_config,
                each.control_period,
                overridden=each.overridden,
            )
            for each in (self.model, self.flown)
        )
        return dataclasses.replace(self, model=model, flown=flown)


def task_of(scenario: Scenario, loop: Diagram | None = None) -> Task:
    """The task of a scenario; numbers are drawn for its distributions.

    Args:
        scenario: what is flown.
        loop: that was built from it; None: one is.

    Raises:
        ScenarioError: the scenario cannot be built, or its trajectory does not tell its motion.
    """
    check(scenario)
    scenario = scenario.sampled()
    if loop is None:
        loop = make_nonstop(scenario, at_equilibrium=False)
    blocks = {block.get_name(): block for block in loop.GetSystems()}
    trajectory = blocks["load_trajectory"]
    if wiring.input_names(trajectory) == ["planned"]:
        turn = TurnAlong(trajectory, np.array([scenario.optimization_layer.frequency]), np.zeros(1))
        task = _task(scenario, turn.reference, blocks)
        turns = described(blocks.get("optimization_layer"))
        if turns is None:
            return task
        turn = _predicted_turn(task, turns, turn)
        return dataclasses.replace(task, reference=turn.reference, turn=turn)
    ahead = reference_ahead(trajectory)
    remedy = "give one without inputs, whose motion is known beforehand"
    require(ahead is not None, "load_trajectory", type(trajectory).__name__, remedy)
    return _task(scenario, typing.cast(ReferencePreview, ahead), blocks)


def _predicted_turn(task: Task, turns: TurnRate, turn: TurnAlong) -> TurnAlong:
    """The turn of a load at the ξ that its layer makes, update by update; `turn` is constant."""
    period = max(turns.period, task.duration / _UPDATES)
    rate, angle, rates = turns.frequency, 0.0, []
    times = period * np.arange(int(task.duration / period) + 1)
    for time in times:
        motion, air = turn.reference_at(time, angle, rate), task.planned_wind(time)
        wrenches = feedforward_wrench(task.model.load, motion, air)
        rate = turns.updated(period, rate, motion, *wrenches, air)
        rates.append(rate)
        angle += period * rate
    return TurnAlong(turn.trajectory, np.array(rates), times)


def task_at(
    scenario: Scenario,
    nonstop: Diagram,
    context: Context,
) -> Task:
    """The task of a loop that has been built, with the load's reference as it is in a context.

    Args:
        scenario: what the loop was made from, with its numbers drawn.
        nonstop: the loop, which exports `reference` and `parameters`.
        context: of the loop.
    """
    reference, (frequency, amplitude) = (
        nonstop.GetOutputPort(name).Eval(context).copy() for name in ("reference", "parameters")
    )
    blocks = {block.get_name(): block for block in nonstop.GetSystems()}
    task = _task(scenario, lambda time: reference, blocks)
    limits = dataclasses.replace(task.limits, frequency=frequency, amplitude=amplitude)
    if described_air(blocks) is None and nonstop.HasOutputPort("load_wind"):
        wind = nonstop.GetOutputPort("load_wind").Eval(context)
        task = dataclasses.replace(task, air=Wind(wind.copy()))
    return dataclasses.replace(task, limits=limits)


def _task(
    scenario: Scenario, reference: Callable[[float], NDArray], blocks: Mapping[str, System]
) -> Task:
    model, simulated = models_of(scenario)
    flown = simulated if given_fields(scenario.simulated) else model
    layer = scenario.optimization_layer
    limits = with_fields_of(LimitsConfig, layer)  # of one without bounds, the default ones
    horizon = with_fields_of(HorizonConfig, layer)
    return Task(
        name=scenario.name,
        model=model,
        flown=flown,
        limits=limits,
        changes_parameters=hasattr(layer, "frequency_bounds") and not model.pattern.is_constant,
        reference=reference,
        duration=scenario.simulation_duration,
        response=loop_response(model, blocks),
        air=described_air(blocks) or Wind(),
        counts_wind=model.aircraft is not None and getattr(layer, "wind", True),
        horizon=timed(horizon, limits.frequency, scenario.control_period),
    )


def is_known(nonstop: Diagram) -> bool:
    """Whether all that stands between a loop's load and its cables says what it does."""
    blocks = {block.get_name(): block for block in nonstop.GetSystems()}
    own = [blocks[name] for name in _ANALYSED if name in blocks and not is_of_package(blocks[name])]
    is_told = all(RESPONSE in vars(type(block)) for block in own)
    return is_told and described(blocks.get("wrench_controller")) is not None
