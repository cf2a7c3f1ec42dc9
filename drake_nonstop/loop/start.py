"""The equilibrium that a run starts from, found on the diagram, whatever its blocks are.

A block that makes `load_state` or `carrier_state` may hold its state in any form, continuous or
discrete: where the port is no equation of the package, it is found by the port's differences. Three
methods are optional, of the block's own context:

- `SetLoadState(context, value)`, `SetCarrierState(context, value)`: has the port show the value
  (13, or 6n), where numeric states alone do not. The load's quaternion has the sign that is given.
- `trim(context, ...)`, also of the block that makes `cable_forces`: sets further states, such as an
  aircraft's attitude, once load and carriers are set, the cables' first and the load's last; what
  the ports show must stay. Its other arguments are signals of the loop by their names, such as
  `carrier_reference_acceleration` (3n); those with a default may be left out. Without it further
  states keep their values.

Where a port does not show what was set, an error names the block: no run starts from another state.
"""

import contextlib
import contextvars
import functools
import inspect
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Context, Diagram, OutputPort, System
from pydrake.systems.primitives import AffineSystem

from drake_nonstop.mechanics.rotation import (
    quaternion_product,
    roll_pitch_yaw_to_quaternion,
    rotate_quaternion,
)
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    SIGNAL_PERIOD,
    LoadReference,
    LoadState,
)
from drake_nonstop.model.descriptions import described
from drake_nonstop.systems.block import (
    declare_default_state,
    set_state_values,
    state_values,
    title,
)
from drake_nonstop.systems.diagnosis import block_blamed, source_of_fault
from drake_nonstop.systems.documentation import declared_by
from drake_nonstop.systems.equation_block import IS_SOUGHT
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import (
    context_in,
    loop_in,
    ports_of,
    require_context,
    require_signals,
    source_of,
    systems_in,
)
from drake_nonstop.validation import ScenarioError, require, warn_user

LOAD, CARRIERS = "load_state", "carrier_state"  # the signals that show the plant's states
_MEASURED = "measured_load_state"  # the signal that controllers read
# What the loop has to make, with sizes; None: 6 for each carrier. No block alone makes all.
LOOP_SIGNALS = {
    LOAD: LOAD_STATE_SIZE,
    "reference": LOAD_REFERENCE_SIZE,
    CARRIERS: None,
    "carrier_reference": None,
}

_SETTERS = {LOAD: "SetLoadState", CARRIERS: "SetCarrierState"}
_TOLERANCE = 1e-6  # of what a port shows, in SI units or relative to larger values
_REST = 1e-6  # m/s² and rad/s², the acceleration that counts as rest
_STEP = 1e-6  # of the differences of accelerations, in SI units
_WRONG = 0.01  # m/s² and rad/s², of a load on its reference that the model did not foresee
_REACH = 0.5  # m and rad, of the linear model
_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step of Newton's method, the first that comes nearer
_NEAR = np.repeat([_REACH, 0.0], [7, 6])  # of a load that may be at its equilibrium: as fast
_DROPS = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1)  # m, below the reference, to start looking from
_CAUTION = 0.5  # of new lengths at first: bow of a cable in motion gives up to three times less
_OBSERVATIONS, _SEEN = 20, 3e-3  # of lengths: as often at most, and until as close, m
_PORT_STEP = 2.0**-16  # of differences of a port: most states are exact with a power of two
_SMALLEST = 1e-9  # of the largest singular value: what a port does not show


