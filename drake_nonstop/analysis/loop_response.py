"""The response of a loop as its blocks describe it, for analyses that do not simulate it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.analysis.tethered_loop import Carriers, Feedback
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.wrench import NO_FEEDBACK
from drake_nonstop.model.descriptions import CarrierReferences, LoadMeasurement, described
from drake_nonstop.model.system import Model
from drake_nonstop.systems import wiring

_CONTINUOUS = 0.002  # s, for which continuous controllers are taken as held
_MOST_DELAY = 20  # samples

Blocks = Mapping[str, System]  # of a loop, by the names of their boxes


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopResponse:
    """Descriptions of the blocks of a loop by themselves."""

    carriers: Carriers | None  # their controllers and references; None: they are not known
    feedback: Feedback | None  # the wrench controller's, with its samples; None: it is not known
    measurement: LoadMeasurement  # where it is not known, an exact one
    references: CarrierReferences  # where they are not known, above the load's reference
    carrier_stiffness: float  # N/m, by which carriers give way along cables; inf: not at all

    @property
    def measured_gains(self) -> Mapping[str, Any] | None:
        """The wrench controller's on what is measured: 0 where nothing is; None: not known."""
        if not np.any(self.measurement.is_measured):
            return NO_FEEDBACK
        return None if self.feedback is None else self.feedback.gains


def loop_response(model: Model, blocks: Blocks) -> LoopResponse:
    """The response of a loop whose controllers believe in a model."""
    control = described(blocks.get("carrier_controller"))
    references = described(blocks.get("carrier_trajectory")) or CarrierReferences(None)
    measurement = described(blocks.get("load_feedback")) or LoadMeasurement()
    return LoopResponse(
        carriers=_carriers(model, blocks, references),
        feedback=_feedback(model, blocks, measurement),
        measurement=measurement,
        references=references,
        carrier_stiffness=math.inf if control is None else control.stiffness,
    )


def _carriers(model: Model, blocks: Blocks, references: CarrierReferences) -> Carriers | None:
    """The carriers' loops; None where they are not known."""
    control = described(blocks.get("carrier_controller"))
    motion = described(blocks.get("carrier_dynamics"))
    if control is None or motion is None or references.hold is None:
        return None
    mass = model.carrier_mass
    return Carriers(
        position_gain=control.position_gain / mass,
        velocity_gain=control.velocity_gain / mass,
        integral_gain=control.integral_gain / mass,
        has_feedforward=control.has_feedforward,
        hold=references.hold,
    )


def _feedback(model: Model, blocks: Blocks, measurement: LoadMeasurement) -> Feedback | None:
    """The load's feedback; None where the wrench controller is not known."""
    gains = described(blocks.get("wrench_controller"))
    if gains is None:
        return None
    period = model.control_period or _CONTINUOUS
    return Feedback(
        gains=gains,
        is_measured=measurement.is_measured,
        delay=min(round(measurement.delay / period), _MOST_DELAY),
        period=period,
        estimator=measurement.estimator,
    )


def reference_ahead(trajectory: System) -> ReferencePreview | None:
    """The reference over time of a `load_trajectory`; None: it has inputs, or makes none."""
    if trajectory.num_input_ports() > 0 or "reference" not in wiring.output_names(trajectory):
        return None
    context = trajectory.CreateDefaultContext()
    if "reference_preview" in wiring.output_names(trajectory):
        return trajectory.GetOutputPort("reference_preview").Eval(context)
    port = trajectory.GetOutputPort("reference")

    def reference(time: float) -> NDArray:
        context.SetTime(time)
        return port.Eval(context).copy()

    return ReferencePreview(reference)
