"""The states of load and carriers in a loop: how they are set and read, whatever the blocks are.

A run starts from states that are found on the built diagram. A block that makes `load_state` or
`carrier_state` may hold its state in any form, continuous or discrete. It may have these methods;
none is needed. `context` is the block's own, in which its input ports can be evaluated.

- `SetLoadState(context, value)`, `SetCarrierState(context, value)`: has the port show the value
  (13, or 6n). Without it the state is found through the port.
- `CalcLoadAcceleration(context)`: returns the load's [ω̇; v̇] (6) in W. Without it that follows
  from the rate of the continuous state, or from one update of the discrete one.
- `TrimLoad(context)`, `TrimCarriers(context)`: sets further states, such as a pendulum's angle or
  an aircraft's attitude, each time that load and carriers have been set, the carriers' first.
  What the ports show must stay. Without it further states keep their values.
- `TrimCarriersTo(context, acceleration)`: in place of `TrimCarriers`, sets further states for the
  carriers to have this acceleration (3n), that of `carrier_reference`.
- `TrimCables(context, reference)`, of the block that makes `cable_forces`: sets its state for the
  load and the carriers of now, before the carriers' states are trimmed; `reference` is the signal
  `cable_reference`, None: there is none. Without it that keeps its value.
- `SetDefaultLoadState(value)`, `SetDefaultCarrierState(value)`: makes the value that of new
  contexts. Without it the defaults of Drake's Integrator, AffineSystem and MultibodyPlant (its
  positions) in the block are set, and the continuous states of LeafSystems in Python declared anew.

Where a port then does not show what was set, an error names the block: no run starts from another
state.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, OutputPort
from pydrake.systems.primitives import AffineSystem, Integrator

from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.systems.block import declare_default_state, title
from drake_nonstop.systems.port_state import PortState, set_state_values, state_values
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.systems.wiring import ports_of, source_of
from drake_nonstop.validation import ScenarioError, require

LOAD, CARRIERS = "load_state", "carrier_state"  # the signals that show the plant's states
_SETTERS = {LOAD: "SetLoadState", CARRIERS: "SetCarrierState"}
_DEFAULT_SETTERS = {LOAD: "SetDefaultLoadState", CARRIERS: "SetDefaultCarrierState"}
_TRIMS = {CARRIERS: "TrimCarriers", LOAD: "TrimLoad"}  # in the order of their calls
_TRIM_TO = "TrimCarriersTo"
_CABLES, TRIM_CABLES = "cable_forces", "TrimCables"
_METHODS = {
    LOAD: (_SETTERS[LOAD], _DEFAULT_SETTERS[LOAD], _TRIMS[LOAD], "CalcLoadAcceleration"),
    CARRIERS: (_SETTERS[CARRIERS], _DEFAULT_SETTERS[CARRIERS], _TRIMS[CARRIERS], _TRIM_TO),
}
_TOLERANCE = 1e-6  # of what a port shows, in SI units or relative to larger values


class PlantStates:
    """Access to the plant's states in a loop, in which each signal is made once."""

    def __init__(self, nonstop: Diagram):
        self._nonstop = nonstop
        self._ports = {signal: _port_with_state(nonstop, signal) for signal in _SETTERS}
        self._owners = {signal: port.get_system() for signal, port in self._ports.items()}
        cables = [port.get_system() for port in ports_of(nonstop, _CABLES)]
        self._cables = [block for block in cables if hasattr(block, TRIM_CABLES)]
        self._shown = {
            signal: PortState(self._owners[signal], port) for signal, port in self._ports.items()
        }

    def _context(self, signal: str, context: Context) -> Context:
        return self._nonstop.GetMutableSubsystemContext(self._owners[signal], context)

    def signal(self, context: Context, name: str) -> NDArray | None:
        """Value of the loop's one port of that name; None: there is none, or several."""
        ports = ports_of(self._nonstop, name)
        if len(ports) != 1:
            return None
        own = self._nonstop.GetSubsystemContext(ports[0].get_system(), context)
        value: NDArray = ports[0].Eval(own).copy()
        return value

    def required(self, context: Context, name: str) -> NDArray:
        """Value as of `signal`, of a port that the loop has."""
        value = self.signal(context, name)
        assert value is not None, name
        return value

    def set_states(self, context: Context, **states: NDArray) -> None:
        """Sets the states that the ports of these names show; further ones stay.

        Carriers without a state are where their port shows them.

        Raises:
            ScenarioError: a port does not show what was set.
        """
        for signal, value in states.items():
            own, block = self._context(signal, context), self._owners[signal]
            if own.is_stateless() and signal == CARRIERS:
                continue
            if hasattr(block, _SETTERS[signal]):
                getattr(block, _SETTERS[signal])(own, value.copy())
            else:
                self._show(signal, own, value)
            self._check(signal, own, value)

    def _show(self, signal: str, context: Context, value: NDArray) -> None:
        """Looks for the state that the port shows; a quaternion's sign may be the port's own."""
        before = state_values(context)
        self._shown[signal].show(context, value)
        port = self._ports[signal]
        if signal != LOAD or np.all(_agree(signal, port.Eval(context), value)):
            return
        closest = state_values(context)
        set_state_values(context, before)
        self._shown[signal].show(context, _flipped(value))
        if not np.all(_agree(signal, port.Eval(context), value)):
            set_state_values(context, closest)

    def try_to_set(self, context: Context, **states: NDArray) -> None:
        """Sets states as `set_states` does; changes nothing where a port does not show them."""
        before = state_values(context)
        try:
            self.set_states(context, **states)
        except ScenarioError:
            set_state_values(context, before)

    def _check(self, signal: str, context: Context, value: NDArray, trim: str = "") -> None:
        """Raises ScenarioError where a port shows something else than was set.

        `trim` names the methods that have been called since then.
        """
        block = self._owners[signal]
        shown = self._ports[signal].Eval(context)
        wrong = ~_agree(signal, shown, value)
        if not np.any(wrong):
            return
        entry = int(np.argmax(wrong))
        setter, name = _SETTERS[signal], type(block).__name__
        if trim:
            remedy = f"correct {trim}, after which the port has to show it still"
        elif hasattr(block, setter):
            remedy = f"correct {name}.{setter}(context, value), after which the port has to show it"
        else:
            remedy = (
                f"give {name} a method {setter}(context, value) that sets the state for the port "
                "to show the value"
            )
        require(
            False,
            f"{title(block)}.{signal}[{entry}]",
            f"{shown[entry]:.6g}",
            f"its initial state was set to {value[entry]:.6g}; {remedy}",
        )

    def trim(self, context: Context, **states: NDArray) -> None:
        """Has the blocks set their further states, which must not change these.

        Raises:
            ScenarioError: a port does not show its state any more.
        """
        self.trim_cables(context)
        trimmed = self._trim_carriers(context)
        for signal, name in _TRIMS.items():
            if hasattr(self._owners[signal], name):
                getattr(self._owners[signal], name)(self._context(signal, context))
                trimmed.append(f"{type(self._owners[signal]).__name__}.{name}(context)")
        for signal, value in states.items() if trimmed else ():
            own = self._context(signal, context)
            if not own.is_stateless():
                self._check(signal, own, value, " and ".join(trimmed))

    def trim_cables(self, context: Context) -> None:
        """Has cables with a state set it for the load and the carriers."""
        for block in self._cables:
            own = self._nonstop.GetMutableSubsystemContext(block, context)
            block.TrimCables(own, self.signal(context, "cable_reference"))

    def _trim_carriers(self, context: Context) -> list[str]:
        """Has the carriers' block set states for its reference's acceleration; what was called."""
        block, name = self._owners[CARRIERS], "carrier_reference_acceleration"
        if not hasattr(block, _TRIM_TO):
            return []
        source = type(block).__name__
        remedy = f"give a carrier_trajectory that makes it: {source} starts with it"
        require(self.signal(context, name) is not None, name, "not among the signals", remedy)
        acceleration = self.required(context, name)
        getattr(block, _TRIM_TO)(self._context(CARRIERS, context), acceleration)
        return [f"{source}.{_TRIM_TO}(context, acceleration)"]

    def take_over(self, context: Context, settled: Context) -> None:
        """Sets all states of the plant's blocks to those in another context of the loop."""
        for block in (*self._owners.values(), *self._cables):
            own = self._nonstop.GetMutableSubsystemContext(block, context)
            own.SetStateAndParametersFrom(self._nonstop.GetSubsystemContext(block, settled))

    def load_acceleration(self, context: Context) -> NDArray:
        """The load's angular acceleration and acceleration (6,), rad/s² and m/s², in W.

        Raises:
            ScenarioError: the block does not tell.
        """
        own, block = self._context(LOAD, context), self._owners[LOAD]
        if hasattr(block, "CalcLoadAcceleration"):
            acceleration = np.asarray(block.CalcLoadAcceleration(own), dtype=float)
            remedy = "correct CalcLoadAcceleration(context), which returns 6 numbers"
            require(acceleration.shape == (6,), title(block), type(block).__name__, remedy)
        else:
            view = LoadState.view(self._shown[LOAD].rate(own))
            acceleration = np.concatenate([view.angular_velocity, view.velocity])
        if not np.all(np.isfinite(acceleration)):
            raise NotFiniteError(title(block), was_given=True)
        return acceleration

    def acceleration_source(self, context: Context) -> str:
        """A sentence on a load's acceleration by differences; empty where a block tells it."""
        own, block = self._context(LOAD, context), self._owners[LOAD]
        if hasattr(block, "CalcLoadAcceleration") or self._shown[LOAD].is_continuous(own):
            return ""
        return (
            f"; if the load does not move with the first update of its discrete state, give "
            f"{type(block).__name__} a method CalcLoadAcceleration(context)"
        )

    def is_continuous(self, context: Context) -> bool:
        """Whether the load's state, and the carriers' where they have one, are continuous."""
        return all(
            self._context(signal, context).is_stateless()
            or shown.is_continuous(self._context(signal, context))
            for signal, shown in self._shown.items()
        )

    def states(self, context: Context) -> dict[str, NDArray]:
        """Values of the ports, by their names, of the blocks that have a state."""
        return {
            signal: self._ports[signal].Eval(own).copy()
            for signal in self._owners
            if not (own := self._context(signal, context)).is_stateless()
        }

    def declare_defaults(self, context: Context) -> list[str]:
        """Makes the plant's states those of new contexts; says of each block that differs so."""
        states = self.states(context)
        for signal, value in states.items():
            block = self._owners[signal]
            if hasattr(block, _DEFAULT_SETTERS[signal]):
                getattr(block, _DEFAULT_SETTERS[signal])(value.copy())
            else:
                _declare_defaults(block, self._nonstop.GetSubsystemContext(block, context))
        for block in self._cables:
            _declare_defaults(block, self._nonstop.GetSubsystemContext(block, context))
        default, others = self._nonstop.CreateDefaultContext(), []
        self._nonstop.FixInputPortsFrom(self._nonstop, context, default)
        for signal, value in self.states(default).items():
            block = self._owners[signal]
            is_declared = np.all(_agree(signal, value, states[signal]))
            if hasattr(block, _TRIMS[signal]) or hasattr(block, _TRIM_TO):
                of_block = [self._nonstop.GetSubsystemContext(block, c) for c in (default, context)]
                given, wanted = map(state_values, of_block)
                is_declared &= np.allclose(given, wanted, rtol=0, atol=_TOLERANCE)
            if not is_declared:
                others.append(
                    f"{title(block)} = {type(block).__name__}: new contexts of the diagram do "
                    "not start at its equilibrium, since the block's default state cannot be set; "
                    "call set_equilibrium(diagram, context) before each run, or give it a method "
                    f"{_DEFAULT_SETTERS[signal]}(value)"
                )
        return others


