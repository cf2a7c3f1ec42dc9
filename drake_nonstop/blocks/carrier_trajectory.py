"""Box "Carrier Desired Trajectories" of the figure."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.lumped_cables import (
    CABLE_MATERIAL,
    air_density_name,
    air_density_where_unsaid,
    check_nodes,
    material_of,
    material_rows,
)
from drake_nonstop.mechanics.bowed_line import (
    TimeWindow,
    bowed_lines,
    motion_over_window,
    with_feedback,
)
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.carrier import (
    carrier_motion,
    carrier_positions,
    motion_after,
)
from drake_nonstop.mechanics.grasp import forces_along
from drake_nonstop.mechanics.internal_force import orbit_axes, orbit_forces
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.lumped_cable import CableMaterial
from drake_nonstop.mechanics.planned_orbit import FlightTerms
from drake_nonstop.mechanics.reference_correction import (
    CORRECTION_SIZE,
    corrected_attachments,
    corrected_forces,
    corrected_reference,
)
from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotation_matrix,
)
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import (
    HELD,
    SAMPLE_TIME,
    SAMPLED,
    LoadReference,
    nodes_layout,
)
from drake_nonstop.mechanics.tuning import correction_rate
from drake_nonstop.model.block import (
    AUTO,
    LOAD,
    Block,
    BlockParameters,
    rigid_load,
    with_this_sample,
)
from drake_nonstop.model.descriptions import CarrierReferences, described
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.equations import BetweenSamples
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import for_each, where
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    one_of,
    positive,
    require,
    require_array,
    require_non_negative,
    require_ranges,
)

_BOX = "carrier_trajectory"
_HOLDS = {"third_order": 3, "velocity": 1}  # and their orders
_DERIVATIVES = ("carrier_reference_acceleration", "carrier_reference_jerk")
_MOVED = ("carrier_reference", "carrier_reference_acceleration")  # between samples
_INSTANTS = 9  # of the window: accelerations to 0.003 m/s² on cables of 150 m
_FORCE_RATES = "internal_force_higher_rates"
_FOR_DERIVATIVES = (_FORCE_RATES, "wind_estimate")
_HIGHER_RATES = "reference_higher_rates"
_MEASURED = "measured_load_state"
_ATTITUDE = "measured_attitude"
_ATTITUDES = (_ATTITUDE, HELD + _ATTITUDE)  # the second where there are samples
_RATES, _TIME = "correction_rates", "correction_time"
# Reference, attachments (n, 3), desired cable forces (n, 3) and their rates.
_Given = tuple[NDArray, NDArray, NDArray, NDArray]
_GUSTS = "carrier_gust_estimate"


class CarrierReferenceBlock(Block):
    """Carriers' references, of which some are made at the samples, and move in between."""

    where: ClassVar = dict.fromkeys(
        (SAMPLE_TIME, *(SAMPLED + name for name in _MOVED)), "the model has a control period"
    )
    of_model: ClassVar[tuple[str, ...]] = ("attachments",)
    is_sampled = True

    def outputs(self, model: Model) -> tuple[str, ...]:
        # In the order of `equations`, which do not make those that move.
        moved = tuple(name for name in self.makes if SAMPLED + name in self.makes)
        others = tuple(n for n in self.makes if n not in moved and not n.startswith(SAMPLED))
        if model.control_period > 0:
            return (*(SAMPLED + name for name in moved), *others, *moved)
        return (*moved, *others)


def _check_rates(field: str, value: Any) -> None:
    if isinstance(value, str):
        require(value == AUTO, field, value, f'give four rates in rad/s, or "{AUTO}"')
    else:
        rates = require_array(field, value, [4], "rad/s: of level position, height, tilt and yaw")
        for k, rate in enumerate(rates):
            require_non_negative(f"{field}[{k}]", float(rate))


@dataclass(kw_only=True)
class _MovingReferencesConfig(StrictFields):
    """How the references move, between samples and against errors; the cables are the system's."""

    hold: str = checked(  # of the references between samples: "third_order" or "velocity"
        "third_order", one_of(_HOLDS, f"give {' or '.join(_HOLDS)}")
    )
    # rad/s, at which the references move against the load's measured errors of its level position,
    # its height, its tilt and its yaw; auto: all by the cables
    correction_rates: list[float] | str = checked(AUTO, _check_rates)
    correction_time: float = positive(0.5)  # s, time constant of the low-pass of the error


