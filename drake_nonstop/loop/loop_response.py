"""The response of a loop as its blocks describe it, and the speed margin that follows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.mechanics.wrench import NO_FEEDBACK
from drake_nonstop.model.descriptions import (
    CarrierReferences,
    LoadMeasurement,
    LoadWrench,
    Wind,
    described,
    described_air,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.problem_config import AUTO, LimitsConfig
from drake_nonstop.optimization.speed_margin import (
    Disturbance,
    Motion,
    NoMarginError,
    SpeedMargin,
    speed_margin,
)
from drake_nonstop.optimization.tethered_loop import Carriers, Feedback
from drake_nonstop.systems import wiring
from drake_nonstop.validation import warn_user

_INSTANTS = 301  # of a task, at which its reference is looked at
_BETWEEN = 0.382  # of the interval
_LONGEST = 600.0  # s, of a task that is looked at
_CONTINUOUS = 0.002  # s, for which continuous controllers are taken as held
_JUMP = 0.1  # of the largest jerk, from which on a change between two instants may be a jump
_HALVINGS = 10  # of an interval with a change, after which a smooth one is small
_EXACT = 1 - 1e-9  # a gain of rates that are taken as they are measured
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
    left_out: tuple[str, ...]  # sentences about what is not known

    @property
    def measured_gains(self) -> Mapping[str, Any] | None:
        """The wrench controller's on what is measured: 0 where nothing is; None: not known."""
        if not np.any(self.measurement.is_measured):
            return NO_FEEDBACK
        return None if self.feedback is None else self.feedback.gains


def loop_response(model: Model, blocks: Blocks) -> LoopResponse:
    """The response of a loop whose controllers believe in a model."""
    left_out: list[str] = []
    control = described(blocks.get("carrier_controller"))
    references = described(blocks.get("carrier_trajectory")) or CarrierReferences(None)
    measurement = described(blocks.get("load_feedback"))
    carriers = _carriers(model, blocks, references, left_out)
    feedback = _feedback(model, blocks, measurement, left_out)
    return LoopResponse(
        carriers=carriers,
        feedback=feedback,
        measurement=measurement or LoadMeasurement(),
        references=references,
        carrier_stiffness=math.inf if control is None else control.stiffness,
        left_out=tuple(left_out),
    )


def _name(blocks: Blocks, box: str) -> str:
    return f"{box} = {type(blocks[box]).__name__}" if box in blocks else f"{box} = None"


def _carriers(
    model: Model, blocks: Blocks, references: CarrierReferences, left_out: list[str]
) -> Carriers | None:
    """The carriers' loops; None where they are not known, and a sentence why is added."""
    control = described(blocks.get("carrier_controller"))
    motion = described(blocks.get("carrier_dynamics"))
    if control is None or motion is None or motion.bears_cables != control.bears_cables:
        name = "carrier_controller" if control is None else "carrier_dynamics"
        left_out.append(f"{_name(blocks, name)}: its response is not known")
        return None
    if references.hold is None:
        left_out.append(f"{_name(blocks, 'carrier_trajectory')}: its references are not known")
        return None
    if described(blocks.get("force_distribution")) is None:
        left_out.append(f"{_name(blocks, 'force_distribution')}: what it changes of the forces")
    mass = model.carrier_mass
    return Carriers(
        position_gain=control.position_gain / mass,
        velocity_gain=control.velocity_gain / mass,
        integral_gain=control.integral_gain / mass,
        mass=mass if control.bears_cables else 0.0,
        has_feedforward=control.has_feedforward,
        hold=references.hold,
    )


def _feedback(
    model: Model, blocks: Blocks, measurement: LoadMeasurement | None, left_out: list[str]
) -> Feedback | None:
    """The load's feedback; None where the wrench controller is not known."""
    gains = described(blocks.get("wrench_controller"))
    if gains is None:
        left_out.append(f"{_name(blocks, 'wrench_controller')}: its gains are not known")
        return None
    if float(np.max(np.abs(np.subtract(gains["feedforward"], 1.0)))) > 0:
        left_out.append("wrench_controller.feedforward differs from 1: the load's lag")
    if measurement is None:
        left_out.append(f"{_name(blocks, 'load_feedback')}: what it makes of the load's state")
        measurement = LoadMeasurement()
    period = model.control_period or _CONTINUOUS
    delay, estimator = round(measurement.delay / period), measurement.estimator
    if delay > _MOST_DELAY:
        left_out.append(f"load_feedback.delay: what is more than {_MOST_DELAY} samples")
        delay = _MOST_DELAY
    if measurement.period > 0 and abs(measurement.period - period) > 1e-9:
        left_out.append("load_feedback.period differs from the controllers': noise that stays")
    if estimator is not None and np.min(np.diag(estimator.gain)[6:]) < _EXACT:
        left_out.append("load_feedback believes in noise of rates: its estimate's lag")
    return Feedback(
        gains=gains,
        deviations=measurement.deviations,
        is_measured=measurement.is_measured,
        delay=delay,
        period=period,
        estimator=estimator,
    )


class LoopMargin(NamedTuple):
    """A margin, and what it leaves out."""

    margin: SpeedMargin | None  # None: nothing can be said
    left_out: tuple[str, ...]  # sentences


