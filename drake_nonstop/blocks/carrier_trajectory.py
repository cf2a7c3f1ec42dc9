"""Box "Carrier Desired Trajectories" of the figure."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.carrier import (
    carrier_acceleration,
    carrier_jerk,
    carrier_motion,
    motion_after,
)
from drake_nonstop.mechanics.force_rates import second_and_third_force_rates
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    REFERENCE_HIGHER_RATES_SIZE,
    WIND_SIZE,
)
from drake_nonstop.model.block_parameters import LOAD, BlockParameters, rigid_load
from drake_nonstop.model.system import Model
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.traced_block import LateOutputs, LaterOutputs, TracedBlock
from drake_nonstop.systems.wiring import WiringError
from drake_nonstop.validation import StrictFields, require

_BOX = "carrier_trajectory"
_HOLDS = {"third_order": 3, "second_order": 2, "velocity": 1}  # and their orders
_DERIVATIVES = ("carrier_reference_acceleration", "carrier_reference_jerk")
_FORCE_RATES = "internal_force_higher_rates"
_FOR_DERIVATIVES = (_FORCE_RATES, "wind_estimate")
_HIGHER_RATES = "reference_higher_rates"


class _TrajectoryAboveLoad(TracedBlock):
    """The carriers' positions and velocities for the desired cable forces (eqs. 1, 22).

    The attachments are those of a given load pose.

    Args:
        model: attachments and cables.
        pose: the signal with the load's pose, and its size: a load state, or what begins with
            one.
        stretches: whether the cables do, by their stiffness.
        derivatives: makes accelerations and jerks as well, of these inputs and three more.
        hold_order: how they move between the samples of a sampled controller: 1 along their
            velocities, 2 with their accelerations, 3 with their jerks, too; 0: there are none.
    """

    is_sampled = True

    def __init__(
        self,
        model: Model,
        *,
        pose: tuple[str, int],
        stretches: bool = True,
        derivatives: LateOutputs | None = None,
        hold_order: int,
    ):
        attachments = model.attachments

        def motion(
            state: NDArray,
            forces: NDArray,
            rates: NDArray,
            *_: NDArray,
            cable_length: NDArray,
            cable_stiffness: NDArray | None = None,
            **load: NDArray,
        ) -> NDArray:
            return np.concatenate(
                carrier_motion(
                    state,
                    forces.reshape(-1, 3),
                    rates.reshape(-1, 3),
                    attachments=attachments,
                    rest_length=cable_length,
                    compliance=_compliance(cable_stiffness),
                )
            )

        inputs = dict([pose])
        inputs |= dict.fromkeys(("desired_cable_forces", "desired_cable_force_rates"), 3 * model.n)
        parameters = _of_cables(stretches)
        if derivatives is not None:
            inputs |= {"internal_force_higher_rates": 2 * model.m, "wind_estimate": WIND_SIZE}
            parameters += LOAD
        super().__init__(
            motion,
            inputs=inputs,
            outputs={"carrier_reference": 6 * model.n},
            parameters=BlockParameters(model, parameters),
            key=("carrier trajectory", tuple(inputs), stretches, attachments),
            late=derivatives,
            later=_hold(model.n, hold_order) if hold_order > 0 else None,
        )


class _TrajectoryAboveReference(_TrajectoryAboveLoad):
    """A `_TrajectoryAboveLoad` on its reference, with accelerations and jerks.

    Args:
        model: as there.
        config: how the references move between the samples of a sampled controller.
        stretches: as there.

    Attributes:
        hold_order: of the references' motion between samples: 1 along their velocities, 2 with
            their accelerations, 3 with their jerks, too; 0: there are no samples.
    """

    is_sampled = True

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Raises WiringError where its accelerations are used, and the force's rates not made."""
        is_used = self.hold_order >= 2 or any(
            {*_DERIVATIVES} & loop.needed(name) for name in loop.blocks
        )
        internal_force = loop.get("internal_force")
        if is_used and internal_force is not None and loop.maker_of(_FORCE_RATES) is None:
            raise WiringError(
                f"internal_force = {type(internal_force).__name__}: it does not make "
                f"{_FORCE_RATES}, of which the references' accelerations follow; give it this "
                "output, the second and third rates (2m) of the internal force, or "
                "internal_force=InternalForceTrajectory"
            )
        yield from ()

    def __init__(self, model: Model, config: Any, *, stretches: bool = True):
        require(config.hold in _HOLDS, f"{_BOX}.hold", config.hold, f"give {' or '.join(_HOLDS)}")
        is_sampled = model.control_period > 0
        order = _HOLDS[config.hold] if is_sampled else 0
        super().__init__(
            model,
            pose=("reference", LOAD_REFERENCE_SIZE),
            stretches=stretches,
            derivatives=_derivatives(model),
            hold_order=order,
        )
        self.hold_order = order
        self.optional_inputs = (_HIGHER_RATES, *(_FOR_DERIVATIVES if order < 2 else ()))


