"""Box "Load Wrench Controller" of the figure."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.sample_and_hold import tell_of_scalar_last
from drake_nonstop.mechanics import wrench
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import SAMPLE_TIME, WRENCH_SIZE, TrackingError
from drake_nonstop.mechanics.tuning import load_gains, pid_gains
from drake_nonstop.model.block import (
    AUTO,
    LOAD,
    Block,
    BlockParameters,
    rigid_load,
    with_this_sample,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import number
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    positive,
    require,
    require_non_negative,
    require_ranges,
)

_BOX = "wrench_controller"
_HIGHER_RATES = "reference_higher_rates"
_FOLLOWED = ("load_mass", "load_inertia", "cable_length", "gravity")  # by gains that are `AUTO`


class _WrenchPid(Block):
    """PID on the load's pose with feedforward, and the exact rate of its wrench.

    A variant is its `law`. The integrals are continuous, or discrete where the model has a control
    period.
    """

    reads = ("measured_load_state", "reference", "wind_estimate", _HIGHER_RATES, SAMPLE_TIME)
    optional_inputs = (_HIGHER_RATES,)
    makes = ("wrench", "wrench_rate", "tracking_error")
    where: ClassVar = {SAMPLE_TIME: "the model has a control period"}
    system = LOAD
    of_model = ("control_period",)
    is_sampled = True
    is_joint = True  # a second function for what does not read the wind would take longer

    @staticmethod
    def equations(
        integrals: NDArray,
        state: NDArray,
        reference: NDArray,
        wind: NDArray,
        higher_rates: NDArray,
        *sample_time: NDArray,
        law: Callable[..., dict[str, Any]],
        control_period: float,
        **numbers: NDArray,
    ) -> tuple[NDArray, ...]:
        load = rigid_load(**{name: numbers.pop(name) for name in LOAD})
        numbers.pop("cable_length", None)
        error = wrench.tracking_error(state, reference)
        rate = np.concatenate(TrackingError.view(error)[:2])  # e_R and e_p
        rate, integrals = with_this_sample(integrals, rate, sample_time, control_period)
        gains = law(load, **numbers)
        along = reference, integrals, wind, higher_rates
        made = wrench.wrench_and_rate(load, state, *along, **gains)
        return (rate, *made, error)

    @staticmethod
    def law(load: RigidLoad, **gains: Any) -> dict[str, Any]:
        """The gains of `mechanics.wrench.wrench_and_rate` and its `feedforward`.

        Of the load and, by name, the fields of the config, numbers or symbols.
        """
        return gains

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_ranges(_BOX, config)

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return super().constants(model, config) | {"law": self.law}

    def state(self, model: Model) -> NDArray:
        return np.zeros(6)

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        gains = cls.law(model.load, **_numbers(model, config))
        return any(np.any(gains[f"{part}_integral_gain"]) for part in ("position", "orientation"))

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        if AUTO not in asdict(type(config)()).values():
            return super().block_parameters(model, config)
        numbers, system = _numbers(model, config), (*LOAD, "cable_length")
        return BlockParameters(model, system, config=SimpleNamespace(**numbers), own=numbers)

    def tell_start(self, context: Context) -> None:
        if self.model.control_period == 0:  # without the hold, which warns
            tell_of_scalar_last(self, context)

    @property
    def gains(self) -> dict[str, Any]:
        """Value of `law` for the model's load."""
        return self.law(self.model.load, **_numbers(self.model, self.config))

    def describe_response(self) -> dict[str, Any]:
        return self.gains


def _numbers(model: Model, config: Any) -> dict[str, Any]:
    """The fields of a config, with numbers for those that are `AUTO`.

    Of the load's principal moments of inertia the least counts: about another axis it turns slower.
    """
    mass, inertia, length, gravity = map(model.number, _FOLLOWED)
    inertia = np.asarray(inertia)
    _, axes = np.linalg.eigh([[number(entry) for entry in row] for row in inertia])
    moment = axes[:, 0] @ inertia @ axes[:, 0]
    following = load_gains(mass, moment, length, gravity)
    return {k: following[k] if v == AUTO else v for k, v in asdict(config).items()}


def _check_gain(field: str, value: Any) -> None:
    if isinstance(value, str):
        require(value == AUTO, field, value, f'give a number, without quotes, or "{AUTO}"')
    else:
        require_non_negative(field, value)


def _gain() -> Any:
    """A field of a gain that follows from load and cables where it is not given."""
    return checked(AUTO, _check_gain)


@dataclass(kw_only=True)
class _Gains(StrictFields):
    position_gain: float | str = _gain()  # N/m, K_p; auto: by mass and cables
    velocity_gain: float | str = _gain()  # N s/m, K_v; auto: by mass and cables
    position_integral_gain: float | str = _gain()  # N/(m s), K_i; auto: 0
    orientation_gain: float | str = _gain()  # N m, K_R; auto: by inertia and cables
    angular_velocity_gain: float | str = _gain()  # N m s, K_omega; auto: by inertia and cables
    orientation_integral_gain: float | str = _gain()  # N m/s, K_iR; auto: 0


