"""The controller half of box "Carrier Controller + Dynamics"."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.fixed_wing_controller import (
    FixedWingController,
    FixedWingControllerConfig,  # noqa: F401
)
from drake_nonstop.mechanics.carrier import pid_forces
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.block import Block
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    non_negative,
    positive,
    require_ranges,
)

_BOX = "carrier_controller"
_ACCELERATION = "carrier_reference_acceleration"


@dataclass(kw_only=True)
class _Gains(StrictFields):  # no config may be below another: YAML could not tell them
    position_gain: float = non_negative(1000.0)  # N/m
    velocity_gain: float = non_negative(10.0)  # N s/m; the paper's 1.5 is a damping ratio of 0.075
    integral_gain: float = non_negative(0.0)  # N/(m s)


@dataclass(kw_only=True)
class CarrierPidConfig(_Gains):
    """Gains on each axis; the paper gives 1000 and 1.5 and no integral gain."""


class CarrierPid(Block):
    """PID on the position of every carrier, as in the paper.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p).

    The integrals of the position errors (3n, m s) are the state, where their gain is not zero.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

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


@dataclass(kw_only=True)
class FeedforwardCarrierPidConfig(_Gains):
    """Gains on each axis."""


class FeedforwardCarrierPid(CarrierPid):
    """`CarrierPid` with the references' acceleration as feedforward, + m_c a_d.

    A PID without it lags behind its circle by m_c a_d/K_p.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    reads = (*CarrierPid.reads, _ACCELERATION)
    system = ("carrier_mass",)


@dataclass(kw_only=True)
class TunedFeedforwardCarrierPidConfig(StrictFields):
    """The desired poles of every carrier; the default is that of the other gains."""

    frequency: float = positive(100.0)  # rad/s, natural frequency of a carrier about its reference
    damping: float = non_negative(0.5)  # damping ratio
    # rad/s, of the pole that an integral adds; 0: no integral
    integral_rate: float = non_negative(0.0)


class TunedFeedforwardCarrierPid(FeedforwardCarrierPid):
    """`FeedforwardCarrierPid` whose gains follow from a natural frequency and the carriers' mass.

    They are those of `mechanics.tuning.pid_gains`.

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """

    @staticmethod
    def law(*, carrier_mass: Any = None, **poles: Any) -> dict[str, Any]:
        names = ("position_gain", "velocity_gain", "integral_gain")
        gains = pid_gains(poles["frequency"], poles["damping"], poles["integral_rate"])
        return {name: carrier_mass * gain for name, gain in zip(names, gains, strict=True)}


VARIANTS = (FeedforwardCarrierPid, CarrierPid, TunedFeedforwardCarrierPid, FixedWingController)