def _hold(n: int, order: int) -> LaterOutputs:
    """The motion of n carriers at a time, of that at `sample_time` and its derivatives.

    One of third order has the acceleration at that time, too.
    """
    names = ("carrier_reference", *_DERIVATIVES[: order - 1])

    def moved(motion: NDArray, *derivatives_and_times: NDArray) -> Any:
        *derivatives, sample_time, time = derivatives_and_times
        since = time - sample_time
        after = motion_after(motion.reshape(-1), since, *derivatives)
        return (after, derivatives[0] + since * derivatives[1]) if order == 3 else after

    made = names[: max(1, order - 1)]
    return LaterOutputs(moved, names, {"sample_time": 1}, made, key=("hold", n, order))


def _derivatives(model: Model) -> LateOutputs:
    """The carriers' accelerations and jerks while the load is on its reference."""
    attachments, pseudo_inverse = model.attachments, model.pseudo_inverse
    basis = model.pattern.basis

    def derivatives(
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        internal_force_higher_rates: NDArray,
        wind: NDArray,
        reference_higher_rates: NDArray,
        *,
        cable_length: NDArray,
        cable_stiffness: NDArray | None = None,
        **load: NDArray,
    ) -> tuple[NDArray, NDArray]:
        forces, rates = forces.reshape(-1, 3), rates.reshape(-1, 3)
        higher_rates = second_and_third_force_rates(
            rigid_load(**load),
            reference,
            forces,
            rates,
            internal_force_higher_rates,
            wind,
            reference_higher_rates,
            pseudo_inverse=pseudo_inverse,
            basis=basis,
        )
        cables: dict[str, Any] = {
            "attachments": attachments,
            "rest_length": cable_length,
            "compliance": _compliance(cable_stiffness),
        }
        return (
            carrier_acceleration(reference, forces, rates, higher_rates[0], **cables),
            carrier_jerk(reference, forces, rates, *higher_rates, **cables),
        )

    return LateOutputs(
        derivatives,
        (
            "reference",
            "desired_cable_forces",
            "desired_cable_force_rates",
            *_FOR_DERIVATIVES,
        ),
        dict.fromkeys(_DERIVATIVES, 3 * model.n),
        {_HIGHER_RATES: REFERENCE_HIGHER_RATES_SIZE},
        key=("carrier derivatives", attachments, basis),
    )


def _of_cables(stretches: bool) -> tuple[str, ...]:
    """The fields of the system that cables go by."""
    return ("cable_length", "cable_stiffness") if stretches else ("cable_length",)


def _compliance(stiffness: NDArray | None) -> NDArray:
    """Of cables of a stiffness (1,) in N/m, None if they do not stretch: (1,) in m/N."""
    return np.zeros(1) if stiffness is None else compliance_of(stiffness)


@dataclass(kw_only=True)
class _Hold(StrictFields):
    hold: str = "third_order"  # of the references between samples; or "second_order", "velocity"


@dataclass(kw_only=True)
class CarrierTrajectoryConfig(_Hold):
    """How the references move between samples; the cables are the system's."""


