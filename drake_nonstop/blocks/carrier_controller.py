"""The controller half of box "Carrier Controller + Dynamics"."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.fixed_wing_controller import (
    FixedWingController,
)
from drake_nonstop.mechanics.carrier import loaded_pid_forces, pid_forces
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.block_parameters import BlockParameters, Rules
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import TracedBlock, TracedDynamics
from drake_nonstop.validation import StrictFields, require_non_negative, require_positive

_BOX = "carrier_controller"
_ACCELERATION = "carrier_reference_acceleration"


class _PositionPid(TracedDynamics):
    """u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p), for every carrier.

    The integrals are the state, where their gain is not zero.

    Args:
        model: the number of carriers.
        config: the block's.
        law: how the gains follow from its fields, and whether there is feedforward m_c a_d.

    Attributes:
        gains: those that it was built with, by name: position_gain, velocity_gain, integral_gain.
        has_feedforward: whether there is feedforward m_c a_d.
    """

    def __init__(self, model: Model, config: Any, law: "_Law"):
        law.check(model, config)
        size, has_integral = 3 * model.n, law.has_integral(model, config)

        def forces(*values: NDArray, **numbers: NDArray) -> Any:
            integral, reference, state, *acceleration = (
                values if has_integral else (np.zeros(size), *values)
            )
            error = reference - state
            total = pid_forces(error, integral, **law.gains(**numbers))
            if law.has_feedforward:
                total = total + numbers["carrier_mass"] * acceleration[0]
            return (error[:size], total) if has_integral else total

        inputs = {"carrier_reference": 2 * size, "carrier_state": 2 * size}
        super().__init__(
            forces,
            inputs=inputs | ({_ACCELERATION: size} if law.has_feedforward else {}),
            outputs={"carrier_forces": size},
            state=np.zeros(size) if has_integral else None,
            parameters=BlockParameters(
                model,
                law.of_system,
                config=config,
                own=asdict(config),
                rules=Rules(check=law.check, structure=law.has_integral),
            ),
            key=("pid", model.n, has_integral, law.has_feedforward, law.gains.__qualname__),
        )
        self.gains, self.has_feedforward = law.gains_of(model, config), law.has_feedforward


@dataclass(frozen=True)
class _Law:
    """How the gains of a PID follow from the fields of its config.

    Attributes:
        gains: takes the fields by name, and the carriers' mass where `of_system` names it, and
            returns position_gain (N/m), velocity_gain (N s/m) and integral_gain (N/(m s)).
        check: raises ScenarioError for a config that cannot be used.
        of_system: the fields of the system.
        has_feedforward: whether the forces have the carriers' mass times the references'
            acceleration in them; `of_system` then names the mass.
    """

    gains: Callable[..., dict[str, Any]]
    check: Callable[[Model, Any], None]
    of_system: tuple[str, ...] = ()
    has_feedforward: bool = False

    def has_integral(self, model: Model, config: Any) -> bool:
        """Whether the integral has a gain."""
        return bool(self.gains_of(model, config)["integral_gain"] != 0)

    def gains_of(self, model: Model, config: Any) -> dict[str, Any]:
        """The gains of a config."""
        values = {name: model.number(name) for name in self.of_system} | asdict(config)
        return self.gains(**values)


def _check(model: Model, config: Any) -> None:
    require_non_negative(_BOX, **asdict(config))


def _as_given(**gains: Any) -> dict[str, Any]:
    return gains


def _as_given_beside_mass(*, carrier_mass: Any, **gains: Any) -> dict[str, Any]:
    return gains


_GIVEN = _Law(_as_given, _check)
_WITH_FEEDFORWARD = _Law(_as_given_beside_mass, _check, ("carrier_mass",), has_feedforward=True)


@dataclass(kw_only=True)
class _Gains(StrictFields):
    position_gain: float = 1000.0  # N/m
    velocity_gain: float = 10.0  # N s/m; the paper's 1.5 is a damping ratio of 0.075
    integral_gain: float = 0.0  # N/(m s)


@dataclass(kw_only=True)
class CarrierPidConfig(_Gains):
    """Gains on each axis; the paper gives 1000 and 1.5 and no integral gain."""


class CarrierPid(_PositionPid):
    """PID on the position of every carrier, as in the paper.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p).

    .. pydrake_system::

        name: CarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)], in W;
    `carrier_forces` (3n) in N, in W. The integrals of the position errors (3n, m s) are the
    state, where their gain is not zero.

    Parameters, the fields of `CarrierPidConfig`:
        position_gain: N/m
        velocity_gain: N s/m; the paper's 1.5 is a damping ratio of 0.075
        integral_gain: N/(m s)

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: CarrierPidConfig | None = None):
        super().__init__(model, config or CarrierPidConfig(), _GIVEN)


@dataclass(kw_only=True)
class FeedforwardCarrierPidConfig(_Gains):
    """Gains on each axis."""