@dataclass(kw_only=True)
class CarrierTrajectoryConfig(_MovingReferencesConfig):
    """How the references move, between samples and against errors; the cables are the system's."""


class CarrierTrajectory(CarrierReferenceBlock):
    """Carriers above the desired load pose, on cables stretched by the desired forces (eqs. 1, 22).

    The cables stretch by the system's stiffness (.inf: L_i = L₀, as in the paper). Only
    accelerations and jerks need `internal_force_higher_rates`, `wind_estimate` and
    `reference_higher_rates`. They hold for a load on its reference, whose further rates are taken
    as zero, see `mechanics.grasp`.

    A time τ after a sample the `carrier_reference` is p + τ v + τ² a/2 + τ³ j/6 and
    v + τ a + τ² j/2, and its acceleration a + τ j. With the `hold` "velocity" they are p + τ v, v
    and a. Jerks are constant.

    Corrections remove the load's errors that a wrong model causes, such as a wrong length of
    cables, wind or centre of mass. The measured error [r, e_p], a rotation in L and a shift in W,
    passes a low-pass with the time constant `correction_time`, and is integrated at the
    `correction_rates`. This moves the load's reference, turns it about the vertical with the whole
    formation, and tilts the ends of its cables. The integral of a wrench controller cannot do that
    on long cables: a force moves the load only by the cables' stretch, 2.3 mm/N in `aircraft_rest`,
    and its predicted rate is that of a free load. The low-pass keeps corrections from amplifying
    the load's rotation on its cables, which is weakly damped. The attitude is `measured_attitude`,
    or that of the measured state where this is not connected. Rates that are "auto" follow from the
    cables by `mechanics.tuning.correction_rate`. For the tilt of a load below aircraft the rate is
    0: tilted ends of long cables share the load differently, and pull it sideways, by 0.5 m in
    `aircraft_rest` with its centre of mass 3 % of the width off. The command `stability` shows
    whether given rates are stable.

    Raises:
        ScenarioError: `hold` is another text, a rate is negative, or the low-pass is faster than
            the samples.
    """

    reads: ClassVar[tuple[str, ...]] = (
        "reference",
        "desired_cable_forces",
        "desired_cable_force_rates",
        *_FOR_DERIVATIVES,
        _HIGHER_RATES,
        *(_MEASURED, *_ATTITUDES),
        SAMPLE_TIME,
    )
    makes: ClassVar[tuple[str, ...]] = (
        "carrier_reference",
        *_DERIVATIVES,
        *(SAMPLED + name for name in _MOVED),
    )
    where: ClassVar = {
        **CarrierReferenceBlock.where,
        **dict.fromkeys((_MEASURED, *_ATTITUDES), "a correction rate is not zero"),
    }
    optional_inputs: tuple[str, ...] = (_HIGHER_RATES, *_ATTITUDES)
    system: ClassVar[tuple[str, ...]] = ("cable_length", "cable_stiffness", *LOAD)
    of_model: ClassVar[tuple[str, ...]] = (
        *CarrierReferenceBlock.of_model,
        *("pseudo_inverse", "pattern.basis", "control_period"),
    )

    def __init__(self, model: Model, config: Any = None):
        is_left_out = model.control_period == 0 or getattr(config, "hold", "") == "velocity"
        if is_left_out and _FORCE_RATES in self.reads:
            self.optional_inputs = (*self.optional_inputs, *_FOR_DERIVATIVES)
        super().__init__(model, config)

    def describe_response(self) -> CarrierReferences:
        return CarrierReferences(_HOLDS[self.config.hold] if self.model.control_period > 0 else 0)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_ranges(_BOX, config)
        if cls.has_state(model, config):
            remedy = f"give more than the control period, {model.control_period:g} s"
            is_slower = config.correction_time > model.control_period
            require(is_slower, f"{_BOX}.correction_time", config.correction_time, remedy)

    def state(self, model: Model) -> NDArray:
        return np.zeros(2 * CORRECTION_SIZE)

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        return bool(np.any(_rates(model, config)))

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Raises ScenarioError where nothing moves the carriers, or rates of the force are missing.

        These are needed where accelerations of its references are used. Warns where the wrench
        controller integrates the load's error, too.
        """
        load_reference = loop.at_start("reference") if self.model.pattern.is_constant else None
        if load_reference is not None:
            require(
                np.any(LoadReference.view(load_reference).angular_velocity),
                "pattern",
                type(self.model.pattern_config).__name__.removesuffix("Config"),
                "its carriers keep their places above the load, which does not turn at the start, "
                "and would stop; give load_trajectory: !SteadyTurn, or a pattern with orbits",
            )
        internal_force = loop.get("internal_force")
        is_used = self.describe_response().hold == 3 or any(
            {*_DERIVATIVES} & loop.needed(name) for name in loop.blocks
        )
        if is_used and internal_force is not None and loop.maker_of(_FORCE_RATES) is None:
            raise ScenarioError(
                f"internal_force = {type(internal_force).__name__}: it does not make "
                f"{_FORCE_RATES}, of which the references' accelerations follow; give it this "
                "output, the second and third rates (2m) of the internal force, or "
                "internal_force=PlannedInternalForce"
            )
        gains = described(loop.get("wrench_controller")) or {}
        is_integrated = np.any(gains.get("position_integral_gain", 0.0))
        if is_integrated and self.has_state(self.model, self.config):
            yield (
                f"{_BOX}.correction_rates = {self.config.correction_rates}: the load's position "
                "error is integrated twice, and the two integrals wander against each other; set "
                "that of wrench_controller to 0"
            )

    @staticmethod
    def equations(
        correction: NDArray,
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        internal_force_higher_rates: NDArray,
        wind: NDArray,
        reference_higher_rates: NDArray,
        *measured: NDArray,
        corrects: bool,
        control_period: float,
        pseudo_inverse: NDArray,
        basis: NDArray,
        attachments: NDArray,
        cable_length: NDArray,
        cable_stiffness: NDArray,
        **numbers: Any,
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        given = reference, attachments, _rows(forces), _rows(rates)
        own = numbers.pop(_RATES), numbers.pop(_TIME)
        if corrects:
            correction, given = corrected(correction, given, measured, control_period, *own)
        reference, attachments, pulls, pull_rates = given
        motion = LoadMotion.along(reference, reference_higher_rates)
        along = forces_along(
            rigid_load(**numbers),
            motion,
            pulls,
            pull_rates,
            internal_force_higher_rates,
            wind,
            pseudo_inverse=pseudo_inverse,
            basis=basis,
        )
        cables = _cables(attachments, cable_length, cable_stiffness)
        position, velocity, acceleration, jerk = carrier_positions(motion, along, **cables).rates
        return correction, np.concatenate([position, velocity]), acceleration, jerk

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        return _parameters(model, self.system, config)

    @property
    def corrects(self) -> bool:
        """Whether the references answer the load's error."""
        return self.has_state(self.model, self.config)

    def SetCorrection(self, context: Context, correction: NDArray) -> NDArray:
        """Sets the state to a correction (6,) but for what does not move, and returns this part."""
        moves, error = _rates(self.model, self.config) > 0, np.zeros(CORRECTION_SIZE)
        others = state_values(context)[2 * CORRECTION_SIZE :]
        own = np.where(moves, correction, 0.0)
        set_state_values(context, np.concatenate([error, own, others]))
        return np.where(moves, 0.0, correction)

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return super().constants(model, config) | {"corrects": self.corrects}

    def inputs(self, model: Model) -> tuple[str, ...]:
        is_held = model.control_period > 0
        left_out: tuple[str, ...] = (_MEASURED, *_ATTITUDES)
        if self.has_state(model, self.config):
            left_out = _ATTITUDES[:1] if is_held else _ATTITUDES[1:]
        return tuple(name for name in super().inputs(model) if name not in left_out)

    def between_samples(self, model: Model, config: Any) -> BetweenSamples:
        moved = _along_jerk if config.hold == "third_order" else _along_velocity
        reads = (*(SAMPLED + name for name in _MOVED), _DERIVATIVES[1])
        return BetweenSamples(moved, reads, _MOVED, key=config.hold)


