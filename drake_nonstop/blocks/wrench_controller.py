"""Box "Load Wrench Controller" of the figure."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import wrench
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    TRACKING_ERROR_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
    TrackingError,
)
from drake_nonstop.mechanics.tuning import load_gains, pid_gains
from drake_nonstop.model.block_parameters import AUTO, LOAD, BlockParameters, Rules, rigid_load
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import number
from drake_nonstop.systems.traced_block import TracedDynamics
from drake_nonstop.validation import StrictFields, require, require_non_negative, require_positive

_BOX = "wrench_controller"
_INTEGRALS_SIZE = 6  # of the errors of orientation and position
_FOLLOWED = ("load_mass", "load_inertia", "cable_length", "gravity")  # by gains that are `AUTO`


class _WrenchPid(TracedDynamics):
    """PID on the load's pose with feedforward, and the exact rate of its wrench.

    Equations 14-15 and `mechanics.wrench`. The integrals are the block's state, where one of
    their gains is not zero: continuous, or discrete where the model has a control period.

    Args:
        model: the controller's model of the load.
        config: the block's.
        check: of the block.
        gains: takes the load and, by name, the fields of the config, numbers or symbols, and
            returns the gains of `mechanics.wrench.wrench_and_rate` and its `feedforward`.

    Attributes:
        gains: what `gains` returns of the model's load.
    """

    is_sampled = True

    def __init__(
        self,
        model: Model,
        config: Any,
        check: Callable[[Model, Any], None],
        gains: Callable[..., dict[str, Any]],
    ):
        check(model, config)
        can_follow = AUTO in asdict(type(config)()).values()

        def outputs(
            integrals: NDArray,
            state: NDArray,
            reference: NDArray,
            wind: NDArray,
            **numbers: NDArray,
        ) -> tuple:
            load = rigid_load(**{name: numbers.pop(name) for name in LOAD})
            numbers.pop("cable_length", None)
            error = wrench.tracking_error(state, reference)
            return (
                np.concatenate(TrackingError.view(error)[:2]),  # e_R and e_p
                *wrench.wrench_and_rate(
                    load, state, reference, integrals, wind, **gains(load, **numbers)
                ),
                error,
            )

        def has_integral(model: Model, config: Any) -> bool:
            found = gains(model.load, **_numbers(model, config))
            names = ("position_integral_gain", "orientation_integral_gain")
            return any(np.any(found[name]) for name in names)

        integrates = has_integral(model, config)
        rules = Rules(check=check, structure=has_integral)
        super().__init__(
            outputs
            if integrates
            else lambda *inputs, **numbers: outputs(np.zeros(_INTEGRALS_SIZE), *inputs, **numbers)[
                1:
            ],
            inputs={
                "measured_load_state": LOAD_STATE_SIZE,
                "reference": LOAD_REFERENCE_SIZE,
                "wind_estimate": WIND_SIZE,
            },
            outputs={
                "wrench": WRENCH_SIZE,
                "wrench_rate": WRENCH_SIZE,
                "tracking_error": TRACKING_ERROR_SIZE,
            },
            state=np.zeros(_INTEGRALS_SIZE) if integrates else None,
            period=model.control_period,
            parameters=BlockParameters(
                model,
                (*LOAD, "cable_length") if can_follow else LOAD,
                config=config,
                own=asdict(config),
                rules=replace(rules, follow=_following) if can_follow else rules,
            ),
            key=("wrench", integrates, gains.__module__, gains.__qualname__),
            is_joint=True,  # a second one for what does not read the wind would take longer
        )
        self.gains = gains(model.load, **_numbers(model, config))


def _check(model: Model, config: Any) -> None:
    for name, value in asdict(config).items():
        if isinstance(value, str):
            remedy = f'give a number, without quotes, or "{AUTO}"'
            require(value == AUTO, f"{_BOX}.{name}", value, remedy)
        else:
            require_non_negative(_BOX, **{name: value})


def _numbers(model: Model, config: Any) -> dict[str, Any]:
    """The fields of a config, with numbers for those that are `AUTO`."""
    following = _following({name: model.number(name) for name in _FOLLOWED})
    return {k: following[k] if v == AUTO else v for k, v in asdict(config).items()}


def _following(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The gains of a load and cables, with the least of the load's principal moments of inertia.

    Turned about another axis, the load is slower than with that.
    """
    inertia = np.asarray(numbers["load_inertia"])
    _, axes = np.linalg.eigh([[number(entry) for entry in row] for row in inertia])
    least = axes[:, 0] @ inertia @ axes[:, 0]
    return load_gains(numbers["load_mass"], least, numbers["cable_length"], numbers["gravity"])


