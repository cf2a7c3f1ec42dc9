"""What a scenario asks of its load and its carriers, for analyses that do not simulate it."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.analysis.load_stability import LoadDeviations
from drake_nonstop.analysis.planned_turn import PlannedTurnAlong, constant_turn, predicted_turn
from drake_nonstop.blocks.carrier_controller import CarrierPidConfig, FeedforwardCarrierPidConfig
from drake_nonstop.blocks.carrier_trajectory import MeasuredCarrierTrajectoryConfig
from drake_nonstop.blocks.load_feedback import (
    DesiredAttitudeFeedbackConfig,
    DesiredStateFeedbackConfig,
)
from drake_nonstop.blocks.load_trajectory import PlannedTurn
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizerConfig
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.margin_of_loop import carriers_of, feedback_of
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import PLANNED_SIZE, LoadReference, PlannedParameters
from drake_nonstop.mechanics.stretched_time import stretched_reference
from drake_nonstop.mechanics.tethered_loop import Carriers
from drake_nonstop.mechanics.wind import MeanWind, risen_share
from drake_nonstop.mechanics.wrench import NO_FEEDBACK
from drake_nonstop.model.system import Model, given_fields, overridden
from drake_nonstop.optimization.horizon_problem import HorizonConfig, timed
from drake_nonstop.optimization.plan import Plan
from drake_nonstop.optimization.problem_config import LimitsConfig, with_fields_of
from drake_nonstop.optimization.speed_margin import with_margin
from drake_nonstop.optimization.turn_of_loops import Feedback
from drake_nonstop.scenario.schema import Scenario, check
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A load's motion, and what carries it.

    Attributes:
        name: of the scenario.
        model: what the controllers believe.
        flown: the simulated plant's.
        limits: ε, the nominal ξ and A, and their bounds.
        changes_parameters: whether the scenario's layer may change ξ and A.
        reference: the load's (22,) at a time in s.
        duration: s.
        gains: of the wrench controller, as of `LoadDeviations.growth`; None: they are not known.
        carriers: their controllers and references; None: they are not known.
        feedback: the wrench controller's, with its samples; None: it is not known.
        feeds_back: whether the controllers get the load's state.
        measures_attitude: as of `LoadDeviations`.
        is_above_load: as of `LoadDeviations`.
        carrier_stiffness: as of `LoadDeviations`, N/m.
        mean_wind: everywhere, without gusts, once it has risen.
        believed: (3,), m/s, in W, the wind that the controllers believe; None: that at the load.
        gust: standard deviation of the wind at a carrier, m/s.
        rise: when the wind begins to rise, s, and how long it takes, s; 0: at once.
        counts_wind: whether the speeds that the layer bounds are those through the air.
        horizon: of plans of ξ and A.
        turn: the load's, as a `TurnRateOptimizer` is predicted to change it; None: there is none.
    """

    name: str
    model: Model
    flown: Model
    limits: LimitsConfig
    changes_parameters: bool
    reference: Callable[[float], NDArray]
    duration: float
    gains: Mapping[str, Any] | None
    carriers: Carriers | None
    feedback: Feedback | None
    feeds_back: bool
    measures_attitude: bool
    is_above_load: bool
    carrier_stiffness: float
    mean_wind: MeanWind
    believed: NDArray | None
    gust: float
    rise: tuple[float, float]
    counts_wind: bool
    horizon: HorizonConfig
    turn: PlannedTurnAlong | None = None

    @cached_property
    def wind(self) -> NDArray:
        """At the load at the start (3,), m/s, in W, without gusts, once it has risen."""
        return self.mean_wind.at(LoadReference.view(self.reference(0.0)).position)

    def wind_at(self, time: float, above: float = 0.0) -> NDArray:
        """The wind (3,) at a time in s, so many m above the load's reference; m/s, in W."""
        start, rise_time = self.rise
        share = float(time >= start)
        if rise_time > 0:
            share = float(risen_share(np.array(time), start=start, rise_time=rise_time))
        position = LoadReference.view(self.reference(time)).position + np.array([0, 0, above])
        return share * self.mean_wind.at(position)

    def counted_wind(self, time: float) -> NDArray:
        """The wind (3,) as far as it counts for the speed bound, m/s, in W."""
        return self.wind_at(time) if self.counts_wind else STILL_AIR

    def planned_wind(self, time: float) -> NDArray:
        """What a layer takes for it."""
        if self.believed is None or not self.counts_wind:
            return self.counted_wind(time)
        return self.believed

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
            values[:] = [plan.values(time) for time in times]
        return values

    @property
    def effective_gains(self) -> Mapping[str, Any] | None:
        """The gains on what is measured: none where nothing is fed back; None: not known."""
        return self.gains if self.feeds_back else NO_FEEDBACK

    def deviations(self) -> LoadDeviations:
        """Those of the load."""
        return LoadDeviations(
            self.flown,
            carrier_stiffness=self.carrier_stiffness,
            is_above_load=self.is_above_load,
            measures_attitude=self.measures_attitude,
        )

    def slowed(self, factor: float) -> "Task":
        """The same motion in a longer time; a factor of 2 takes twice as long."""
        rates = np.array([1 / factor, 0.0, 0.0])

        def reference(time: float) -> NDArray:
            return stretched_reference(self.reference(time / factor), rates)

        return dataclasses.replace(self, reference=reference, duration=factor * self.duration)

    def with_system(self, **fields: Any) -> "Task":
        """The same with other fields of the `SystemParameters`, of model and plant.

        Raises:
            ScenarioError: as of `Model`.
        """
        return dataclasses.replace(
            self, model=_changed(self.model, **fields), flown=_changed(self.flown, **fields)
        )

    def with_pattern(self, pattern: Any) -> "Task":
        """The same with another pattern's config, of model and plant.

        Raises:
            ScenarioError: as of `Model`.
        """
        return dataclasses.replace(
            self, model=_patterned(self.model, pattern), flown=_patterned(self.flown, pattern)
        )