def _along_jerk(motion: NDArray, acceleration: NDArray, jerk: NDArray, since: NDArray) -> Any:
    """Motion and accelerations a time after the sample."""
    return motion_after(motion, since, acceleration, jerk), acceleration + since * jerk


def _along_velocity(motion: NDArray, acceleration: NDArray, jerk: NDArray, since: NDArray) -> Any:
    """Motion a time after the sample, with the accelerations of the sample."""
    return motion_after(motion, since), acceleration


def _rates(model: Model, config: Any) -> NDArray:
    """The rates (6,), rad/s, of the corrections of [attitude; position], in L and in W."""
    rates = config.correction_rates
    if isinstance(rates, str):
        length, gravity = map(model.number, ("cable_length", "gravity"))
        rate = correction_rate(length, gravity)
        rates = [rate, rate, rate if model.aircraft is None else 0.0, rate]
    level, height, tilt, yaw = rates
    return np.array([tilt, tilt, yaw, level, level, height])


def _parameters(
    model: Model, system: Sequence[str], config: Any, others: Sequence[str] = ()
) -> BlockParameters:
    """Those of the system, of the corrections, and other fields of the config."""
    own = {_RATES: _rates(model, config), _TIME: config.correction_time}
    own |= {name: getattr(config, name) for name in others}
    return BlockParameters(model, system, config=SimpleNamespace(**own), own=own)


