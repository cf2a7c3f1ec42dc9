"""The controller half of box "Carrier Controller + Dynamics"."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain

from drake_nonstop.mechanics.carrier import carrier_acceleration, loaded_pid_forces, pid_forces
from drake_nonstop.mechanics.internal_force import internal_force_acceleration
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, PARAMETERS_SIZE, Pose
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import DiagramBlock
from drake_nonstop.systems.linear_block import LinearBlock
from drake_nonstop.systems.traced_block import Equations, TracedBlock
from drake_nonstop.systems.wiring import input_names
from drake_nonstop.validation import StrictFields, require_non_negative, require_positive

_BOX = "carrier_controller"


class _PositionPid(DiagramBlock):
    """u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p), for every carrier.

    The integrals are the state, where their gain is not zero. Drake's own systems evaluate the
    law, in half the time of a callback; `equations` are the same, for a fused plant.

    Args:
        model: the number of carriers.
        gains: position_gain (N/m), velocity_gain (N s/m) and integral_gain (N/(m s)).
        feedforward: a block with one output, forces (3n) to add; its input ports are the
            controller's, too.
    """

    def __init__(
        self, model: Model, gains: dict[str, float], feedforward: TracedBlock | None = None
    ):
        super().__init__()
        size = 3 * model.n
        builder = DiagramBuilder()
        minus = builder.AddNamedSystem("minus", Gain(-1.0, 2 * size))
        error = builder.AddNamedSystem("error", Adder(2, 2 * size))
        pid = builder.AddNamedSystem("pid", _pid(size, gains))
        reference_input, negated_state_input = map(error.get_input_port, range(2))
        self.equations = _equations(size, pid.equations, feedforward)
        builder.Connect(minus.get_output_port(), negated_state_input)
        builder.Connect(error.get_output_port(), pid.get_input_port())
        builder.ExportInput(reference_input, "carrier_reference")
        builder.ExportInput(minus.get_input_port(), "carrier_state")
        forces = pid.get_output_port()
        if feedforward is not None:
            builder.AddNamedSystem("feedforward", feedforward)
            for name in input_names(feedforward):
                builder.ExportInput(feedforward.GetInputPort(name), name)
            total = builder.AddNamedSystem("total", Adder(2, size))
            for i, addend in enumerate((forces, feedforward.get_output_port())):
                builder.Connect(addend, total.get_input_port(i))
            forces = total.get_output_port()
        builder.ExportOutput(forces, "carrier_forces")
        builder.BuildInto(self)


def _pid(size: int, gains: dict[str, float]) -> LinearBlock:
    """The forces (`size`, 3n) of the error, and its integral as the state if that has a gain."""
    inputs, outputs = {"error": 2 * size}, {"forces": size}
    if gains["integral_gain"] == 0:
        return LinearBlock(
            lambda error: pid_forces(error, np.zeros(size), **gains), inputs=inputs, outputs=outputs
        )
    return LinearBlock(
        lambda integral, error: (np.split(error, 2)[0], pid_forces(error, integral, **gains)),
        inputs=inputs,
        outputs=outputs,
        state_size=size,
    )


def _equations(size: int, pid: Equations, feedforward: TracedBlock | None) -> Equations:
    """Those of `_PositionPid`, whose `size` is 3n."""
    inputs = {"carrier_reference": 2 * size, "carrier_state": 2 * size}
    added = feedforward.equations if feedforward is not None else None
    if added is not None:
        inputs |= added.inputs
    has_integral = len(pid.initial_state) > 0

    def function(*values: NDArray) -> tuple[NDArray, ...]:
        integral, others = ([values[0]], values[1:]) if has_integral else ([], values)
        reference, state, *further = others
        results = pid.function(*integral, reference - state)
        *rate, forces = results if has_integral else (results,)
        if added is not None:
            forces = forces + added.function(*further)
        return (*rate, forces)

    return Equations(function, inputs, {"carrier_forces": size}, pid.initial_state)


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
        gains = asdict(config or CarrierPidConfig())
        require_non_negative(_BOX, **gains)
        super().__init__(model, gains)


class _FeedforwardPid(_PositionPid):
    """A `_PositionPid` with the forces m_c a_d that the references' acceleration needs.

    Args:
        model: carriers, cables and pattern.
        gains: as of `_PositionPid`.
    """

    def __init__(self, model: Model, gains: dict[str, float]):
        n = model.n

        def inertial_forces(
            reference: NDArray,
            cable_forces: NDArray,
            rates: NDArray,
            internal_force: NDArray,
            parameters: NDArray,
        ) -> NDArray:
            second_rates = internal_force_acceleration(parameters, internal_force)
            R_WL = rotation_matrix(Pose.view(reference).quaternion)
            acceleration = carrier_acceleration(
                reference,
                cable_forces.reshape(n, 3),
                rates.reshape(n, 3),
                (model.pattern.basis @ second_rates).reshape(n, 3) @ R_WL.T,
                attachments=model.attachments,
                rest_length=model.cable_length,
                compliance=model.cable_compliance,
            )
            return model.carrier_mass * acceleration.reshape(3 * n)

        sizes = {
            "reference": LOAD_REFERENCE_SIZE,
            "desired_cable_forces": 3 * n,
            "desired_cable_force_rates": 3 * n,
            "internal_force": 2 * model.m,
            "parameters": PARAMETERS_SIZE,
        }
        feedforward = TracedBlock(inertial_forces, inputs=sizes, outputs={"inertial_forces": 3 * n})
        super().__init__(model, gains, feedforward)


@dataclass(kw_only=True)
class FeedforwardCarrierPidConfig(_Gains):
    """Gains on each axis."""


class FeedforwardCarrierPid(_FeedforwardPid):
    """PID with the acceleration of a carrier on its orbit as feedforward.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p) + m_c a_d. The references' acceleration a_d
    is that of the internal forces' rotation, exact where the wrench on the load changes slowly:
    f̈_d = R N₀ λ̈. A PID without it lags behind its circle by m_c a_d/K_p.

    .. pydrake_system::

        name: FeedforwardCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force
        - parameters
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)],
    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s), all in W;
    `internal_force` (2m) = [λ (N); λ̇ (N/s)]; `parameters` (2) = [ξ (rad/s), A (N)];
    `carrier_forces` (3n) in N, in W. The integrals of the position errors (3n, m s) are the
    state, where their gain is not zero.

    Parameters, the fields of `FeedforwardCarrierPidConfig`:
        position_gain: N/m
        velocity_gain: N s/m; the paper's 1.5 is a damping ratio of 0.075
        integral_gain: N/(m s)

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: FeedforwardCarrierPidConfig | None = None):
        gains = asdict(config or FeedforwardCarrierPidConfig())
        require_non_negative(_BOX, **gains)
        super().__init__(model, gains)


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
        super().__init__(model, _tuned_gains(model, config or TunedCarrierPidConfig()))