@dataclass(kw_only=True)
class WrenchControllerConfig(_Gains):
    """The gains, and the feedforward that the paper's equations leave out."""

    # weight of the reference's own wrench; 0: as in the paper
    feedforward: float = non_negative(1.0)


class WrenchController(_WrenchPid):
    """PID with feedforward: equations 14-15 with the sign of e_ω that damps.

    Gains that are "auto" follow from the model's mass, inertia, cables and gravity, by
    `mechanics.tuning.load_gains`: for the paper's load they are the paper's gains (Table I), with
    more damping of the position and a quarter of the torques. The integrals of e_R and e_p (6) are
    the state if one of their gains is not zero. The load's drag is that in the wind of
    `wind_estimate`.

    Raises:
        ScenarioError: a gain is negative or not finite, or another word than "auto".
    """


@dataclass(kw_only=True)
class PaperWrenchControllerConfig(_Gains):
    """The gains."""

    # weight of the reference's own wrench; 0: as in the paper
    feedforward: float = non_negative(0.0)


class PaperWrenchController(_WrenchPid):
    """The PID as printed in the paper: with e_ω = RᵀR_d ω_d − ω, −K_ω is anti-damping.

    A free load under this wrench would tumble. On cables to carriers that follow the desired
    pose it has little effect: they hold the load upright by themselves. The `tracking_error` has
    the e_ω of the other controllers. Gains, state and drag are as of `WrenchController`.

    Raises:
        ScenarioError: a gain is negative or not finite, or another word than "auto".
    """

    @staticmethod
    def law(load: RigidLoad, **gains: Any) -> dict[str, Any]:
        return gains | {"angular_velocity_gain": -gains["angular_velocity_gain"]}


@dataclass(kw_only=True)
class TunedWrenchControllerConfig(StrictFields):
    """The desired poles of the error, exact on cables without dynamics."""

    position_frequency: float = positive(2.0)  # rad/s, natural frequency
    position_damping: float = non_negative(0.8)  # damping ratio
    position_integral_rate: float = non_negative(0.0)  # rad/s, of the pole that the integral adds
    orientation_frequency: float = positive(5.0)  # rad/s, natural frequency
    orientation_damping: float = non_negative(0.8)  # damping ratio
    # rad/s, of the pole that the integral adds
    orientation_integral_rate: float = non_negative(0.0)
    feedforward: float = non_negative(1.0)  # weight of the reference's own wrench


class TunedWrenchController(_WrenchPid):
    """PID with feedforward whose gains follow from natural frequencies, mass and inertia.

    Gains from `mechanics.tuning.pid_gains`; those of the orientation are matrices proportional
    to the inertia, so that roll, pitch and yaw respond alike. The damping of the load's drag is
    taken into account: a drag that alone damps more makes a rate's gain negative. State and drag
    are as of `WrenchController`.

    Raises:
        ScenarioError: a frequency is not positive, or another parameter is negative.
    """

    @staticmethod
    def law(load: RigidLoad, **poles: Any) -> dict[str, Any]:
        def gains_of(motion: str) -> tuple[Any, Any, Any]:
            names = ("frequency", "damping", "integral_rate")
            return pid_gains(*(poles[f"{motion}_{name}"] for name in names))

        position, velocity, integral = gains_of("position")
        turn, turn_rate, turn_integral = gains_of("orientation")
        return {
            "feedforward": poles["feedforward"],
            "position_gain": load.mass * position,
            "velocity_gain": load.mass * velocity - load.drag,
            "position_integral_gain": load.mass * integral,
            "orientation_gain": load.inertia * turn,
            "angular_velocity_gain": load.inertia * turn_rate - load.angular_drag * np.eye(3),
            "orientation_integral_gain": load.inertia * turn_integral,
        }


@dataclass(kw_only=True)
class WrenchRateConfig(StrictFields):
    """The filter."""

    time_constant: float = positive(0.05)  # s, by which the rate lags


class WrenchRate(Block):
    """The rate of a wrench whose controller does not make one: (w − x)/T with ẋ = (w − x)/T.

    It is in a loop where no block makes `wrench_rate`. Of a controller of sampled inputs it is a
    filtered difference of samples. It lags by T, zero at the start, and has of noise what the
    wrench has over T; a controller that makes a `wrench_rate` of its equations has neither.
    """

    reads = ("wrench",)
    makes = ("wrench_rate",)
    is_sampled = True

    @staticmethod
    def equations(
        state: NDArray, wrench: NDArray, *, time_constant: NDArray
    ) -> tuple[NDArray, NDArray]:
        rate = (wrench - state) / time_constant
        return rate, rate

    def state(self, model: Model) -> NDArray:
        return np.zeros(WRENCH_SIZE)

    @staticmethod
    def start(state: NDArray, wrench: NDArray, **numbers: NDArray) -> NDArray:
        return wrench


VARIANTS = (WrenchController, PaperWrenchController, TunedWrenchController)