def corrected(
    correction: NDArray,
    given: _Given,
    measured: Sequence[NDArray],
    period: float,
    rates: NDArray,
    time: NDArray,
) -> tuple[NDArray, _Given]:
    """The rate of the state, and reference, attachments, forces and their rates as corrected.

    The state (12,) has the filtered error and the correction; that after this sample counts.
    What is measured are the load's state, its attitude, zero where that of the
    state is, and the time of the sample, if there are samples.
    """
    reference, attachments, forces, force_rates = given
    state, attitude, *sample_time = measured
    own = where((attitude * attitude).sum() > 0, attitude, state[:4])
    turn = quaternion_product(own, quaternion_conjugate(reference[:4]))
    sine = 2 * turn[:1] * turn[1:]  # of its angle, along its axis: also of a load upside down
    shift = state[4:7] - reference[4:7]
    error = np.concatenate([sine @ rotation_matrix(reference[:4]), shift])  # the first in L
    filtered, corrected = np.split(correction, 2)
    # What has no rate fades, so that no state of the loop is left without a motion of its own.
    fading = np.concatenate([where(rate > 0, 0 * time, 1 / time) for rate in rates])
    change = (error - filtered) / time, -rates * filtered - fading * corrected
    both, after = with_this_sample(correction, np.concatenate(change), sample_time, period)
    rate, correction = both[CORRECTION_SIZE:], after[CORRECTION_SIZE:]
    reference = corrected_reference(reference, correction, rate)
    attachments = corrected_attachments(attachments, correction)
    return both, (reference, attachments, *corrected_forces(forces, force_rates, correction, rate))


def _rows(vectors: NDArray) -> NDArray:
    """Vectors (n, 3) of a signal (3n,)."""
    return vectors.reshape(-1, 3)


def _cables(attachments: NDArray, length: NDArray, stiffness: NDArray) -> dict[str, Any]:
    """Cables of lengths in m and stiffnesses in N/m, (1,) or (n,)."""
    compliance = compliance_of(stiffness)
    return {"attachments": attachments, "rest_length": length, "compliance": compliance}


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(CarrierReferenceBlock):
    """Carriers above the measured load pose: they follow the load wherever it is.

    Only the wrench controller then corrects the load's pose. It does not make the accelerations and
    jerks that the others make: those of the measured load are not known.

    Between samples the reference moves along its velocity.
    """

    reads = (
        "measured_load_state",
        "desired_cable_forces",
        "desired_cable_force_rates",
        SAMPLE_TIME,
    )
    makes = ("carrier_reference", "sampled_carrier_reference")
    system = ("cable_length", "cable_stiffness")

    @staticmethod
    def equations(
        load_state: NDArray,
        forces: NDArray,
        rates: NDArray,
        *sample_time: NDArray,
        attachments: NDArray,
        cable_length: NDArray,
        cable_stiffness: NDArray,
    ) -> NDArray:
        cables = _cables(attachments, cable_length, cable_stiffness)
        forces, rates = forces.reshape(-1, 3), rates.reshape(-1, 3)
        return np.concatenate(carrier_motion(load_state, forces, rates, **cables))

    def describe_response(self) -> CarrierReferences:
        return CarrierReferences(None, is_above_load=True)

    def between_samples(self, model: Model, config: Any) -> BetweenSamples:
        reads, makes = self.makes[1:], self.makes[:1]
        return BetweenSamples(motion_after, reads, makes, key="velocity")


