"""Box "Load Wrench Controller" of the figure."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System
from pydrake.systems.primitives import Integrator

from drake_nonstop.mechanics import wrench
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.system import Model
from drake_nonstop.systems.sampled_integrator import SampledIntegrator
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.validation import require, require_non_negative, require_positive

_OWNER = "wrench_controller"


class LoadWrenchPid(TracedBlock):
    """PID on the load's pose with feedforward, and the exact rate of its wrench.

    Equations 14-15 and `mechanics.wrench`. The integrals are the block's state, where one of
    their gains is not zero: continuous, or discrete where the model has a control period.

    .. pydrake_system::

        name: LoadWrenchPid
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22) as everywhere, in W; `wrench` and
    `wrench_rate` (6) are [torque; force] at the centre of mass, in W; `tracking_error`
    (12) is [e_R, e_p, e_ω, e_v].

    Args:
        model: the load that the controller believes in.
        gains: those of `mechanics.wrench.wrench_and_rate`, and its weight `feedforward`.
    """

    def __init__(self, model: Model, gains: dict[str, Any]):
        def outputs(integrals: NDArray, state: NDArray, reference: NDArray) -> tuple:
            error = wrench.tracking_error(state, reference)
            return (
                error[:6],
                *wrench.wrench_and_rate(
                    state,
                    reference,
                    integrals,
                    **gains,
                    mass=model.load_mass,
                    inertia=model.load_inertia,
                    inertia_inverse=model.load_inertia_inverse,
                    drag=model.load_drag,
                    angular_drag=model.load_angular_drag,
                    gravity=model.gravity,
                ),
                error,
            )

        integrates = any(
            np.any(gains[name]) for name in ("position_integral_gain", "orientation_integral_gain")
        )
        period = model.control_period
        state: System | None = None
        if integrates:
            state = SampledIntegrator(6, period) if period > 0 else Integrator(6)
        super().__init__(
            outputs if integrates else lambda *inputs: outputs(np.zeros(6), *inputs)[1:],
            inputs={"measured_load_state": 13, "reference": 22},
            outputs={"wrench": 6, "wrench_rate": 6, "tracking_error": 12},
            state=state,
            key=("wrench", integrates, vars(model), gains),
        )


@dataclass(kw_only=True)
class WrenchControllerConfig:
    """The paper's gains (Table I), and the feedforward that its equations leave out."""

    position_gain: float = 5.0  # N/m, K_p
    velocity_gain: float = 2.0  # N s/m, K_v
    position_integral_gain: float = 0.9  # N/(m s), K_i
    orientation_gain: float = 0.5  # N m, K_R
    angular_velocity_gain: float = 0.06  # N m s, K_omega
    orientation_integral_gain: float = 0.1  # N m/s, K_iR
    feedforward: float = 1.0  # weight of the reference's own wrench; 0: as printed


class WrenchController(LoadWrenchPid):
    """PID with feedforward: equations 14-15 with the sign of e_ω that damps.

    Ports as `LoadWrenchPid`.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: WrenchControllerConfig | None = None):
        gains = asdict(config or WrenchControllerConfig())
        require_non_negative(_OWNER, **gains)
        super().__init__(model, gains)


@dataclass(kw_only=True)
class PaperWrenchControllerConfig(WrenchControllerConfig):
    """The paper's gains (Table I)."""

    feedforward: float = 0.0  # weight of the reference's own wrench; 0: as printed


