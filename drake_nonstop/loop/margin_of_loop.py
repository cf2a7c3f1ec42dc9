"""The speed margin of a loop as configured, from its blocks."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.blocks.carrier_controller import LoadedCarrierPid
from drake_nonstop.blocks.carrier_dynamics import CarrierDynamics, LoadedCarrierDynamics
from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectory,
    InextensibleCarrierTrajectory,
)
from drake_nonstop.blocks.force_distribution import CableForceDistribution
from drake_nonstop.blocks.load_disturbance import DisturbanceForce, NoDisturbance
from drake_nonstop.blocks.load_feedback import (
    DesiredAttitudeFeedback,
    DesiredStateFeedback,
    EstimatedFeedback,
    IdealFeedback,
    NoisyFeedback,
)
from drake_nonstop.blocks.wind import GustyWind, SteadyWind, StillAir, WindProfile
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import WRENCH_SIZE, LoadReference, TrackingError
from drake_nonstop.mechanics.tethered_loop import LOAD_ERRORS, Carriers, Estimator
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_problem import HorizonConfig, timed
from drake_nonstop.optimization.problem_config import AUTO, LimitsConfig, NonstopProblemConfig
from drake_nonstop.optimization.speed_margin import (
    Disturbance,
    Gust,
    Motion,
    NoMarginError,
    SpeedMargin,
    speed_margin,
)
from drake_nonstop.optimization.turn_of_loops import Feedback
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


class LoopMargin(NamedTuple):
    """A margin, and what it leaves out."""

    margin: SpeedMargin | None  # None: nothing can be said
    left_out: tuple[str, ...]  # sentences


def margin_of_loop(
    model: Model,
    plant: Model,
    limits: LimitsConfig,
    blocks: Mapping[str, System],
    duration: float,
) -> LoopMargin:
    """The margin of a loop of these blocks, by the names of their boxes, for a run of `duration` s.

    What blocks of the user's own do is not known: the margin is that of the loop without it.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        limits: those of the optimization layer.
        blocks: all but the optimization layer, which need not be there.
        duration: s.
    """
    left_out: list[str] = []
    carriers = carriers_of(model, blocks, left_out)
    feedback = feedback_of(model, blocks, left_out)
    motion = _motion(model, blocks, duration, left_out)
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
            instant_spacing=_spacing(limits, model.control_period),
            disturbance=disturbance,
        )
    except NoMarginError as error:
        cause = str(error)
        if error.margin is not None:
            rest = -error.margin.uncovered
            known = f"{rest:.3g} m/s of what is needed, and " if rest > 0 else ""
            cause = f"{known}what faster orbits add, as {cause}"
        left_out.append(cause)
        return LoopMargin(error.margin, tuple(left_out))
    return LoopMargin(margin, tuple(left_out))


def computed_margin(
    model: Model,
    plant: Model,
    limits: LimitsConfig,
    blocks: Mapping[str, System],
    duration: float,
) -> SpeedMargin | None:
    """The margin as of `margin_of_loop`; a ScenarioWarning tells what it leaves out."""
    found = margin_of_loop(model, plant, limits, blocks, duration)
    if found.left_out:
        causes = "; ".join(found.left_out)
        what = f"the margin leaves out: {causes}; give it as speed_margin, in m/s, if it matters"
        if found.margin is None:
            what = f"no margin is computed, and 2 % of the bound is kept ({causes}); give a number"
        warn_user(f"optimization_layer.tightening = {AUTO}: {what}")
    return found.margin


def _spacing(limits: LimitsConfig, control_period: float) -> float:
    """Between the instants of the constraints, s."""
    if isinstance(limits, HorizonConfig):
        return timed(limits, limits.frequency, control_period).knot_spacing / limits.instants
    if isinstance(limits, NonstopProblemConfig):
        return limits.period / max(limits.look_ahead_points - 1, 1)
    return 0.0


def _name(blocks: Mapping[str, System], box: str) -> str:
    return f"{box} = {type(blocks[box]).__name__}" if box in blocks else f"{box} = None"


def carriers_of(model: Model, blocks: Mapping[str, System], left_out: list[str]) -> Carriers | None:
    """The carriers' loops; None where they are not known, and a sentence why is added."""
    controller: Any = blocks.get("carrier_controller")
    dynamics, trajectory = blocks.get("carrier_dynamics"), blocks.get("carrier_trajectory")
    gains = getattr(controller, "gains", None)
    is_loaded = isinstance(controller, LoadedCarrierPid)
    fitting = LoadedCarrierDynamics if is_loaded else CarrierDynamics
    if gains is None or not isinstance(dynamics, fitting):
        name = "carrier_controller" if gains is None else "carrier_dynamics"
        left_out.append(f"{_name(blocks, name)}: its response is not known")
        return None
    if not isinstance(trajectory, (CarrierTrajectory, InextensibleCarrierTrajectory)):
        left_out.append(f"{_name(blocks, 'carrier_trajectory')}: its references are not known")
        return None
    if not isinstance(blocks.get("force_distribution"), CableForceDistribution):
        left_out.append(f"{_name(blocks, 'force_distribution')}: what it changes of the forces")
    mass = model.carrier_mass
    return Carriers(
        position_gain=gains["position_gain"] / mass,
        velocity_gain=gains["velocity_gain"] / mass,
        integral_gain=gains["integral_gain"] / mass,
        mass=mass if is_loaded else 0.0,
        has_feedforward=getattr(controller, "has_feedforward", False),
        hold=trajectory.hold_order,
    )