def set_equilibrium(nonstop: Diagram, context: Context, *, start_error: Any = None) -> None:
    """Sets load and carriers in `context` to the equilibrium of the loop as configured.

    The carriers start on their references, with their velocities, and the load on its own. Where
    the controllers' model differs from the plant, such as in cables or mass, the corrections of the
    references, see `CarrierTrajectory`, start such that they hold the load. Without corrections the
    load starts where the cables hold it at rest. Newton's method on the built diagram, with its
    initialization events, finds correction or pose for any blocks. The controllers know the load's
    true state there, without noise. Inputs of the loop, where a box was left out, have their values
    at the start. A load whose reference moves at the start has its velocity and acceleration.
    Further states keep their values, except those that a block trims, see `loop/start.py`.

    The output ports `load_state` and `carrier_state` name the blocks with these states, at any
    depth of `nonstop`. Of several ports with one of these names the exported one counts. A load
    that is at its equilibrium already stays there.

    A `start_error` [x, y, z, roll, pitch, yaw] (6,), m and rad, in W, then moves and turns the load
    beside its equilibrium, while the carriers stay.

    Raises:
        ScenarioError: the cables cannot hold the load, a block does not show the state that is
            set, or makes a value that is not finite, or is far too large; no block makes a signal,
            or two do, or an input is not connected; the context is that of another system.
    """
    require_context("set_equilibrium", nonstop, context)
    require_signals(nonstop, LOOP_SIGNALS, "set_equilibrium", is_exporting=False)
    loop = loop_in(nonstop, LOOP_SIGNALS)
    nonstop, context = loop, context_in(nonstop, loop, context)
    trial = copied_context(nonstop, context)
    with block_named(nonstop, trial):
        contextvars.copy_context().run(_settle, nonstop, trial)
        if start_error is not None and np.any(start_error):
            PlantStates(nonstop).displace(trial, np.array(start_error))
    PlantStates(nonstop).take_over(context, trial)


def set_default_equilibrium(nonstop: Diagram, *, start_error: Any = None) -> None:
    """Makes the equilibrium that `set_equilibrium` finds the start of a diagram's new contexts.

    For a loop that was wired by hand, once it is built; `make_nonstop` does it by itself. A
    ScenarioWarning names a block whose default state cannot be set, such as a discrete one.

    Raises:
        ScenarioError: as of `set_equilibrium`.
    """
    for block in starts_beside_defaults(nonstop, start_error):
        warn_user(
            f"{title(block)} = {type(block).__name__}: new contexts of the diagram do "
            "not start at its equilibrium, since the block's default state cannot be set; "
            "call set_equilibrium(diagram, context) before each run"
        )


def starts_beside_defaults(nonstop: Diagram, start_error: Any = None) -> dict[System, NDArray]:
    """What `set_default_equilibrium` does; returns blocks that cannot follow, and their states."""
    require(isinstance(nonstop, Diagram), "diagram", nonstop, "give a built Diagram of floats")
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context, start_error=start_error)
    loop = loop_in(nonstop, LOOP_SIGNALS)
    return PlantStates(loop).declare_defaults(context_in(nonstop, loop, context))


@contextlib.contextmanager
def block_named(nonstop: Diagram, context: Context) -> Iterator[None]:
    """Turns an error of a value or a missing one into a ScenarioError that names the block."""
    with block_blamed():
        try:
            yield
        except NotFiniteError as error:
            source = source_of_fault(error, nonstop, context)
            raise ScenarioError(
                f"start = {source}: it makes a value that is not finite, or beyond {LARGEST:.0e} "
                "in SI units; give its parameters, and those of the blocks before it, values "
                "closer to the defaults, or correct the block"
            ) from None


# The search