class PaperWrenchController(LoadWrenchPid):
    """The PID to the letter: e_ω = RᵀR_d ω_d − ω under −K_ω drives a turning load further.

    Ports as `LoadWrenchPid`; the `tracking_error` has the e_ω of the other controllers. A load
    that got this wrench would tumble. On cables to carriers that follow the desired pose little
    of it shows: they hold the load upright by themselves.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: PaperWrenchControllerConfig | None = None):
        gains = asdict(config or PaperWrenchControllerConfig())
        require_non_negative(_OWNER, **gains)
        super().__init__(model, gains | {"angular_velocity_gain": -gains["angular_velocity_gain"]})


@dataclass(kw_only=True)
class GeometricPdConfig:
    """The paper's gains (Table I) but for those of the integrals."""

    position_gain: float = 5.0  # N/m, K_p
    velocity_gain: float = 2.0  # N s/m, K_v
    orientation_gain: float = 0.5  # N m, K_R
    angular_velocity_gain: float = 0.06  # N m s, K_omega


class GeometricPd(LoadWrenchPid):
    """Geometric PD that carries the weight, without integrals and feedforward.

    Ports as `LoadWrenchPid`. What it leaves is what the integrals and the feedforward of
    `WrenchController` are for.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: GeometricPdConfig | None = None):
        gains = asdict(config or GeometricPdConfig())
        require_non_negative(_OWNER, **gains)
        none = dict.fromkeys(
            ("position_integral_gain", "orientation_integral_gain", "feedforward"), 0.0
        )
        super().__init__(model, gains | none)


@dataclass(kw_only=True)
class TunedWrenchControllerConfig:
    """Where the poles of the error are to be: on cables without dynamics they are there."""

    position_frequency: float = 2.0  # rad/s, natural frequency
    position_damping: float = 0.8  # damping ratio
    position_integral_rate: float = 0.2  # rad/s, of the pole that the integral adds
    orientation_frequency: float = 5.0  # rad/s, natural frequency
    orientation_damping: float = 0.8  # damping ratio
    orientation_integral_rate: float = 0.2  # rad/s, of the pole that the integral adds
    feedforward: float = 1.0  # weight of the reference's own wrench


class TunedWrenchController(LoadWrenchPid):
    """PID with feedforward whose gains follow from natural frequencies, mass and inertia.

    Ports as `LoadWrenchPid`, gains from `mechanics.tuning.pid_gains`; the gains of the
    orientation are matrices in the proportions of the inertia, so that roll, pitch and yaw
    answer alike. The damping of the load's drag is counted in.

    Raises:
        ScenarioError: a frequency is not positive, another parameter is negative, or the
            drag alone damps more than what is asked for.
    """

    def __init__(self, model: Model, config: TunedWrenchControllerConfig | None = None):
        config = config or TunedWrenchControllerConfig()
        require_non_negative(_OWNER, **asdict(config))
        require_positive(
            _OWNER,
            position_frequency=config.position_frequency,
            orientation_frequency=config.orientation_frequency,
        )
        gains: dict[str, Any] = {"feedforward": config.feedforward}
        position, velocity, integral = pid_gains(
            config.position_frequency, config.position_damping, config.position_integral_rate
        )
        gains["position_gain"] = model.load_mass * position
        gains["velocity_gain"] = model.load_mass * velocity - model.load_drag
        gains["position_integral_gain"] = model.load_mass * integral
        require(
            gains["velocity_gain"] >= 0,
            f"{_OWNER}.position_damping",
            config.position_damping,
            "the load's drag alone damps more; give more damping or a higher frequency",
        )
        position, velocity, integral = pid_gains(
            config.orientation_frequency,
            config.orientation_damping,
            config.orientation_integral_rate,
        )
        gains["orientation_gain"] = model.load_inertia * position
        gains["angular_velocity_gain"] = (
            model.load_inertia * velocity - model.load_angular_drag * np.eye(3)
        )
        gains["orientation_integral_gain"] = model.load_inertia * integral
        require(
            np.linalg.eigvalsh(gains["angular_velocity_gain"])[0] >= 0,
            f"{_OWNER}.orientation_damping",
            config.orientation_damping,
            "the load's drag alone damps more; give more damping or a higher frequency",
        )
        super().__init__(model, gains)


VARIANTS = (
    WrenchController,
    PaperWrenchController,
    GeometricPd,
    TunedWrenchController,
)  # of the box, the default first
