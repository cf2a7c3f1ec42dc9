"""Box "Load Wrench Controller" of the figure."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System
from pydrake.systems.primitives import Integrator

from drake_nonstop.mechanics import wrench
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    TRACKING_ERROR_SIZE,
    WRENCH_SIZE,
    TrackingError,
)
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.system import Model
from drake_nonstop.systems.sampled_integrator import SampledIntegrator
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.validation import StrictFields, require, require_non_negative, require_positive

_BOX = "wrench_controller"
_INTEGRALS_SIZE = 6  # of the errors of orientation and position


class _WrenchPid(TracedBlock):
    """PID on the load's pose with feedforward, and the exact rate of its wrench.

    Equations 14-15 and `mechanics.wrench`. The integrals are the block's state, where one of
    their gains is not zero: continuous, or discrete where the model has a control period.

    Args:
        model: the controller's model of the load.
        gains: those of `mechanics.wrench.wrench_and_rate`, and its weight `feedforward`.
    """

    is_sampled = True

    def __init__(self, model: Model, gains: dict[str, Any]):
        def outputs(integrals: NDArray, state: NDArray, reference: NDArray) -> tuple:
            error = wrench.tracking_error(state, reference)
            return (
                np.concatenate(TrackingError.view(error)[:2]),  # e_R and e_p
                *wrench.wrench_and_rate(model.load, state, reference, integrals, **gains),
                error,
            )

        integrates = any(
            np.any(gains[name]) for name in ("position_integral_gain", "orientation_integral_gain")
        )
        period = model.control_period
        state: System | None = None
        if integrates:
            size = _INTEGRALS_SIZE
            state = SampledIntegrator(size, period) if period > 0 else Integrator(size)
        super().__init__(
            outputs
            if integrates
            else lambda *inputs: outputs(np.zeros(_INTEGRALS_SIZE), *inputs)[1:],
            inputs={"measured_load_state": LOAD_STATE_SIZE, "reference": LOAD_REFERENCE_SIZE},
            outputs={
                "wrench": WRENCH_SIZE,
                "wrench_rate": WRENCH_SIZE,
                "tracking_error": TRACKING_ERROR_SIZE,
            },
            state=state,
            key=("wrench", integrates, vars(model), gains),
        )


@dataclass(kw_only=True)
class _PaperGains(StrictFields):
    """The paper's gains (Table I)."""

    position_gain: float = 5.0  # N/m, K_p
    velocity_gain: float = 2.0  # N s/m, K_v
    position_integral_gain: float = 0.9  # N/(m s), K_i
    orientation_gain: float = 0.5  # N m, K_R
    angular_velocity_gain: float = 0.06  # N m s, K_omega
    orientation_integral_gain: float = 0.1  # N m/s, K_iR


@dataclass(kw_only=True)
class WrenchControllerConfig(_PaperGains):
    """The paper's gains (Table I), and the feedforward that its equations leave out."""

    feedforward: float = 1.0  # weight of the reference's own wrench; 0: as in the paper


class WrenchController(_WrenchPid):
    """PID with feedforward: equations 14-15 with the sign of e_ω that damps.

    .. pydrake_system::

        name: WrenchController
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wrench` (6) = [torque (N m);
    force (N)] at the centre of mass and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W. The integrals
    of e_R and e_p (6) are the state, where one of their gains is not zero: continuous, or
    discrete where the model has a control period.

    Parameters, the fields of `WrenchControllerConfig`:
        position_gain: N/m, K_p
        velocity_gain: N s/m, K_v
        position_integral_gain: N/(m s), K_i
        orientation_gain: N m, K_R
        angular_velocity_gain: N m s, K_omega
        orientation_integral_gain: N m/s, K_iR
        feedforward: weight of the reference's own wrench; 0: as in the paper

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: WrenchControllerConfig | None = None):
        gains = asdict(config or WrenchControllerConfig())
        require_non_negative(_BOX, **gains)
        super().__init__(model, gains)


@dataclass(kw_only=True)
class PaperWrenchControllerConfig(_PaperGains):
    """The paper's gains (Table I)."""

    feedforward: float = 0.0  # weight of the reference's own wrench; 0: as in the paper


class PaperWrenchController(_WrenchPid):
    """The PID as printed in the paper: with e_ω = RᵀR_d ω_d − ω, −K_ω is anti-damping.

    A free load under this wrench would tumble. On cables to carriers that follow the desired
    pose it has little effect: they hold the load upright by themselves. The `tracking_error` has
    the e_ω of the other controllers.

    .. pydrake_system::

        name: PaperWrenchController
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wrench` (6) = [torque (N m);
    force (N)] at the centre of mass and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W. The integrals
    of e_R and e_p (6) are the state, where one of their gains is not zero: continuous, or
    discrete where the model has a control period.

    Parameters, the fields of `PaperWrenchControllerConfig`:
        position_gain: N/m, K_p
        velocity_gain: N s/m, K_v
        position_integral_gain: N/(m s), K_i
        orientation_gain: N m, K_R
        angular_velocity_gain: N m s, K_omega
        orientation_integral_gain: N m/s, K_iR
        feedforward: weight of the reference's own wrench; 0: as in the paper

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: PaperWrenchControllerConfig | None = None):
        gains = asdict(config or PaperWrenchControllerConfig())
        require_non_negative(_BOX, **gains)
        super().__init__(model, gains | {"angular_velocity_gain": -gains["angular_velocity_gain"]})


@dataclass(kw_only=True)
class GeometricPdConfig(StrictFields):
    """The paper's gains (Table I) but for those of the integrals."""

    position_gain: float = 5.0  # N/m, K_p
    velocity_gain: float = 2.0  # N s/m, K_v
    orientation_gain: float = 0.5  # N m, K_R
    angular_velocity_gain: float = 0.06  # N m s, K_omega