def _settle(nonstop: Diagram, trial: Context) -> None:
    """Sets a context of the loop alone to the equilibrium."""
    IS_SOUGHT.set(True)  # of this call alone, see its caller
    plant, simulator = PlantStates(nonstop), Simulator(nonstop, trial)
    reference, given = plant.signals(trial, "reference", LOAD).values()
    on_reference = reference[:LOAD_STATE_SIZE]
    quaternion = on_reference[:4]
    maker = title(ports_of(nonstop, "reference")[0].get_system())
    remedy = "give the load's orientation at the start as a quaternion of length 1"
    is_unit = bool(abs(np.linalg.norm(quaternion) - 1) < _TOLERANCE)
    require(
        is_unit or not np.all(np.isfinite(quaternion)), f"{maker}.reference", quaternion, remedy
    )
    desired = LoadReference.view(reference)
    desired_rate = np.concatenate([desired.angular_acceleration, desired.acceleration])
    # The pull of cables that are stretched to some place far away may not be a number.
    plant.set_states(trial, load_state=on_reference)
    plant.trim(trial, knows=False)
    plant.measure_truly(trial, on_reference)
    start = trial.Clone()
    simulator.Initialize()
    plant.place(trial, on_reference)
    plant.take_over(start, trial)

    def residual_at(load_state: NDArray, correction: NDArray | None = None) -> NDArray:
        """The load's acceleration (6,) beside the reference's."""
        trial.SetTimeStateAndParametersFrom(start)
        if correction is not None:
            plant.correct(trial, correction)
        plant.set_states(trial, load_state=load_state)
        plant.measure_truly(trial, on_reference)
        simulator.Initialize()  # whatever samples or holds takes its first value
        plant.place(trial, load_state)
        return plant.load_acceleration(trial) - desired_rate

    def residual_of(offset: NDArray) -> NDArray:
        """The same at a rotation vector and shift (6,), in W, from the reference.

        References of carriers that can be corrected are in place of the load.
        """
        quaternion, position, *twist = LoadState.view(on_reference)
        if corrects:
            correction, offset = offset, plant.correct(trial, offset)
        turned = rotate_quaternion(quaternion, offset[:3])
        off = np.concatenate([turned, position + offset[3:], *twist])
        return residual_at(off, correction if corrects else None)

    caution, last = _CAUTION, math.inf

    def observe() -> float:
        """Has references start from what cables show; returns how much of it is new, m."""
        nonlocal caution, last
        new = plant.observe(trial, caution)
        caution, last = caution / 2 if new > last else caution, new  # lengths swing: less at once
        plant.take_over_references(start, trial)
        return new

    beside = np.abs(given - on_reference)
    is_near = np.all(beside <= (_REST if plant.can_correct else _NEAR))
    if is_near and np.max(np.abs(residual_at(given))) < _REST / 1e3:
        return
    corrects = False
    is_wrong = plant.can_correct and np.max(np.abs(residual_of(np.zeros(6)))) > _WRONG
    ways = (True, False) if is_wrong else (False,)
    if is_wrong:
        corrects = True
        for _ in range(_OBSERVATIONS):
            residual_of(np.zeros(6))
            if observe() < _SEEN:
                break
    for corrects, plant.trims_for_all, drop in itertools.product(ways, (True, False), _DROPS):
        residual = _newton(residual_of, np.array([0, 0, 0, 0, 0, drop if corrects else -drop]))
        caution, last = _CAUTION, math.inf
        for _ in range(_OBSERVATIONS):
            if not corrects or np.max(np.abs(residual)) > _REST:
                break
            new = observe()
            if new > 0:
                residual = _newton(residual_of, np.zeros(6))
            if new < _SEEN:
                break
        if np.max(np.abs(residual)) < _REST:
            if not plant.trims_for_all:
                warn_user(
                    "start = by what blocks have to know alone: where they move steadily, such as "
                    "cables in their bow, the load is not held near its reference; it may be "
                    "thrown at first"
                )
            return
    signals = plant.signals(trial, "tensions", "disturbance_wrench")
    lift = float(signals.get("disturbance_wrench", np.zeros(6))[5])
    remedy = (
        "give system and simulated loads of about the same mass, their cables about the same "
        "length, stiff enough for the weight, and an amplitude that keeps them taut"
    )
    if not np.any(signals.get("tensions", 1.0)):
        remedy = (
            "all of them are slack; give simulated.cable_length close to system.cable_length, or "
            "reduce what pushes the load up against them at t = 0, or let it start later: "
            f"load_disturbance lifts it with {lift:.3g} N, beside wind, or a reference that falls"
        )
    raise ScenarioError(
        f"start = an acceleration of {np.max(np.abs(residual)):.2g} m/s^2 beside that of the "
        f"reference: the cables do not hold the load near its reference; {remedy}"
    )