def _as_given(load: RigidLoad, **gains: Any) -> dict[str, Any]:
    return gains


@dataclass(kw_only=True)
class _Gains(StrictFields):
    """The gains."""

    position_gain: float | str = AUTO  # N/m, K_p; auto: by mass and cables
    velocity_gain: float | str = AUTO  # N s/m, K_v; auto: by mass and cables
    position_integral_gain: float | str = AUTO  # N/(m s), K_i; auto: by mass and cables
    orientation_gain: float | str = AUTO  # N m, K_R; auto: by inertia and cables
    angular_velocity_gain: float | str = AUTO  # N m s, K_omega; auto: by inertia and cables
    orientation_integral_gain: float | str = AUTO  # N m/s, K_iR; auto: by inertia and cables


@dataclass(kw_only=True)
class WrenchControllerConfig(_Gains):
    """The gains, and the feedforward that the paper's equations leave out."""

    feedforward: float = 1.0  # weight of the reference's own wrench; 0: as in the paper


class WrenchController(_WrenchPid):
    """PID with feedforward: equations 14-15 with the sign of e_ω that damps.

    Gains that are "auto" follow from the model's mass, inertia, cables and gravity, by
    `mechanics.tuning.load_gains`: for its load the paper's (Table I), but for more damping of the
    position and a quarter of the torques.

    .. pydrake_system::

        name: WrenchController
        input_ports:
        - measured_load_state
        - reference
        - wind_estimate
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wind_estimate` (3, m/s) in W, from
    which the load's drag follows; `wrench` (6) = [torque (N m); force (N)] at the centre of mass
    and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W. The integrals
    of e_R and e_p (6) are the state, where one of their gains is not zero: continuous, or
    discrete where the model has a control period.

    Parameters, the fields of `WrenchControllerConfig`:
        position_gain: N/m, K_p; auto: by mass and cables
        velocity_gain: N s/m, K_v; auto: by mass and cables
        position_integral_gain: N/(m s), K_i; auto: by mass and cables
        orientation_gain: N m, K_R; auto: by inertia and cables
        angular_velocity_gain: N m s, K_omega; auto: by inertia and cables
        orientation_integral_gain: N m/s, K_iR; auto: by inertia and cables
        feedforward: weight of the reference's own wrench; 0: as in the paper

    Raises:
        ScenarioError: a gain is negative or not finite, or another word than "auto".
    """

    def __init__(self, model: Model, config: WrenchControllerConfig | None = None):
        super().__init__(model, config or WrenchControllerConfig(), _check, _as_given)


@dataclass(kw_only=True)
class PaperWrenchControllerConfig(_Gains):
    """The gains."""

    feedforward: float = 0.0  # weight of the reference's own wrench; 0: as in the paper


class PaperWrenchController(_WrenchPid):
    """The PID as printed in the paper: with e_ω = RᵀR_d ω_d − ω, −K_ω is anti-damping.

    A free load under this wrench would tumble. On cables to carriers that follow the desired
    pose it has little effect: they hold the load upright by themselves. The `tracking_error` has
    the e_ω of the other controllers.

    Gains that are "auto" follow from the model's mass, inertia, cables and gravity, by
    `mechanics.tuning.load_gains`: for its load the paper's (Table I), but for more damping of the
    position and a quarter of the torques.

    .. pydrake_system::

        name: PaperWrenchController
        input_ports:
        - measured_load_state
        - reference
        - wind_estimate
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wind_estimate` (3, m/s) in W, from
    which the load's drag follows; `wrench` (6) = [torque (N m); force (N)] at the centre of mass
    and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W. The integrals
    of e_R and e_p (6) are the state, where one of their gains is not zero: continuous, or
    discrete where the model has a control period.

    Parameters, the fields of `PaperWrenchControllerConfig`:
        position_gain: N/m, K_p; auto: by mass and cables
        velocity_gain: N s/m, K_v; auto: by mass and cables
        position_integral_gain: N/(m s), K_i; auto: by mass and cables
        orientation_gain: N m, K_R; auto: by inertia and cables
        angular_velocity_gain: N m s, K_omega; auto: by inertia and cables
        orientation_integral_gain: N m/s, K_iR; auto: by inertia and cables
        feedforward: weight of the reference's own wrench; 0: as in the paper

    Raises:
        ScenarioError: a gain is negative or not finite, or another word than "auto".
    """

    def __init__(self, model: Model, config: PaperWrenchControllerConfig | None = None):
        super().__init__(model, config or PaperWrenchControllerConfig(), _check, _papers)