class FeedforwardCarrierPid(_PositionPid):
    """PID with the references' acceleration as feedforward.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p) + m_c a_d. A PID without it lags behind its
    circle by m_c a_d/K_p.

    .. pydrake_system::

        name: FeedforwardCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - carrier_reference_acceleration
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)] and
    `carrier_reference_acceleration` (3n, m/s²), in W; `carrier_forces` (3n) in N, in W. The
    integrals of the position errors (3n, m s) are the state, where their gain is not zero.

    Parameters, the fields of `FeedforwardCarrierPidConfig`:
        position_gain: N/m
        velocity_gain: N s/m; the paper's 1.5 is a damping ratio of 0.075
        integral_gain: N/(m s)

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: FeedforwardCarrierPidConfig | None = None):
        super().__init__(model, config or FeedforwardCarrierPidConfig(), _WITH_FEEDFORWARD)


def _check_tuned(model: Model, config: Any) -> None:
    _check(model, config)
    require_positive(_BOX, frequency=config.frequency)


def _tuned(
    *, carrier_mass: Any, frequency: Any, damping: Any, integral_rate: Any
) -> dict[str, Any]:
    names = ("position_gain", "velocity_gain", "integral_gain")
    poles = pid_gains(frequency, damping, integral_rate)
    return {name: carrier_mass * gain for name, gain in zip(names, poles, strict=True)}


_TUNED = _Law(_tuned, _check_tuned, ("carrier_mass",))
_TUNED_WITH_FEEDFORWARD = replace(_TUNED, has_feedforward=True)


@dataclass(kw_only=True)
class _Poles(StrictFields):
    frequency: float = 100.0  # rad/s, natural frequency of a carrier about its reference
    damping: float = 0.5  # damping ratio
    integral_rate: float = 0.0  # rad/s, of the pole that an integral adds; 0: no integral


@dataclass(kw_only=True)
class TunedCarrierPidConfig(_Poles):
    """The desired poles of every carrier; the default is that of `CarrierPid`'s gains."""


class TunedCarrierPid(_PositionPid):
    """PID whose gains follow from a natural frequency and the carriers' mass.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p), gains from `mechanics.tuning.pid_gains`.

    .. pydrake_system::

        name: TunedCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)], in W;
    `carrier_forces` (3n) in N, in W. The integrals of the position errors (3n, m s) are the
    state, where their gain is not zero.

    Parameters, the fields of `TunedCarrierPidConfig`:
        frequency: rad/s, natural frequency of a carrier about its reference
        damping: damping ratio
        integral_rate: rad/s, of the pole that an integral adds; 0: no integral

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """

    def __init__(self, model: Model, config: TunedCarrierPidConfig | None = None):
        super().__init__(model, config or TunedCarrierPidConfig(), _TUNED)


@dataclass(kw_only=True)
class TunedFeedforwardCarrierPidConfig(_Poles):
    """The desired poles of every carrier."""


class TunedFeedforwardCarrierPid(_PositionPid):
    """`FeedforwardCarrierPid` whose gains follow from a natural frequency and the carriers' mass.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p) + m_c a_d, gains from
    `mechanics.tuning.pid_gains`.

    .. pydrake_system::

        name: TunedFeedforwardCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - carrier_reference_acceleration
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)] and
    `carrier_reference_acceleration` (3n, m/s²), in W; `carrier_forces` (3n) in N, in W. The
    integrals of the position errors (3n, m s) are the state, where their gain is not zero.

    Parameters, the fields of `TunedFeedforwardCarrierPidConfig`:
        frequency: rad/s, natural frequency of a carrier about its reference
        damping: damping ratio
        integral_rate: rad/s, of the pole that an integral adds; 0: no integral

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """

    def __init__(self, model: Model, config: TunedFeedforwardCarrierPidConfig | None = None):
        config = config or TunedFeedforwardCarrierPidConfig()
        super().__init__(model, config, _TUNED_WITH_FEEDFORWARD)


@dataclass(kw_only=True)
class LoadedCarrierPidConfig(StrictFields):
    """Gains on each axis."""

    position_gain: float = 1000.0  # N/m
    velocity_gain: float = 10.0  # N s/m


class LoadedCarrierPid(TracedBlock):
    """u = K_p (p_d − p) + K_d (v_d − v) + m_c g e₃ + f_d, for every carrier.

    Weight and desired cable force are feedforward; the integral of the wrench controller corrects
    for errors in the model of the load.

    .. pydrake_system::

        name: LoadedCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - desired_cable_forces
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)], in W;
    `desired_cable_forces` and `carrier_forces` (3n) in N, in W.

    Parameters, the fields of `LoadedCarrierPidConfig`:
        position_gain: N/m
        velocity_gain: N s/m

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: LoadedCarrierPidConfig | None = None):
        config = config or LoadedCarrierPidConfig()
        _check(model, config)
        self.gains = asdict(config) | {"integral_gain": 0.0}
        n = model.n
        super().__init__(
            lambda *values, carrier_mass, gravity, **gains: loaded_pid_forces(
                *values, mass=carrier_mass, gravity=gravity, **gains
            ),
            inputs={
                "carrier_reference": 6 * n,
                "carrier_state": 6 * n,
                "desired_cable_forces": 3 * n,
            },
            outputs={"carrier_forces": 3 * n},
            parameters=BlockParameters(
                model,
                ("carrier_mass", "gravity"),
                config=config,
                own=asdict(config),
                rules=Rules(check=_check),
            ),
            key=("loaded pid", n),
        )


# The blocks that the box can be, the default first.
VARIANTS = (
    FeedforwardCarrierPid,
    CarrierPid,
    TunedCarrierPid,
    TunedFeedforwardCarrierPid,
    LoadedCarrierPid,
    FixedWingController,
)