def speed_margin_for(
    model: Model, plant: Model, limits: LimitsConfig, blocks: Blocks, duration: float
) -> LoopMargin:
    """The speed margin of a loop of these blocks for a run of `duration` s.

    What a block does that does not describe it is not known: the margin is that of the loop
    without it.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        limits: those of the optimization layer.
        blocks: all but the optimization layer, which need not be there.
        duration: s.
    """
    response = loop_response(model, blocks)
    left_out = [*response.left_out]
    motion = _motion(model, blocks, duration, left_out)
    carriers, feedback = response.carriers, response.feedback
    if carriers is None or feedback is None or motion is None:
        return LoopMargin(None, tuple(left_out))
    if not math.isfinite(plant.cable_stiffness):
        left_out.append("the simulated cables do not stretch")
        return LoopMargin(None, tuple(left_out))
    disturbance = _disturbance(model, plant, blocks, motion, left_out)
    try:
        margin = speed_margin(
            model,
            plant,
            limits,
            carriers,
            feedback,
            motion,
            instant_spacing=limits.instant_spacing(model.control_period),
            disturbance=disturbance,
        )
    except NoMarginError as error:
        cause = str(error)
        if error.margin is not None:
            rest = -error.margin.deficit
            known = f"{rest:.3g} m/s of what is needed, and " if rest > 0 else ""
            cause = f"{known}what faster orbits add, as {cause}"
        left_out.append(cause)
        return LoopMargin(error.margin, tuple(left_out))
    return LoopMargin(margin, tuple(left_out))


def warn_of_margin(found: LoopMargin) -> None:
    """Warns of what a margin leaves out."""
    if found.left_out:
        causes = "; ".join(found.left_out)
        what = f"the margin leaves out: {causes}; give it as speed_margin, in m/s, if it matters"
        if found.margin is None:
            what = f"no margin is computed, and 2 % of the bound is kept ({causes}); give a number"
        warn_user(f"optimization_layer.tightening = {AUTO}: {what}")


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


def _motion(model: Model, blocks: Blocks, duration: float, left_out: list[str]) -> Motion | None:
    """The load's reference over a run; None where it is not known."""
    trajectory = blocks.get("load_trajectory")
    preview = None if trajectory is None else reference_ahead(trajectory)
    if preview is None:
        left_out.append(f"{_name(blocks, 'load_trajectory')}: the motion is not known ahead")
        return None
    end = min(duration, preview.end_time, _LONGEST)
    if end < duration:
        left_out.append(f"the load's motion after t = {end:g} s")
    times = np.linspace(0.0, end, _INSTANTS)
    # Between them, where a motion hardly begins or ends.
    between = times[:-1] + _BETWEEN * np.diff(times)
    step = (model.control_period or _CONTINUOUS) / 2  # rates are averages over a sample
    instants, jumps = _jerk_jumps(preview, times)
    apart = np.abs(between[:, None] - instants).min(axis=1, initial=np.inf)
    between = np.clip(between[apart > 2 * step], step, max(end - step, step))
    references = np.stack([preview.at(between + shift) for shift in (-step, 0.0, step)])
    return Motion(times=between, references=references, step=step, jerk_jumps=jumps)


def _disturbance(
    model: Model, plant: Model, blocks: Blocks, motion: Motion, left_out: list[str]
) -> Disturbance:
    """Disturbance of the load by the wind and the box load_disturbance."""
    air, wrench = described_air(blocks), LoadWrench()
    if "wind" in blocks and air is None:
        left_out.append(f"{_name(blocks, 'wind')}: what it does to the load")
    wind = air or Wind()
    if wind.start > 0 == wind.rise_time:
        left_out.append("wind.rise_time = 0: the jump of the mean wind")
    name = "load_disturbance"
    if name in blocks and (wrench := described(blocks[name])) is None:
        left_out.append(f"{_name(blocks, name)}: its wrench")
        wrench = LoadWrench()
    mean = wind.mean.at(LoadReference.view(motion.references[1]).position)
    believed = model.load.drag * (mean if wind.believed is None else wind.believed + 0 * mean)
    differences = plant.load.drag * mean - believed
    unknown = wrench.steady.copy()
    unknown[3:] += differences[np.argmax(np.linalg.norm(differences, axis=1))]
    gusts = [
        each._replace(deviations=np.append(np.zeros(3), plant.load.drag * each.deviations))
        for each in wind.load_gusts
    ]
    gusts += [] if wrench.gusts is None else [wrench.gusts]
    gusts = [each for each in gusts if np.any(each.deviations)]
    return Disturbance(believed=believed, unknown=unknown, gusts=tuple(gusts))


def _jerk_jumps(preview: ReferencePreview, times: NDArray) -> tuple[NDArray, NDArray]:
    """The instants (m,), s, and the jumps (m, 3) of the jerk, m/s³, in the load's frame.

    A jump is a change that stays as its interval is halved.
    """
    jerks = LoadReference.view(preview.at(times)).jerk
    changes = np.linalg.norm(np.diff(jerks, axis=0), axis=1)
    least = _JUMP * float(np.max(np.linalg.norm(jerks, axis=1), initial=0.0))
    jumps, instants = [], []
    for k in np.flatnonzero(changes > least):
        (start, end), (before, after) = times[k : k + 2], jerks[k : k + 2]
        for _ in range(_HALVINGS):
            time = (start + end) / 2
            middle = LoadReference.view(preview(time)).jerk
            if np.linalg.norm(middle - before) > np.linalg.norm(after - middle):
                end, after = time, middle
            else:
                start, before = time, middle
        if np.linalg.norm(after - before) > changes[k] / 4:
            turned = rotation_matrix(LoadReference.view(preview(start)).quaternion)
            jumps.append((after - before) @ turned)
            instants.append(start)
    return np.array(instants), np.reshape(jumps, (-1, 3))
