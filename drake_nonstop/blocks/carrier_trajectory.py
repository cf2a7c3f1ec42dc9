"""Box "Carrier Desired Trajectories" of the figure."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

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
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import (
    SAMPLE_TIME,
    SAMPLED,
    LoadReference,
    LoadState,
    nodes_layout,
)
from drake_nonstop.mechanics.taylor import Taylor
from drake_nonstop.model.block import (
    LOAD,
    Block,
    BlockParameters,
    rigid_load,
    with_this_sample,
)
from drake_nonstop.model.descriptions import CarrierReferences, described
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.systems.equations import BetweenSamples
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import for_each
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    number_or_list,
    one_of,
    positive,
    require,
    require_non_negative,
    require_ranges,
    vector,
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
_GUSTS = "carrier_gust_estimate"


class _CarrierReferences(Block):
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


@dataclass(kw_only=True)
class _MovingReferencesConfig(StrictFields):
    """How the references move, between samples and against errors; the cables are the system's."""

    hold: str = checked(  # of the references between samples: "third_order" or "velocity"
        "third_order", one_of(_HOLDS, f"give {' or '.join(_HOLDS)}")
    )
    # rad/s, along x, y and z of W, at which the references move against the load's measured error
    correction_rates: list[float] = vector([0.0] * 3, "in W", number_or_list(require_non_negative))


@dataclass(kw_only=True)
class CarrierTrajectoryConfig(_MovingReferencesConfig):
    """How the references move, between samples and against errors; the cables are the system's."""


