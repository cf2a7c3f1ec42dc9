"""States of a run on its way, and short flights from them with finer steps."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.loop.start import copied_context
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, CarrierStates, LoadState
from drake_nonstop.run.moved_metrics import SHARE, SPEED_GRAIN, TENSION_GRAIN
from drake_nonstop.systems.block import set_state_values, state_values

_SAVING_PERIOD = 0.5  # s; longer where there would be more states than the largest number
_MOST_STATES = 256
_LEAST_LOAD_SPEED = 2e-2  # m/s, of the load: off by that for a second it is off by much more


class RestorableState(Protocol):
    """A state at a time in s, that a context of the loop's diagram can be set to."""

    @property
    def time(self) -> float:
        """In s."""
        ...

    def restore(self, context: Context) -> None:
        """Sets time and state."""
        ...


@dataclass(frozen=True)
class SavedState:
    """The state of a context, without its parameters and what it has cached."""

    time: float
    values: NDArray  # of all that is numeric
    abstract: list[Any]

    @classmethod
    def of(cls, context: Context) -> "SavedState":
        """The state of a context as it is now."""
        abstract = map(context.get_abstract_state, range(context.num_abstract_states()))
        copies = [value.Clone() for value in abstract]
        return cls(context.get_time(), state_values(context), copies)

    def restore(self, context: Context) -> None:
        """Sets the state of a context of the same diagram."""
        context.SetTime(self.time)
        set_state_values(context, self.values)
        for i, value in enumerate(self.abstract):
            context.SetAbstractState(i, value.get_value())


class SavedStates:
    """States of the loop during a run, some time apart."""

    def __init__(self) -> None:
        self.states: list[RestorableState] = []
        self._period = _SAVING_PERIOD
        self.next_time = 0.0  # s, before which there is nothing to save

    def save(self, state: RestorableState) -> None:
        """Adds a state of the loop."""
        self.states.append(state)
        if len(self.states) > _MOST_STATES:
            self.states = self.states[::2]
            self._period *= 2
        self.next_time = self.states[-1].time + (1 - 1e-6) * self._period


COMPARED = ("tensions", "carrier_state", "load_state")  # signals


class FlightSamples(NamedTuple):
    """Signals that two flights are compared by, at the same instants (k,), s."""

    time: NDArray
    tensions: NDArray  # (k, n), N
    speeds: NDArray  # (k, n), m/s, of the carriers
    load_velocity: NDArray  # (k, 3), m/s

    @classmethod
    def of(cls, time: NDArray, signals: Mapping[str, NDArray]) -> "FlightSamples":
        """Values of the signals that are `COMPARED`, by their names."""
        velocities = CarrierStates.view(signals["carrier_state"]).velocities
        speeds = np.linalg.norm(velocities, axis=2)
        load = LoadState.view(signals["load_state"])
        return cls(time, signals["tensions"], speeds, load.velocity)

    def at(self, samples: NDArray) -> "FlightSamples":
        """The flight at some of its instants."""
        return FlightSamples(*(values[samples] for values in self))


def flown(simulator: Simulator, signals: Iterable[str], times: NDArray) -> dict[str, NDArray]:
    """Signals (k, size) of its diagram by their names, as it flies on to times (k,)."""
    diagram, context = simulator.get_system(), simulator.get_context()
    ports = {name: diagram.GetOutputPort(name) for name in signals}
    rows: dict[str, list[NDArray]] = {name: [] for name in ports}
    for time in times.tolist():
        simulator.AdvanceTo(time)
        for name, port in ports.items():
            rows[name].append(port.Eval(context).copy())
    return {name: np.array(values) for name, values in rows.items()}


class ShortFlights:
    """Flies the loop for a short time, and again.

    Blocks get no initialization events: a flight goes on from its state. Their outputs have to
    follow from their contexts.

    Args:
        nonstop: the loop.
        context: a context of it, whose parameters and inputs from outside are taken over.
        config: the integrator's scheme, and the step that the flights' `parts` refer to.
    """

    def __init__(self, nonstop: Diagram, context: Context, config: SimulatorConfig):
        self._config = config
        self.context = copied_context(nonstop, context)
        self._simulator = Simulator(nonstop, self.context)

    def fly(self, start: RestorableState, duration: float, parts: int = 1) -> FlightSamples:
        """A flight from the state on, at about 100 instants a second, with steps / `parts`."""
        first = round(start.time / SIGNAL_PERIOD) + 1
        count = max(1, round(duration / SIGNAL_PERIOD))
        ApplySimulatorConfig(finer(self._config, parts), self._simulator)  # it sets the time, too
        start.restore(self.context)
        self._simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        time = SIGNAL_PERIOD * np.arange(first, first + count)
        return FlightSamples.of(time, flown(self._simulator, COMPARED, time))


def finer(config: SimulatorConfig, parts: int) -> SimulatorConfig:
    """The configuration with steps / `parts`, and an accuracy as much finer."""
    config = copy.deepcopy(config)
    config.max_step_size /= parts
    config.accuracy /= parts**3  # of a third-order scheme's error
    return config


def difference(flight: FlightSamples, other: FlightSamples) -> float:
    """How far two flights are apart; 1: by 2 % of a tension or speed, or by what matters."""
    tensions = np.abs(flight.tensions - other.tensions)
    speeds = np.abs(flight.speeds - other.speeds)
    velocities = np.abs(flight.load_velocity - other.load_velocity)
    return float(
        max(
            np.max(tensions / tolerated_tensions(other)),
            np.max(speeds / tolerated_speeds(other)),
            np.max(velocities / _LEAST_LOAD_SPEED),
        )
    )


def tolerated_tensions(flight: FlightSamples) -> NDArray:
    """By how much a tension may differ, (k, n), N."""
    return SHARE * flight.tensions + TENSION_GRAIN


def tolerated_speeds(flight: FlightSamples) -> NDArray:
    """By how much a carrier's speed may differ, (k, n), m/s."""
    return SHARE * flight.speeds + SPEED_GRAIN