def feedback_of(model: Model, blocks: Mapping[str, System], left_out: list[str]) -> Feedback | None:
    """The load's feedback; None where the wrench controller is not known."""
    gains = getattr(blocks.get("wrench_controller"), "gains", None)
    if gains is None:
        left_out.append(f"{_name(blocks, 'wrench_controller')}: its gains are not known")
        return None
    if float(np.max(np.abs(np.subtract(gains["feedforward"], 1.0)))) > 0:
        left_out.append("wrench_controller.feedforward differs from 1: the load's lag")
    measurement = blocks.get("load_feedback")
    period = model.control_period or _CONTINUOUS
    deviations, is_measured, delay = np.zeros(LOAD_ERRORS), np.ones(LOAD_ERRORS), 0
    estimator = None
    if isinstance(measurement, NoisyFeedback):
        deviations = measurement.deviations
        delay = round(measurement.delay_periods * measurement.period / period)
        if delay > _MOST_DELAY:
            left_out.append(f"load_feedback.delay: what is more than {_MOST_DELAY} samples")
            delay = _MOST_DELAY
        if abs(measurement.period - period) > 1e-9:
            left_out.append("load_feedback.period differs from the controllers': noise that stays")
        if isinstance(measurement, EstimatedFeedback):
            estimator = Estimator.of(
                measurement.rotation_gain, measurement.translation_gain, measurement.period
            )
            if min(measurement.rotation_gain[1, 1], measurement.translation_gain[1, 1]) < _EXACT:
                left_out.append("load_feedback believes in noise of rates: its estimate's lag")
    elif isinstance(measurement, DesiredStateFeedback):
        is_measured = np.zeros(LOAD_ERRORS)
    elif isinstance(measurement, DesiredAttitudeFeedback):
        errors = TrackingError.view(is_measured)
        errors.orientation[:] = errors.angular_velocity[:] = 0
    elif not isinstance(measurement, IdealFeedback):
        left_out.append(f"{_name(blocks, 'load_feedback')}: what it makes of the load's state")
    return Feedback(
        gains=gains,
        deviations=deviations,
        is_measured=is_measured,
        delay=delay,
        period=period,
        estimator=estimator,
    )


def _motion(
    model: Model, blocks: Mapping[str, System], duration: float, left_out: list[str]
) -> Motion | None:
    """The load's reference over a run; None where it is not known."""
    trajectory = blocks.get("load_trajectory")
    if trajectory is None or trajectory.num_input_ports() > 0:
        left_out.append(f"{_name(blocks, 'load_trajectory')}: the motion is not known ahead")
        return None
    context = trajectory.CreateDefaultContext()
    if "reference_preview" in wiring.output_names(trajectory):
        preview = trajectory.GetOutputPort("reference_preview").Eval(context)
    else:
        port = trajectory.GetOutputPort("reference")

        def reference(time: float) -> NDArray:
            context.SetTime(time)
            return port.Eval(context).copy()

        preview = ReferencePreview(reference)
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
    model: Model,
    plant: Model,
    blocks: Mapping[str, System],
    motion: Motion,
    left_out: list[str],
) -> Disturbance:
    """What wind and the box load_disturbance do to the load."""
    believed = np.zeros((len(motion.times), 3))
    unknown, gusts = np.zeros(WRENCH_SIZE), []
    wind, other = blocks.get("wind"), blocks.get("load_disturbance")
    if isinstance(wind, (SteadyWind, WindProfile, GustyWind)):
        mean = wind.mean_at(LoadReference.view(motion.references[1]).position)
        believed = model.load.drag * (mean if wind.believed is None else wind.believed + 0 * mean)
        differences = plant.load.drag * mean - believed
        furthest = np.argmax(np.linalg.norm(differences, axis=1))
        unknown[3:] += differences[furthest]
        if wind.jumps:
            left_out.append("wind.rise_time = 0: the jump of the mean wind")
    elif wind is not None and not isinstance(wind, StillAir):
        left_out.append(f"{_name(blocks, 'wind')}: what it does to the load")
    if isinstance(wind, GustyWind) and np.any(wind.load_deviations):
        deviations = np.append(np.zeros(3), plant.load.drag * wind.load_deviations)
        gusts.append(Gust(deviations, wind.wave_frequencies))
    if isinstance(other, DisturbanceForce):
        unknown += other.wrench
        if other.gust_force > 0:
            deviations = np.repeat([0.0, other.gust_force], 3)
            gusts.append(Gust(deviations, other.wave_frequencies))
    elif other is not None and not isinstance(other, NoDisturbance):
        left_out.append(f"{_name(blocks, 'load_disturbance')}: its wrench")
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