class CarrierTrajectory(_CarrierReferences):
    """Carriers above the desired load pose, on cables stretched by the desired forces (eqs. 1, 22).

    The cables stretch by the system's stiffness (.inf: L_i = L₀, as in the paper). Only
    accelerations and jerks need `internal_force_higher_rates`, `wind_estimate` and
    `reference_higher_rates`: they are those while the load is on its reference, whose rates beyond
    these are taken as zero, see `mechanics.grasp`.

    A time τ after a sample the `carrier_reference` is p + τ v + τ² a/2 + τ³ j/6 and
    v + τ a + τ² j/2, and its acceleration a + τ j. With the `hold` "velocity" they are p + τ v, v
    and a. Jerks stand still.

    With `correction_rates` σ, one for each axis of W, the load's reference is moved by the state s,
    of ṡ = −σ (p − p_d), and by its velocity ṡ, with the measured position p: what else holds the
    load off its reference, such as cables of another length, dies out as exp(−σ t). The integral of
    a wrench controller cannot do that on long cables: a force moves the load only by the cables'
    stretch, 2.3 mm/N in `aircraft_rest`, and its predicted rate is that of a free load. Rates above
    a tenth of the carriers' frequency are lost in `aircraft_co_rotating`.

    Raises:
        ScenarioError: `hold` is another text, or a rate is negative.
    """

    reads: ClassVar[tuple[str, ...]] = (
        "reference",
        "desired_cable_forces",
        "desired_cable_force_rates",
        *_FOR_DERIVATIVES,
        _HIGHER_RATES,
        _MEASURED,
        SAMPLE_TIME,
    )
    makes: ClassVar[tuple[str, ...]] = (
        "carrier_reference",
        *_DERIVATIVES,
        *(SAMPLED + name for name in _MOVED),
    )
    where: ClassVar = {
        **_CarrierReferences.where,
        _MEASURED: "`correction_rates` are not all zero",
    }
    optional_inputs: tuple[str, ...] = (_HIGHER_RATES,)
    system: ClassVar[tuple[str, ...]] = ("cable_length", "cable_stiffness", *LOAD)
    of_model: ClassVar[tuple[str, ...]] = (
        *_CarrierReferences.of_model,
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

    def state(self, model: Model) -> NDArray:
        return np.zeros(3)

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        return bool(np.any(config.correction_rates))

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
        shift: NDArray,
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        internal_force_higher_rates: NDArray,
        wind: NDArray,
        reference_higher_rates: NDArray,
        *measured: NDArray,
        corrects: bool,
        correction_rates: NDArray,
        control_period: float,
        pseudo_inverse: NDArray,
        basis: NDArray,
        attachments: NDArray,
        cable_length: NDArray,
        cable_stiffness: NDArray,
        **load: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        motion, shift_rate = LoadMotion.along(reference, reference_higher_rates), shift
        along = forces_along(
            rigid_load(**load),
            motion,
            forces.reshape(-1, 3),
            rates.reshape(-1, 3),
            internal_force_higher_rates,
            wind,
            pseudo_inverse=pseudo_inverse,
            basis=basis,
        )
        if corrects:
            motion, shift_rate = _corrected(
                motion, shift, *measured, rates=correction_rates, period=control_period
            )
        cables = _cables(attachments, cable_length, cable_stiffness)
        position, velocity, acceleration, jerk = carrier_positions(motion, along, **cables).rates
        return shift_rate, np.concatenate([position, velocity]), acceleration, jerk

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return super().constants(model, config) | {"corrects": self.has_state(model, config)}

    def inputs(self, model: Model) -> tuple[str, ...]:
        left_out = () if self.has_state(model, self.config) else (_MEASURED,)
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


def _corrected(
    motion: LoadMotion,
    shift: NDArray,
    load_state: NDArray,
    *sample_time: NDArray,
    rates: NDArray,
    period: float,
) -> tuple[LoadMotion, NDArray]:
    """A motion, moved by the shift s after this sample and at the velocity ṡ, and the state's rate.

    ṡ = −σ (p − p_d), with the measured position p and σ (3,), rad/s, along the axes of W.
    """
    speed = rates * (motion.position.coefficients[0] - LoadState.view(load_state).position)
    rate, shift = with_this_sample(shift, speed, sample_time, period)
    steady = Taylor([shift, speed, *[0 * speed] * (len(motion.position.coefficients) - 2)])
    return motion._replace(position=motion.position + steady), rate


def _cables(attachments: NDArray, length: NDArray, stiffness: NDArray) -> dict[str, Any]:
    """Cables of lengths in m and stiffnesses in N/m, (1,) or (n,)."""
    compliance = compliance_of(stiffness)
    return {"attachments": attachments, "rest_length": length, "compliance": compliance}


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(_CarrierReferences):
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
class BowedCarrierTrajectoryConfig(_MovingReferencesConfig):
    """How finely cables are resolved; what they are made of is the system's."""

    nodes: int = checked(12, check_nodes)  # of each cable
    window: float = positive(0.75)  # s, before and after the present, in which their motion counts


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

    reads = (
        "reference",
        "desired_cable_forces",
        "desired_cable_force_rates",
        "planned",
        "wind_estimate",
        _HIGHER_RATES,
        _GUSTS,
        _MEASURED,
        SAMPLE_TIME,
    )
    optional_inputs = (_HIGHER_RATES, _GUSTS)
    makes = (
        *CarrierTrajectory.makes,
        "cable_drag_and_weight",
        "cable_drag_and_weight_rates",
        "cable_reference",
    )
    system = (*CABLE_MATERIAL, *LOAD)
    of_model = (*CarrierTrajectory.of_model, "pattern.phases")

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
        return BlockParameters(model, system, config=config, own=["correction_rates"])

    def layouts(self, model: Model, config: Any) -> dict[str, Layout]:
        return {"cable_reference": nodes_layout(config.nodes)}

    @staticmethod
    def equations(  # type: ignore[override]
        shift: NDArray,
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
        correction_rates: NDArray,
        window: TimeWindow,
        nodes: int,
        **numbers: NDArray,
    ) -> tuple[NDArray, ...]:
        motion, shift_rate = LoadMotion.along(reference, reference_higher_rates), shift
        if corrects:
            motion, shift_rate = _corrected(
                motion, shift, *measured, rates=correction_rates, period=control_period
            )
        terms = FlightTerms.along(
            rigid_load(**{name: numbers[name] for name in LOAD}),
            motion,
            wind,
            pseudo_inverse=numbers["pseudo_inverse"],
            offset=numbers.get(OFFSET, np.zeros(1)),
        )
        pattern = partial(orbit_forces, orbit_axes(numbers["basis"], numbers["phases"]))
        attachments = numbers["attachments"]
        along, ends = motion_over_window(terms, pattern, planned, window, attachments)
        pulls = with_feedback(window, along, forces.reshape(-1, 3), rates.reshape(-1, 3))

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

        own = [*(values.swapaxes(0, 1) for values in (pulls, ends)), gusts.reshape(-1, 3)]
        own.append(material_rows(numbers, len(own[0])))
        found = for_each(carried_line, own, [wind]).swapaxes(0, 1)
        position, velocity, acceleration, jerk, pull, pull_rate, *moving = found
        return (
            shift_rate,
            np.concatenate([position, velocity]),
            acceleration,
            jerk,
            pull.ravel() - forces,
            pull_rate.ravel() - rates,
            np.concatenate([*moving[::2], *moving[1::2]]).ravel(),
        )


VARIANTS = (
    CarrierTrajectory,
    MeasuredCarrierTrajectory,
    BowedCarrierTrajectory,
)