@dataclass(kw_only=True)
class BowedReferencesConfig(_MovingReferencesConfig):
    """How finely cables are resolved; no variant's own: Drake's YAML takes the first that fits."""

    nodes: int = checked(12, check_nodes)  # of each cable
    window: float = positive(0.75)  # s, before and after the present, in which their motion counts


@dataclass(kw_only=True)
class BowedCarrierTrajectoryConfig(BowedReferencesConfig):
    """How finely cables are resolved; what they are made of is the system's."""


class BowedCarrierTrajectory(CarrierTrajectory):
    """Carriers at the ends of cables that bow under their drag, weight and inertia.

    Eq. 1 as an initial value problem: nodes as those of `LumpedCables`, from the attachment and the
    desired force on the load up to where the carrier has to be, and pull. The nodes' motion is that
    over a window of time in which the load follows its reference and the pattern its plan, while
    what the feedback adds to the desired forces changes at a constant rate, see
    `mechanics.bowed_line`. The air moves with `wind_estimate`, and towards a carrier more and more
    with `carrier_gust_estimate`, where that is made.

    `cable_drag_and_weight` is what carriers pull with beyond the desired forces, `cable_reference`
    the motion of the nodes. With a diameter of 0 the references are those of `CarrierTrajectory`.

    Raises:
        ScenarioError: a parameter is out of its range, or the stiffness is no finite number.
    """

    reads: ClassVar[tuple[str, ...]] = (
        "reference",
        "desired_cable_forces",
        "desired_cable_force_rates",
        "planned",
        "wind_estimate",
        _HIGHER_RATES,
        _GUSTS,
        *(_MEASURED, *_ATTITUDES),
        SAMPLE_TIME,
    )
    optional_inputs = (_HIGHER_RATES, _GUSTS, *_ATTITUDES)
    makes: ClassVar[tuple[str, ...]] = (
        *CarrierTrajectory.makes,
        "cable_drag_and_weight",
        "cable_drag_and_weight_rates",
        "cable_reference",
    )
    system = (*CABLE_MATERIAL, *LOAD)
    of_model = (*CarrierTrajectory.of_model, "pattern.phases")

    own: ClassVar[tuple[str, ...]] = ()  # further fields of the config
    bears_drag = True  # of the cables, which aircraft then do not

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        own = {"nodes": config.nodes, "window": TimeWindow.of(config.window, _INSTANTS)}
        return super().constants(model, config) | own | air_density_where_unsaid(model)

    def describe_response(self) -> CarrierReferences:
        found = super().describe_response()
        if not np.any(self.model.system.cable_diameter):
            return found
        window = TimeWindow.of(self.config.window, _INSTANTS)
        return found._replace(shape=CableShape(self.config.nodes, window, material_of(self.model)))

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        system = (*self.system, *model.offset_parameter, *air_density_name(model))
        return _parameters(model, system, config, self.own)

    def layouts(self, model: Model, config: Any) -> dict[str, Layout]:
        return {"cable_reference": nodes_layout(config.nodes)}

    @staticmethod
    def equations(  # type: ignore[override]
        correction: NDArray,
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        planned: NDArray,
        wind: NDArray,
        reference_higher_rates: NDArray,
        gusts: NDArray,
        *measured: NDArray,
        corrects: bool,
        control_period: float,
        window: TimeWindow,
        nodes: int,
        **numbers: Any,
    ) -> tuple[NDArray, ...]:
        given = reference, numbers["attachments"], _rows(forces), _rows(rates)
        own = numbers.pop(_RATES), numbers.pop(_TIME)
        if corrects:
            correction, given = corrected(correction, given, measured, control_period, *own)
        found = bowed_references(
            given,
            planned,
            wind,
            reference_higher_rates,
            gusts,
            window=window,
            nodes=nodes,
            **numbers,
        )
        return (correction, *found.beside(forces, rates))