def _newton(function: Callable[[NDArray], NDArray], offset: NDArray) -> NDArray:
    """The last value of a function (6,) of an offset (6,), which is driven to zero."""
    residual = function(offset)
    for _ in range(20):
        if np.max(np.abs(residual)) < _REST / 1e3:
            break
        columns = [function(offset + step) - residual for step in _STEP * np.eye(6)]
        # What nothing turns, such as a point mass, stays as it is.
        step = np.linalg.lstsq(np.column_stack(columns) / _STEP, residual, rcond=None)[0]
        if not np.any(step):
            break
        step, last = step / max(1.0, np.max(np.abs(step)) / _REACH), residual
        for share in _SHARES:  # cables that fall slack on the way lead astray
            residual = function(offset - share * step)
            if np.linalg.norm(residual) < np.linalg.norm(last):
                break
        offset = offset - share * step
    return residual


# The plant's states in a loop


class PlantStates:
    """Access to the plant's states in a loop, in which each signal is made once.

    Attributes:
        trims_for_all: whether blocks are trimmed for signals that they can do without, too.
    """

    trims_for_all = True

    def __init__(self, nonstop: Diagram):
        self._nonstop = nonstop
        made = [s for s in ("cable_forces", CARRIERS, LOAD) if ports_of(nonstop, s)]
        ports = {signal: _port_with_state(nonstop, signal) for signal in made}
        blocks = dict.fromkeys(port.get_system() for port in ports.values())
        self._trimmed: list[Any] = [block for block in blocks if hasattr(block, "trim")]
        self._ports = {signal: ports[signal] for signal in _SETTERS}
        self._owners: dict[str, Any] = {s: port.get_system() for s, port in self._ports.items()}
        above: Any = ports_of(nonstop, "carrier_reference")[0].get_system()
        self._references: Any = above if getattr(above, "corrects", False) else None
        self._ports_of = functools.cache(functools.partial(ports_of, nonstop))

    @property
    def _blocks(self) -> list[Any]:
        """Whose states are set."""
        others = [self._references] if self.can_correct else []
        return [*dict.fromkeys([*self._owners.values(), *self._trimmed, *others])]

    def _context(self, system: System, context: Context) -> Context:
        return self._nonstop.GetMutableSubsystemContext(system, context)

    def signals(self, context: Context, *names: str) -> dict[str, NDArray]:
        """Values, by their names, of those signals that the loop makes by one port."""
        ports = {name: self._ports_of(name) for name in names}
        return {
            name: found[0].Eval(self._context(found[0].get_system(), context)).copy()
            for name, found in ports.items()
            if len(found) == 1
        }

    def set_states(self, context: Context, **states: NDArray) -> None:
        """Sets the states that the ports of these names show; further ones stay.

        Carriers without a state are where their port shows them.

        Raises:
            ScenarioError: a port does not show what was set.
        """
        for signal, value in states.items():
            block, own = self._owners[signal], self._context(self._owners[signal], context)
            if hasattr(block, _SETTERS[signal]):
                getattr(block, _SETTERS[signal])(own, value.copy())
            elif signal == LOAD or not own.is_stateless():
                _show(self._ports[signal], own, value)
        self._require_shown(context, states)

    @property
    def can_correct(self) -> bool:
        """Whether the carriers' references can be moved and turned beside the load's."""
        return self._references is not None

    def correct(self, context: Context, correction: NDArray) -> NDArray:
        """Moves the carriers' references by a rotation vector and shift (6,), in W.

        Returns the part by which they cannot be moved.
        """
        rest: NDArray = self._references.SetCorrection(
            self._context(self._references, context), correction
        )
        return rest

    def observe(self, context: Context, share: float) -> float:
        """Has carriers' references take the lengths that cables show; returns the change, m.

        They change by a share of what is new.
        """
        if not hasattr(self._references, "ObserveLengths"):
            return 0.0
        own = self._context(self._references, context)
        return float(np.max(np.abs(self._references.ObserveLengths(own, share))))

    def take_over_references(self, context: Context, settled: Context) -> None:
        """Sets the states of the carriers' references to those in another context of the loop."""
        settled_own = self._nonstop.GetSubsystemContext(self._references, settled)
        self._context(self._references, context).SetStateAndParametersFrom(settled_own)

    def _require_shown(self, context: Context, states: Mapping[str, NDArray]) -> None:
        for signal, value in states.items():
            block, own = self._owners[signal], self._context(self._owners[signal], context)
            shown = self._ports[signal].Eval(own)
            agrees = np.abs(shown - value) <= _TOLERANCE * np.maximum(1.0, np.abs(value))
            entry = int(np.argmin(agrees))
            require(
                bool(agrees[entry]) or (signal == CARRIERS and own.is_stateless()),
                f"{title(block)}.{signal}[{entry}]",
                f"{shown[entry]:.6g}",
                f"its initial state was set to {value[entry]:.6g}; give {type(block).__name__} a "
                f"method {_SETTERS[signal]}(context, value) that sets the state for the port to "
                "show it, or correct it, or trim, which has to keep it",
            )

    def measure_truly(self, context: Context, reference: NDArray) -> None:
        """Shows all who read the measured load state the true one, without noise or delay.

        What a described measurement takes as desired is that of the reference (13,).
        """
        value = self.signals(context, LOAD)[LOAD]
        parts = [*systems_in(self._nonstop)][1:]
        for maker in parts:
            if maker.HasOutputPort(_MEASURED) and (measurement := described(maker)) is not None:
                is_measured = np.append(measurement.is_measured[:1], measurement.is_measured)
                value = np.where(is_measured > 0, value, reference)  # of an attitude four entries
        for reader in parts:
            if reader.HasInputPort(_MEASURED):
                reader.GetInputPort(_MEASURED).FixValue(self._context(reader, context), value)

    def place(self, context: Context, load_state: NDArray) -> None:
        """Sets the load, and the carriers on their references, and has blocks trim the rest.

        The blocks, those of the cables first, set their further states, but not these.

        Raises:
            ScenarioError: a port does not show its state, or not any more.
        """
        carriers = self.signals(context, "carrier_reference")["carrier_reference"]
        states = {LOAD: load_state, CARRIERS: carriers}
        self.set_states(context, **states)
        self.trim(context)
        self._require_shown(context, states)

    def displace(self, context: Context, error: NDArray) -> None:
        """Moves and turns the load by [x, y, z, roll, pitch, yaw] (6,), in W; cables follow."""
        load = LoadState.view(self.signals(context, LOAD)[LOAD])
        turned = quaternion_product(roll_pitch_yaw_to_quaternion(error[3:]), load.quaternion)
        moved = turned, load.position + error[:3], load.angular_velocity, load.velocity
        self._trimmed = [b for b in self._trimmed if b not in self._owners.values()]
        self.set_states(context, load_state=np.concatenate(moved))
        self.trim(context)

    def trim(self, context: Context, *, knows: bool = True) -> None:
        """Has blocks set their further states; where it knows no signals those that need none."""
        for block in self._trimmed:
            _, *known = inspect.signature(block.trim).parameters.values()
            needed = [p.name for p in known if p.default is p.empty]
            names = [p.name for p in known] if self.trims_for_all else needed
            if knows:
                block.trim(self._context(block, context), **self.signals(context, *names))
            elif not needed:
                block.trim(self._context(block, context))

    def take_over(self, context: Context, settled: Context) -> None:
        """Sets all states of the plant's blocks to those in another context of the loop."""
        for block in self._blocks:
            settled_own = self._nonstop.GetSubsystemContext(block, settled)
            self._context(block, context).SetStateAndParametersFrom(settled_own)

    def load_acceleration(self, context: Context) -> NDArray:
        """The load's angular acceleration and acceleration (6,), rad/s² and m/s², in W."""
        block = self._owners[LOAD]
        rate = LoadState.view(_rate(block, self._ports[LOAD], self._context(block, context)))
        acceleration = np.concatenate([rate.angular_velocity, rate.velocity])
        if not np.all(np.isfinite(acceleration)):
            raise NotFiniteError(title(block), was_given=True)
        return acceleration

    def declare_defaults(self, context: Context) -> dict[System, NDArray]:
        """Makes the plant's states those of new contexts; returns those that cannot be."""
        own = {block: self._context(block, context) for block in self._blocks}
        return {b: state_values(c) for b, c in own.items() if not _declare_defaults(b, c)}


