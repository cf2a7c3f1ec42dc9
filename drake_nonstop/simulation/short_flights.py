"""Short flights of the loop from saved states, with its own steps and with shorter ones."""

import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.simulation.moved_metrics import SHARE, SPEED_GRAIN, TENSION_GRAIN
from drake_nonstop.simulation.run import SIGNAL_PERIOD

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
    continuous: NDArray
    discrete: list[NDArray]
    abstract: list[Any]

    @classmethod
    def of(cls, context: Context) -> "SavedState":
        """The state of a context as it is now."""
        return cls(
            context.get_time(),
            context.get_continuous_state_vector().CopyToVector(),
            [
                context.get_discrete_state(i).CopyToVector()
                for i in range(context.num_discrete_state_groups())
            ],
            [context.get_abstract_state(i).Clone() for i in range(context.num_abstract_states())],
        )

    def restore(self, context: Context) -> None:
        """Sets the state of a context of the same diagram."""
        context.SetTime(self.time)
        if len(self.continuous):
            context.SetContinuousState(self.continuous)
        for i, values in enumerate(self.discrete):
            context.SetDiscreteState(i, values)
        for i, value in enumerate(self.abstract):
            context.SetAbstractState(i, value.get_value())


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What two flights are compared by, at the same instants (k,), s."""

    time: NDArray
    tensions: NDArray  # (k, n), N
    speeds: NDArray  # (k, n), m/s, of the carriers
    load_velocity: NDArray  # (k, 3), m/s

    def at(self, samples: NDArray) -> "Flight":
        """The flight at some of its instants."""
        return Flight(
            time=self.time[samples],
            tensions=self.tensions[samples],
            speeds=self.speeds[samples],
            load_velocity=self.load_velocity[samples],
        )


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
        self._nonstop, self._config = nonstop, config
        self.context = nonstop.CreateDefaultContext()
        self.context.SetTimeStateAndParametersFrom(context)
        nonstop.FixInputPortsFrom(nonstop, context, self.context)
        self._simulator = Simulator(nonstop, self.context)
        self._ports = [
            nonstop.GetOutputPort(name) for name in ("tensions", "carrier_state", "load_state")
        ]

    def fly(self, start: RestorableState, duration: float, parts: int = 1) -> Flight:
        """A flight from the state on, at about 100 instants a second, with steps / `parts`."""
        first = round(start.time / SIGNAL_PERIOD) + 1
        count = max(1, round(duration / SIGNAL_PERIOD))
        config = copy.deepcopy(self._config)
        if config.use_error_control:
            config.accuracy /= parts**3
        else:
            config.max_step_size /= parts
        ApplySimulatorConfig(config, self._simulator)  # it sets the time, too
        start.restore(self.context)
        self._simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        rows = []
        time = SIGNAL_PERIOD * np.arange(first, first + count)
        for instant in time:
            self._simulator.AdvanceTo(instant)
            rows.append([port.Eval(self.context).copy() for port in self._ports])
        tensions, carriers, load = (np.array(column) for column in zip(*rows, strict=True))
        return Flight(
            time=time,
            tensions=tensions,
            speeds=np.linalg.norm(CarrierStates.view(carriers).velocities, axis=2),
            load_velocity=load[:, -3:],
        )


def difference(flight: Flight, finer: Flight) -> float:
    """How far two flights are apart; 1: by 2 % of a tension or speed, or by what matters."""
    tensions = np.abs(flight.tensions - finer.tensions)
    speeds = np.abs(flight.speeds - finer.speeds)
    velocities = np.abs(flight.load_velocity - finer.load_velocity)
    return float(
        max(
            np.max(tensions / tolerated_tensions(finer)),
            np.max(speeds / tolerated_speeds(finer)),
            np.max(velocities / _LEAST_LOAD_SPEED),
        )
    )


def tolerated_tensions(flight: Flight) -> NDArray:
    """By how much a tension may differ, (k, n), N."""
    return SHARE * flight.tensions + TENSION_GRAIN


def tolerated_speeds(flight: Flight) -> NDArray:
    """By how much a carrier's speed may differ, (k, n), m/s."""
    return SHARE * flight.speeds + SPEED_GRAIN