class BowedReferences(NamedTuple):
    """Motion of carriers at the ends of bowed cables, and of the cables' nodes, in W."""

    ends: NDArray  # (n, 3), m, of the cables, at the load
    carried: NDArray  # (n, 3), N, that the cables pull with there
    position: NDArray  # (n, 3), m, of the carriers
    velocity: NDArray
    acceleration: NDArray
    jerk: NDArray
    pull: NDArray  # (n, 3), N, of the carriers
    pull_rate: NDArray
    nodes: NDArray  # positions and velocities

    def beside(self, forces: NDArray, rates: NDArray) -> tuple[NDArray, ...]:
        """The signals of the references, with pulls beyond desired forces (3n,)."""
        return (
            np.concatenate([self.position, self.velocity]),
            self.acceleration,
            self.jerk,
            self.pull.ravel() - forces,
            self.pull_rate.ravel() - rates,
            self.nodes,
        )


def bowed_references(
    given: _Given,
    planned: NDArray,
    wind: NDArray,
    reference_higher_rates: NDArray,
    gusts: NDArray,
    *,
    window: TimeWindow,
    nodes: int,
    carried: Callable[[NDArray, NDArray], NDArray] | None = None,
    **numbers: NDArray,
) -> BowedReferences:
    """The references of a load's reference, attachments, forces and their rates.

    Args:
        given: these.
        planned: signal, as are the next three.
        wind: of the air at the load.
        reference_higher_rates: of the load's reference.
        gusts: of the carriers beyond that wind.
        window: the time in which motion counts.
        nodes: of each cable.
        carried: what cables pull with (k, n, 3), for desired forces (k, n, 3) and the load's axes
            (k, 3, 3), in W, as rows; None: these forces.
        numbers: parameters and constants of `BowedCarrierTrajectory`.
    """
    reference, attachments, *wanted = given
    motion = LoadMotion.along(reference, reference_higher_rates)
    terms = FlightTerms.along(
        rigid_load(**{name: numbers[name] for name in LOAD}),
        motion,
        wind,
        pseudo_inverse=numbers["pseudo_inverse"],
        offset=numbers.get(OFFSET, np.zeros(1)),
    )
    pattern = partial(orbit_forces, orbit_axes(numbers["basis"], numbers["phases"]))
    along, ends = motion_over_window(terms, pattern, planned, window, attachments)
    pulls = with_feedback(window, along, *wanted)
    if carried is not None:
        pulls = carried(pulls, terms.over(window.times).motion.axes)

    def carried_line(
        pull: NDArray, end: NDArray, gust: NDArray, material: NDArray, wind: NDArray
    ) -> NDArray:
        """Motion and pull of a carrier, and motion of its nodes, (6 + 2 N, 3)."""
        lines = bowed_lines(
            *(pull[:, None], end[:, None], wind, window),
            cable=CableMaterial(*material[:, None]),
            nodes=nodes,
            gusts=gust[None],
        )
        found = [*window.at_present(lines.ends), *window.at_present(lines.forces)[:2]]
        for node in lines.nodes:
            found += window.at_present(node)[:2]
        return np.concatenate(found)

    each = [*(values.swapaxes(0, 1) for values in (pulls, ends)), gusts.reshape(-1, 3)]
    each.append(material_rows(numbers, len(each[0])))
    found = for_each(carried_line, each, [wind]).swapaxes(0, 1)
    moving = np.concatenate([*found[6::2], *found[7::2]]).ravel()
    present = (window.at_present(values)[0] for values in (ends, pulls))
    return BowedReferences._make([*present, *found[:6], moving])


VARIANTS = (
    CarrierTrajectory,
    MeasuredCarrierTrajectory,
    BowedCarrierTrajectory,
)