def _port_with_state(nonstop: Diagram, signal: str) -> OutputPort:
    """The port that shows the state, of the innermost block that has one or sets it."""
    port, methods = ports_of(nonstop, signal)[0], (_SETTERS.get(signal, "trim"), "trim")
    while isinstance(port.get_system(), Diagram):
        inner = source_of(port)
        is_set = any(hasattr(port.get_system(), name) for name in methods)
        if is_set or inner.get_system().CreateDefaultContext().is_stateless():
            break
        port = inner
    return port


def _declare_defaults(system: Any, context: Context) -> bool:
    """Makes the states in a context the defaults of the systems that hold them, if it can."""
    if isinstance(system, Diagram):
        own = {part: system.GetSubsystemContext(part, context) for part in system.GetSystems()}
        return min(_declare_defaults(part, inner) for part, inner in own.items())
    if isinstance(system, AffineSystem):
        system.configure_default_state(state_values(context))
    elif hasattr(system, "SetDefaultPositions"):  # a MultibodyPlant, which few runs import
        system.SetDefaultPositions(system.GetPositions(context))
    elif not type(system).__module__.startswith("pydrake"):
        declare_default_state(system, context)
    made = state_values(system.CreateDefaultContext())
    return bool(np.allclose(made, state_values(context), rtol=0, atol=_TOLERANCE))