class CarrierTrajectory(_TrajectoryAboveReference):
    """Carriers above the desired load pose, on cables stretched by the desired forces (eqs. 1, 22).

    The cables stretch by the system's stiffness (.inf: L_i = L₀, as in the paper).

    .. pydrake_system::

        name: CarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force_higher_rates
        - wind_estimate
        - reference_higher_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference
        - carrier_reference_acceleration
        - carrier_reference_jerk

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `internal_force_higher_rates` (2m) = [λ̈ (N/s²); λ⃛ (N/s³)] and `wind_estimate` (3, m/s) in W,
    which only accelerations and jerks need; so do `reference_higher_rates` (6) = [angular jerk
    (rad/s³), snap (m/s⁴)] in W, which may be left unconnected and then are taken as zero;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W. A
    time τ after a sample it is p + τ v + τ² a/2 + τ³ j/6 and v + τ a + τ² j/2; with `hold`
    "second_order" there is no j, with "velocity" no a.

    `carrier_reference_acceleration` (3n, m/s²) and `carrier_reference_jerk` (3n, m/s³) in W are
    those while the load is on its reference, whose rates beyond these are taken as zero, see
    `mechanics.force_rates`; between samples they stand still, but for an acceleration of third
    order, a + τ j.

    Parameters, the fields of `CarrierTrajectoryConfig`:
        hold: of the references between samples; or "second_order", "velocity"

    Raises:
        ScenarioError: `hold` is another text.
    """

    def __init__(self, model: Model, config: CarrierTrajectoryConfig | None = None):
        super().__init__(model, config or CarrierTrajectoryConfig())


@dataclass(kw_only=True)
class InextensibleCarrierTrajectoryConfig(_Hold):
    """How the references move between samples; the cables are the system's."""


class InextensibleCarrierTrajectory(_TrajectoryAboveReference):
    """Carriers above the desired load pose, on inextensible cables L_i = L₀, as in the paper.

    If the simulated cables stretch, the load hangs lower until the wrench controller's integral
    lifts it.

    .. pydrake_system::

        name: InextensibleCarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force_higher_rates
        - wind_estimate
        - reference_higher_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference
        - carrier_reference_acceleration
        - carrier_reference_jerk

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `internal_force_higher_rates` (2m) = [λ̈ (N/s²); λ⃛ (N/s³)] and `wind_estimate` (3, m/s) in W,
    which only accelerations and jerks need; so do `reference_higher_rates` (6) = [angular jerk
    (rad/s³), snap (m/s⁴)] in W, which may be left unconnected and then are taken as zero;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W. A
    time τ after a sample it is p + τ v + τ² a/2 + τ³ j/6 and v + τ a + τ² j/2; with `hold`
    "second_order" there is no j, with "velocity" no a.

    `carrier_reference_acceleration` (3n, m/s²) and `carrier_reference_jerk` (3n, m/s³) in W are
    those while the load is on its reference, whose rates beyond these are taken as zero, see
    `mechanics.force_rates`; between samples they stand still, but for an acceleration of third
    order, a + τ j.

    Parameters, the fields of `InextensibleCarrierTrajectoryConfig`:
        hold: of the references between samples; or "second_order", "velocity"

    Raises:
        ScenarioError: `hold` is another text.
    """

    def __init__(self, model: Model, config: InextensibleCarrierTrajectoryConfig | None = None):
        super().__init__(model, config or InextensibleCarrierTrajectoryConfig(), stretches=False)


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(_TrajectoryAboveLoad):
    """Carriers above the measured load pose: they follow the load wherever it is.

    Only the wrench controller then corrects the load's pose. It does not make the accelerations and
    jerks that the others make: those of the measured load are not known.

    .. pydrake_system::

        name: MeasuredCarrierTrajectory
        input_ports:
        - measured_load_state
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `measured_load_state` (13), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W.
    Between samples the reference moves along its velocity.
    """

    def __init__(self, model: Model, config: MeasuredCarrierTrajectoryConfig | None = None):
        pose = ("measured_load_state", LOAD_STATE_SIZE)
        super().__init__(model, pose=pose, hold_order=int(model.control_period > 0))


# The blocks that the box can be, the default first.
VARIANTS = (CarrierTrajectory, InextensibleCarrierTrajectory, MeasuredCarrierTrajectory)