@dataclass(kw_only=True)
class TunedFeedforwardCarrierPidConfig(_Poles):
    """The desired poles of every carrier."""


class TunedFeedforwardCarrierPid(_FeedforwardPid):
    """`FeedforwardCarrierPid` whose gains follow from a natural frequency and the carriers' mass.

    u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p) + m_c a_d, gains from
    `mechanics.tuning.pid_gains`.

    .. pydrake_system::

        name: TunedFeedforwardCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force
        - parameters
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)],
    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s), all in W;
    `internal_force` (2m) = [λ (N); λ̇ (N/s)]; `parameters` (2) = [ξ (rad/s), A (N)];
    `carrier_forces` (3n) in N, in W. The integrals of the position errors (3n, m s) are the
    state, where their gain is not zero.

    Parameters, the fields of `TunedFeedforwardCarrierPidConfig`:
        frequency: rad/s, natural frequency of a carrier about its reference
        damping: damping ratio
        integral_rate: rad/s, of the pole that an integral adds; 0: no integral

    Raises:
        ScenarioError: the frequency is not positive, or another parameter is negative.
    """

    def __init__(self, model: Model, config: TunedFeedforwardCarrierPidConfig | None = None):
        super().__init__(model, _tuned_gains(model, config or TunedFeedforwardCarrierPidConfig()))


def _tuned_gains(model: Model, config: _Poles) -> dict[str, float]:
    require_non_negative(_BOX, **asdict(config))
    require_positive(_BOX, frequency=config.frequency)
    names = ("position_gain", "velocity_gain", "integral_gain")
    poles = pid_gains(config.frequency, config.damping, config.integral_rate)
    return {name: model.carrier_mass * gain for name, gain in zip(names, poles, strict=True)}


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
        require_non_negative(_BOX, **asdict(config))
        n = model.n
        super().__init__(
            lambda reference, state, cables: loaded_pid_forces(
                reference,
                state,
                cables,
                mass=model.carrier_mass,
                gravity=model.gravity,
                **asdict(config),
            ),
            inputs={
                "carrier_reference": 6 * n,
                "carrier_state": 6 * n,
                "desired_cable_forces": 3 * n,
            },
            outputs={"carrier_forces": 3 * n},
        )


# The blocks that the box can be, the default first.
VARIANTS = (
    CarrierPid,
    FeedforwardCarrierPid,
    TunedCarrierPid,
    TunedFeedforwardCarrierPid,
    LoadedCarrierPid,
)