def task_of(scenario: Scenario, loop: Diagram | None = None) -> Task:
    """The task of a scenario; numbers are drawn for its distributions.

    Its limits are those of the loop that a run builds, with the margin that is computed for it.

    Args:
        scenario: what is flown.
        loop: that was built from it; None: one is.

    Raises:
        ScenarioError: the scenario cannot be built, or its trajectory does not tell its motion.
    """
    check(scenario)
    scenario = scenario.sampled()
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    if loop is None:
        loop = make_nonstop(scenario, at_equilibrium=False)
    margin = getattr(loop, "speed_margin", None)
    layer = with_margin(scenario.optimization_layer, margin)
    scenario = dataclasses.replace(scenario, optimization_layer=layer)
    blocks = {block.get_name(): block for block in loop.GetSystems()}
    trajectory = blocks["load_trajectory"]
    if isinstance(trajectory, PlannedTurn) and scenario.reference_governor is None:
        turn = constant_turn(trajectory, layer.frequency)
        task = _task(scenario, model, turn.reference, blocks)
        if not isinstance(layer, TurnRateOptimizerConfig):
            return task
        turn = predicted_turn(trajectory, layer, model, task.planned_wind, task.duration)
        return dataclasses.replace(task, reference=turn.reference, turn=turn)
    names = [trajectory.get_output_port(i).get_name() for i in range(trajectory.num_output_ports())]
    require(
        "reference" in names and trajectory.num_input_ports() == 0,
        "load_trajectory",
        type(trajectory).__name__,
        "give one without inputs, whose motion is known beforehand",
    )
    return _task(scenario, model, _reference_of(trajectory), blocks)


