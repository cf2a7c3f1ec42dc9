"""The task of a scenario's load and carriers, for analyses that do not simulate it."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.assembly import models_of
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.descriptions import WIND, CarrierReferences, Wind, described
from drake_nonstop.model.system import Model, given_fields
from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.problem_config import LimitsConfig, with_fields_of
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.systems import wiring
from drake_nonstop.validation import require


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A load's motion, and what carries it."""

    model: Model  # what the controllers believe
    flown: Model  # the simulated plant's
    limits: LimitsConfig  # ε, the nominal ξ and A, and their bounds
    reference: Callable[[float], NDArray]  # the load's (22,) at a time in s
    duration: float  # s
    references: CarrierReferences  # where they are not known, above the load's reference
    air: Wind  # where its block says nothing, there is none
    counts_wind: bool  # whether the speeds that the layer bounds are those through the air
    horizon: HorizonConfig  # of plans of ξ and A

    def counted_wind(self, time: float) -> NDArray:
        """The wind (3,) at a time in s as far as it counts for the speed bound, m/s, in W."""
        return self.air.at(time) if self.counts_wind else STILL_AIR

    @property
    def carried(self) -> Model:
        """The model whose load the carriers' references are above: what the controllers believe.

        References above the measured load come to follow the simulated one, whose height is fed
        back.
        """
        return self.flown if self.references.is_above_load else self.model


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
    remedy = "give one without inputs, whose motion is known beforehand"
    is_known = trajectory.num_input_ports() == 0 and "reference" in wiring.output_names(trajectory)
    require(is_known, "load_trajectory", type(trajectory).__name__, remedy)
    return _task(scenario, _reference_ahead(trajectory), blocks)


def _reference_ahead(trajectory: System) -> ReferencePreview:
    """The reference over time of a `load_trajectory` without inputs."""
    context = trajectory.CreateDefaultContext()
    if "reference_preview" in wiring.output_names(trajectory):
        preview: ReferencePreview = trajectory.GetOutputPort("reference_preview").Eval(context)
        return preview
    port = trajectory.GetOutputPort("reference")

    def reference(time: float) -> NDArray:
        context.SetTime(time)
        return port.Eval(context).copy()

    return ReferencePreview(reference)


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
    if described(blocks.get("wind"), WIND) is None and nonstop.HasOutputPort("load_wind"):
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
        model=model,
        flown=flown,
        limits=limits,
        reference=reference,
        duration=scenario.simulation_duration,
        references=described(blocks.get("carrier_trajectory")) or CarrierReferences(None),
        air=described(blocks.get("wind"), WIND) or Wind(),
        counts_wind=model.aircraft is not None and getattr(layer, "wind", True),
        horizon=timed(horizon, limits.frequency, scenario.control_period),
    )