def has_own_states(block: Any, signal: str) -> bool:
    """Whether a block that shows its state in a signal sets no further ones with it."""
    return not (hasattr(block, _TRIMS[signal]) or hasattr(block, _TRIM_TO))


def _port_with_state(nonstop: Diagram, signal: str) -> OutputPort:
    """The port that shows the state: of the block in a diagram that has one of the methods."""
    outermost = port = ports_of(nonstop, signal)[0]
    while not any(hasattr(port.get_system(), name) for name in _METHODS[signal]):
        if not isinstance(port.get_system(), Diagram):
            return outermost
        port = source_of(port)
    return port


def _agree(signal: str, shown: NDArray, value: NDArray) -> NDArray:
    """Whether the entries are the same; a quaternion and its negative are one attitude."""

    def agrees(other: NDArray) -> NDArray:
        return np.abs(shown - other) <= _TOLERANCE * np.maximum(1.0, np.abs(other))

    same = agrees(value)
    if signal == LOAD and not np.all(same):
        flipped = agrees(_flipped(value))
        return flipped if np.all(flipped) else same
    return same


def _flipped(load_state: NDArray) -> NDArray:
    """The same load state with the other quaternion of its attitude."""
    flipped = load_state.copy()
    LoadState.view(flipped).quaternion[:] *= -1
    return flipped


def _declare_defaults(system: Any, context: Context) -> None:
    """Makes the states in a context the defaults of Drake's systems that hold them."""
    if isinstance(system, Diagram):
        for inner in system.GetSystems():
            _declare_defaults(inner, system.GetSubsystemContext(inner, context))
    elif isinstance(system, Integrator):
        system.set_default_integral_value(context.get_continuous_state_vector().CopyToVector())
    elif isinstance(system, AffineSystem):
        system.configure_default_state(state_values(context))
    elif hasattr(system, "SetDefaultPositions"):  # a MultibodyPlant, which few runs import
        system.SetDefaultPositions(system.GetPositions(context))
    elif not type(system).__module__.startswith("pydrake"):
        declare_default_state(system, context)