def task_of_loop(scenario: Scenario, nonstop: Diagram, context: Context) -> Task | None:
    """The task of a loop that has been built, with the load's reference as it is in a context.

    None where a block of the user's own stands between the load's state and its cables: what it
    does is not known.

    Args:
        scenario: what the loop was made from, with its numbers drawn.
        nonstop: the loop, which exports `reference` and `parameters`.
        context: of the loop.
    """
    blocks = {block.get_name(): block for block in nonstop.GetSystems()}
    if any(name in blocks and not is_of_package(blocks[name]) for name in _ANALYSED):
        return None
    gains = getattr(blocks.get("wrench_controller"), "gains", None)
    if gains is None or not all(map(nonstop.HasOutputPort, ("reference", "parameters"))):
        return None
    reference, (frequency, amplitude) = (
        nonstop.GetOutputPort(name).Eval(context).copy() for name in ("reference", "parameters")
    )
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    task = _task(scenario, model, lambda time: reference, blocks)
    limits = dataclasses.replace(task.limits, frequency=frequency, amplitude=amplitude)
    return dataclasses.replace(task, limits=limits)


def _task(
    scenario: Scenario,
    model: Model,
    reference: Callable[[float], NDArray],
    blocks: Mapping[str, System],
) -> Task:
    given = given_fields(scenario.simulated)
    flown = model
    if given:
        flown = Model(
            overridden(scenario.system, scenario.simulated),
            scenario.pattern,
            scenario.control_period,
            field="simulated",
            overridden=[
                name for name, value in vars(scenario.simulated).items() if value is not None
            ],
        )
    layer, feedback = scenario.optimization_layer, scenario.load_feedback
    limits = with_fields_of(LimitsConfig, layer)  # of one without bounds, the default ones
    horizon = with_fields_of(HorizonConfig, layer)
    believed = getattr(scenario.wind, "believed", None)
    return Task(
        name=scenario.name,
        model=model,
        flown=flown,
        limits=limits,
        changes_parameters=hasattr(layer, "frequency_bounds") and not model.pattern.is_constant,
        reference=reference,
        duration=scenario.simulation_duration,
        gains=getattr(blocks.get("wrench_controller"), "gains", None),
        carriers=carriers_of(model, blocks, []),
        feedback=feedback_of(model, blocks, []),
        feeds_back=not isinstance(feedback, DesiredStateFeedbackConfig),
        measures_attitude=not isinstance(feedback, DesiredAttitudeFeedbackConfig),
        is_above_load=isinstance(scenario.carrier_trajectory, MeasuredCarrierTrajectoryConfig),
        carrier_stiffness=_carrier_stiffness(scenario.carrier_controller),
        mean_wind=MeanWind.of(scenario.wind, getattr(scenario.wind, "velocity", STILL_AIR)),
        believed=None if believed is None else np.array(believed, dtype=float),
        gust=getattr(scenario.wind, "gust", 0.0),
        rise=(getattr(scenario.wind, "start_time", 0.0), getattr(scenario.wind, "rise_time", 0.0)),
        counts_wind=model.aircraft is not None and getattr(layer, "wind", True),
        horizon=timed(horizon, limits.frequency, scenario.control_period),
    )


def _reference_of(block: System) -> Callable[[float], NDArray]:
    context, port = block.CreateDefaultContext(), block.GetOutputPort("reference")

    def reference(time: float) -> NDArray:
        context.SetTime(time)
        values: NDArray = port.Eval(context).copy()
        return values

    return reference


def _carrier_stiffness(controller: Any) -> float:
    """N/m, by which a controller holds its carrier against a constant force."""
    is_given = isinstance(controller, (CarrierPidConfig, FeedforwardCarrierPidConfig))
    return controller.position_gain or math.inf if is_given else math.inf


def _changed(model: Model, **fields: Any) -> Model:
    """A model with other fields of its system."""
    system = dataclasses.replace(model.system, **fields)
    return Model(system, model.pattern_config, model.control_period, overridden=model.overridden)


def _patterned(model: Model, pattern: Any) -> Model:
    """A model with another pattern."""
    return Model(model.system, pattern, model.control_period, overridden=model.overridden)