class GeometricPd(_WrenchPid):
    """Geometric PD that carries the weight, without integrals and feedforward.

    .. pydrake_system::

        name: GeometricPd
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wrench` (6) = [torque (N m);
    force (N)] at the centre of mass and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W.

    Parameters, the fields of `GeometricPdConfig`:
        position_gain: N/m, K_p
        velocity_gain: N s/m, K_v
        orientation_gain: N m, K_R
        angular_velocity_gain: N m s, K_omega

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: GeometricPdConfig | None = None):
        gains = asdict(config or GeometricPdConfig())
        require_non_negative(_BOX, **gains)
        none = dict.fromkeys(
            ("position_integral_gain", "orientation_integral_gain", "feedforward"), 0.0
        )
        super().__init__(model, gains | none)


@dataclass(kw_only=True)
class TunedWrenchControllerConfig(StrictFields):
    """The desired poles of the error, exact on cables without dynamics."""

    position_frequency: float = 2.0  # rad/s, natural frequency
    position_damping: float = 0.8  # damping ratio
    position_integral_rate: float = 0.2  # rad/s, of the pole that the integral adds
    orientation_frequency: float = 5.0  # rad/s, natural frequency
    orientation_damping: float = 0.8  # damping ratio
    orientation_integral_rate: float = 0.2  # rad/s, of the pole that the integral adds
    feedforward: float = 1.0  # weight of the reference's own wrench


class TunedWrenchController(_WrenchPid):
    """PID with feedforward whose gains follow from natural frequencies, mass and inertia.

    Gains from `mechanics.tuning.pid_gains`; those of the orientation are matrices proportional
    to the inertia, so that roll, pitch and yaw respond alike. The damping of the load's drag is
    taken into account.

    .. pydrake_system::

        name: TunedWrenchController
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wrench` (6) = [torque (N m);
    force (N)] at the centre of mass and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W. The integrals
    of e_R and e_p (6) are the state, where one of their gains is not zero: continuous, or
    discrete where the model has a control period.

    Parameters, the fields of `TunedWrenchControllerConfig`:
        position_frequency: rad/s, natural frequency
        position_damping: damping ratio
        position_integral_rate: rad/s, of the pole that the integral adds
        orientation_frequency: rad/s, natural frequency
        orientation_damping: damping ratio
        orientation_integral_rate: rad/s, of the pole that the integral adds
        feedforward: weight of the reference's own wrench

    Raises:
        ScenarioError: a frequency is not positive, another parameter is negative, or the
            drag alone damps more than desired.
    """

    def __init__(self, model: Model, config: TunedWrenchControllerConfig | None = None):
        config = config or TunedWrenchControllerConfig()
        require_non_negative(_BOX, **asdict(config))
        require_positive(
            _BOX,
            position_frequency=config.position_frequency,
            orientation_frequency=config.orientation_frequency,
        )
        gains: dict[str, Any] = {"feedforward": config.feedforward}
        position, velocity, integral = pid_gains(
            config.position_frequency, config.position_damping, config.position_integral_rate
        )
        load = model.load
        gains["position_gain"] = load.mass * position
        gains["velocity_gain"] = load.mass * velocity - load.drag
        gains["position_integral_gain"] = load.mass * integral
        require(
            gains["velocity_gain"] >= 0,
            f"{_BOX}.position_damping",
            config.position_damping,
            "the load's drag alone damps more; give more damping or a higher frequency",
        )
        position, velocity, integral = pid_gains(
            config.orientation_frequency,
            config.orientation_damping,
            config.orientation_integral_rate,
        )
        gains["orientation_gain"] = load.inertia * position
        gains["angular_velocity_gain"] = load.inertia * velocity - load.angular_drag * np.eye(3)
        gains["orientation_integral_gain"] = load.inertia * integral
        require(
            np.linalg.eigvalsh(gains["angular_velocity_gain"])[0] >= 0,
            f"{_BOX}.orientation_damping",
            config.orientation_damping,
            "the load's drag alone damps more; give more damping or a higher frequency",
        )
        super().__init__(model, gains)


# The blocks that the box can be, the default first.
VARIANTS = (WrenchController, PaperWrenchController, GeometricPd, TunedWrenchController)
