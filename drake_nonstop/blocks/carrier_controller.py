"""The controller half of box "Carrier Controller + Dynamics"."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.fixed_wing_controller import (
    FixedWingController,
    FixedWingControllerConfig,
)
from drake_nonstop.mechanics.carrier import loaded_pid_forces, pid_forces
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.block import Block
from drake_nonstop.model.descriptions import CarrierControl
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    non_negative,
    positive,
    require_ranges,
)

_BOX = "carrier_controller"
_ACCELERATION = "carrier_reference_acceleration"


class _PositionPid(Block):
    """PID of every carrier; where it reads the references' acceleration a_d, m_c a_d besides."""

    reads: ClassVar[tuple[str, ...]] = ("carrier_reference", "carrier_state")
    makes = ("carrier_forces",)

    @staticmethod
    def equations(
        integral: NDArray,
        reference: NDArray,
        state: NDArray,
        *acceleration: NDArray,
        law: Callable[..., dict[str, Any]],
        **numbers: NDArray,
    ) -> tuple[NDArray, NDArray]:
        error = reference - state
        forces = pid_forces(error, integral, **law(**numbers))
        for desired in acceleration:
            forces = forces + numbers["carrier_mass"] * desired
        return error[: len(integral)], forces

    @staticmethod
    def law(*, carrier_mass: Any = None, **gains: Any) -> dict[str, Any]:
        """The gains position_gain (N/m), velocity_gain (N s/m) and integral_gain (N/(m s)).

        Of the fields of the config, numbers or symbols, and of the carriers' mass.
        """
        return gains

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_ranges(_BOX, config)

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return {"law": self.law}

    def state(self, model: Model) -> NDArray:
        return np.zeros(3 * model.n)

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        return bool(cls.gains_of(model, config)["integral_gain"] != 0)

    @classmethod
    def gains_of(cls, model: Model, config: Any) -> dict[str, Any]:
        return cls.law(**{name: model.number(name) for name in cls.system}, **asdict(config))

    @property
    def gains(self) -> dict[str, Any]:
        """The gains that it was made with."""
        return self.gains_of(self.model, self.config)

    def describe_response(self) -> CarrierControl:
        stiffness = getattr(self.config, "position_gain", 0.0) or math.inf
        has_feedforward = _ACCELERATION in self.reads
        return CarrierControl(**self.gains, has_feedforward=has_feedforward, stiffness=stiffness)


class _WithFeedforward(_PositionPid):
    reads = (*_PositionPid.reads, _ACCELERATION)
    system = ("carrier_mass",)


class _Tuned(_PositionPid):
    """Gains that follow from natural frequency, damping and mass, see `mechanics.tuning`."""

    system = ("carrier_mass",)

    @staticmethod
    def law(*, carrier_mass: Any = None, **poles: Any) -> dict[str, Any]:
        names = ("position_gain", "velocity_gain", "integral_gain")
        gains = pid_gains(poles["frequency"], poles["damping"], poles["integral_rate"])
        return {name: carrier_mass * gain for name, gain in zip(names, gains, strict=True)}


@dataclass(kw_only=True)
class _Gains(StrictFields):
    position_gain: float = non_negative(1000.0)  # N/m
    velocity_gain: float = non_negative(10.0)  # N s/m; the paper's 1.5 is a damping ratio of 0.075
    integral_gain: float = non_negative(0.0)  # N/(m s)


@dataclass(kw_only=True)
class CarrierPidConfig(_Gains):
    """Gains on each axis; the paper gives 1000 and 1.5 and no integral gain."""


class CarrierPid(_PositionPid):
    """PID on the position of every carrier, as in the paper.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p).

    The integrals of the position errors (3n, m s) are the state, where their gain is not zero.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """


@dataclass(kw_only=True)
class FeedforwardCarrierPidConfig(_Gains):
    """Gains on each axis."""


class FeedforwardCarrierPid(_WithFeedforward):
    """`CarrierPid` with the references' acceleration as feedforward, + m_c a_d.

    A PID without it lags behind its circle by m_c a_d/K_p.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """


@dataclass(kw_only=True)
class _Poles(StrictFields):
    frequency: float = positive(100.0)  # rad/s, natural frequency of a carrier about its reference
    damping: float = non_negative(0.5)  # damping ratio
    # rad/s, of the pole that an integral adds; 0: no integral
    integral_rate: float = non_negative(0.0)


@dataclass(kw_only=True)
class TunedCarrierPidConfig(_Poles):
    """The desired poles of every carrier; the default is that of `CarrierPid`'s gains."""


class TunedCarrierPid(_Tuned):
    """`CarrierPid` whose gains follow from a natural frequency and the carriers' mass.

    They are those of `mechanics.tuning.pid_gains`.

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """


@dataclass(kw_only=True)
class TunedFeedforwardCarrierPidConfig(_Poles):
    """The desired poles of every carrier."""


class TunedFeedforwardCarrierPid(_Tuned, _WithFeedforward):
    """`FeedforwardCarrierPid` whose gains follow from a natural frequency and the carriers' mass.

    They are those of `mechanics.tuning.pid_gains`.

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """


@dataclass(kw_only=True)
class LoadedCarrierPidConfig(StrictFields):
    """Gains on each axis."""

    position_gain: float = non_negative(1000.0)  # N/m
    velocity_gain: float = non_negative(10.0)  # N s/m


class LoadedCarrierPid(Block):
    """u = K_p (p_d − p) + K_d (v_d − v) + m_c g e₃ + f_d, for every carrier.

    Weight and desired cable force are feedforward; the integral of the wrench controller corrects
    for errors in the model of the load.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    reads = ("carrier_reference", "carrier_state", "desired_cable_forces")
    makes = ("carrier_forces",)
    system = ("carrier_mass", "gravity")

    @staticmethod
    def equations(
        *values: NDArray, carrier_mass: NDArray, gravity: NDArray, **gains: NDArray
    ) -> NDArray:
        return loaded_pid_forces(*values, mass=carrier_mass, gravity=gravity, **gains)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_ranges(_BOX, config)

    @property
    def gains(self) -> dict[str, Any]:
        """The gains that it was made with."""
        return asdict(self.config) | {"integral_gain": 0.0}

    def describe_response(self) -> CarrierControl:
        return CarrierControl(**self.gains, bears_cables=True)


VARIANTS = (
    FeedforwardCarrierPid,
    CarrierPid,
    TunedCarrierPid,
    TunedFeedforwardCarrierPid,
    LoadedCarrierPid,
    FixedWingController,
)

__all__ = ["FeedforwardCarrierPid", "FeedforwardCarrierPidConfig", "CarrierPid", "CarrierPidConfig"]
__all__ += ["TunedCarrierPid", "TunedCarrierPidConfig"]
__all__ += ["TunedFeedforwardCarrierPid", "TunedFeedforwardCarrierPidConfig"]
__all__ += ["LoadedCarrierPid", "LoadedCarrierPidConfig"]
__all__ += ["FixedWingController", "FixedWingControllerConfig"]