# Numeric states, and what a port shows of them


def copied_context(system: System, context: Context) -> Context:
    """A context of a system by itself, whose inputs have the values of now."""
    copy = system.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    system.FixInputPortsFrom(system, context, copy)
    return copy


def _is_state(port: OutputPort) -> bool:
    """Whether a port shows the first states of a block with equations as they are."""
    equations = declared_by(port.get_system(), "equations_of_block")
    return equations is not None and port.get_name() in [*equations.shown][:1]


def _show(port: OutputPort, context: Context, value: NDArray) -> None:
    """Moves the state as little as possible for a port to show a value, or come close to it."""
    if _is_state(port):
        set_state_values(context, np.append(value, state_values(context)[len(value) :]))
        return
    for _ in range(2):  # again for the rounding of the first
        error = value - port.Eval(context)
        if np.any(error):
            slopes = np.nan_to_num(port_slopes(port, context))
            step = np.linalg.pinv(slopes, rcond=_SMALLEST) @ error
            set_state_values(context, state_values(context) + step)


def port_slopes(port: OutputPort, context: Context) -> NDArray:
    """The Jacobian (entries, states) of a port of the context's system, by central differences."""
    state = state_values(context)
    slopes = np.zeros((port.size(), len(state)))
    for k, step in enumerate(_PORT_STEP * np.eye(len(state))):
        for side in (1, -1):
            set_state_values(context, state + side * step)
            slopes[:, k] += side * port.Eval(context) / (2 * _PORT_STEP)
    set_state_values(context, state)
    return slopes


def _rate(system: System, port: OutputPort, context: Context) -> NDArray:
    """The rate of what a port shows; of discrete states the mean one over a signals' period.

    Inputs are held for that time.
    """
    count = context.num_continuous_states()
    if count and _is_state(port):
        return system.EvalTimeDerivatives(context).CopyToVector()[: port.size()]
    slopes = port_slopes(port, context)[:, :count]
    if np.any(slopes):
        return slopes @ system.EvalTimeDerivatives(context).CopyToVector()
    simulator = Simulator(system, copied_context(system, context))
    simulator.Initialize(InitializeParams(suppress_initialization_events=True))
    simulator.AdvanceTo(context.get_time() + SIGNAL_PERIOD)
    return (port.Eval(simulator.get_context()) - port.Eval(context)) / SIGNAL_PERIOD