def _papers(load: RigidLoad, **gains: Any) -> dict[str, Any]:
    return gains | {"angular_velocity_gain": -gains["angular_velocity_gain"]}


@dataclass(kw_only=True)
class GeometricPdConfig(StrictFields):
    """The gains but for those of the integrals."""

    position_gain: float | str = AUTO  # N/m, K_p; auto: by mass and cables
    velocity_gain: float | str = AUTO  # N s/m, K_v; auto: by mass and cables
    orientation_gain: float | str = AUTO  # N m, K_R; auto: by inertia and cables
    angular_velocity_gain: float | str = AUTO  # N m s, K_omega; auto: by inertia and cables


class GeometricPd(_WrenchPid):
    """Geometric PD that carries the weight, without integrals and feedforward.

    Gains that are "auto" follow from the model's mass, inertia, cables and gravity, by
    `mechanics.tuning.load_gains`: for its load the paper's (Table I), but for more damping of the
    position and a quarter of the torques.

    .. pydrake_system::

        name: GeometricPd
        input_ports:
        - measured_load_state
        - reference
        - wind_estimate
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wind_estimate` (3, m/s) in W, from
    which the load's drag follows; `wrench` (6) = [torque (N m); force (N)] at the centre of mass
    and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
    (rad), e_p (m), e_ω (rad/s), e_v (m/s)], e_R and e_ω in L, the others in W.

    Parameters, the fields of `GeometricPdConfig`:
        position_gain: N/m, K_p; auto: by mass and cables
        velocity_gain: N s/m, K_v; auto: by mass and cables
        orientation_gain: N m, K_R; auto: by inertia and cables
        angular_velocity_gain: N m s, K_omega; auto: by inertia and cables

    Raises:
        ScenarioError: a gain is negative or not finite, or another word than "auto".
    """

    def __init__(self, model: Model, config: GeometricPdConfig | None = None):
        super().__init__(model, config or GeometricPdConfig(), _check, _without_integrals)


def _without_integrals(load: RigidLoad, **gains: Any) -> dict[str, Any]:
    names = ("position_integral_gain", "orientation_integral_gain", "feedforward")
    return gains | dict.fromkeys(names, 0.0)


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
        - wind_estimate
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22), SI, in W; `wind_estimate` (3, m/s) in W, from
    which the load's drag follows; `wrench` (6) = [torque (N m); force (N)] at the centre of mass
    and `wrench_rate` (6), in W; `tracking_error` (12) = [e_R
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
        super().__init__(model, config or TunedWrenchControllerConfig(), _check_tuned, _tuned)


def _tuned(load: RigidLoad, **poles: Any) -> dict[str, Any]:
    position, velocity, integral = pid_gains(
        poles["position_frequency"], poles["position_damping"], poles["position_integral_rate"]
    )
    gains = {
        "feedforward": poles["feedforward"],
        "position_gain": load.mass * position,
        "velocity_gain": load.mass * velocity - load.drag,
        "position_integral_gain": load.mass * integral,
    }
    position, velocity, integral = pid_gains(
        poles["orientation_frequency"],
        poles["orientation_damping"],
        poles["orientation_integral_rate"],
    )
    return gains | {
        "orientation_gain": load.inertia * position,
        "angular_velocity_gain": load.inertia * velocity - load.angular_drag * np.eye(3),
        "orientation_integral_gain": load.inertia * integral,
    }


def _check_tuned(model: Model, config: TunedWrenchControllerConfig) -> None:
    _check(model, config)
    require_positive(
        _BOX,
        position_frequency=config.position_frequency,
        orientation_frequency=config.orientation_frequency,
    )
    gains = _tuned(model.load, **asdict(config))
    for name, damping in (
        ("position", gains["velocity_gain"]),
        ("orientation", np.linalg.eigvalsh(gains["angular_velocity_gain"])[0]),
    ):
        require(
            damping >= 0,
            f"{_BOX}.{name}_damping",
            getattr(config, f"{name}_damping"),
            "the load's drag alone damps more; give more damping or a higher frequency",
        )


# The blocks that the box can be, the default first.
VARIANTS = (WrenchController, PaperWrenchController, GeometricPd, TunedWrenchController)
