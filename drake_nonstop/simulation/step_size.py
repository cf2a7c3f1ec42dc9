"""The longest step that is stable and that resolves the commanded motion."""

import copy
import math
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

from drake_nonstop.analysis.linearized_loop import LinearizedLoop, LinearizedTrace
from drake_nonstop.loop.equilibrium import on_reference
from drake_nonstop.loop.traced_start import TracedStart
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, CarrierStates, LoadReference, LoadState
from drake_nonstop.simulation.moved_metrics import SHARE, SPEED_GRAIN, TENSION_GRAIN
from drake_nonstop.systems.port_state import copied_context, set_state_values, state_values
from drake_nonstop.validation import require

SHORTEST_STEP = 1e-5  # s; with a shorter one a run would not come to an end
_STABLE_STEP = 1.6  # rad, the fastest mode's turn in a step; third-order Runge-Kutta: 1.73

_INSTANTS = 50  # of the reference that are compared
_TRIAL = 0.03  # s, of a trial flight, or longer: three samples of the controllers
_SMALL_JUMP = 3e-4  # of the cables' length
_RESOLVED = 0.1  # the largest `difference` of trial flights whose steps are kept
_HALVINGS = 4  # of the step at most
_GROWN = 2.0  # logarithm of a deviation at the run's end, of a loop that counts as unstable
_DIFFERENTLY_GROWN = 1.0  # by which that may differ, with a deviation of no more than _GROWN


@dataclass(frozen=True)
class ChosenStep:
    """A configuration with a step.

    `reasons` are what the step is shorter for than the one that was asked for; `unresolved` says
    what it does not resolve, if anything. `is_in_doubt` where a small deviation grows so much that
    a step which is resolved by itself may change the end of the run.
    """

    config: SimulatorConfig
    reasons: tuple[str, ...] = ()
    unresolved: str = ""
    is_in_doubt: bool = False


def chosen_step(
    config: SimulatorConfig,
    nonstop: Diagram,
    context: Context,
    *,
    control_period: float,
    duration: float,
    length: float,
    traced: TracedStart | None = None,
) -> ChosenStep:
    """A step that the scheme is stable at and that resolves the commanded motion.

    Steps of any scheme but the third-order Runge-Kutta one without error control are the user's.

    Args:
        config: the one that is asked for.
        nonstop: the loop.
        context: at the start.
        control_period: the controllers' sample time in s.
        duration: of the run, in s.
        length: of the cables, in m.
        traced: of the context, by which the loop is linearized sooner; None: by its diagram.

    Raises:
        ScenarioError: the fastest mode asks for steps that would take for ever.
    """
    if not has_chosen_steps(config):
        return ChosenStep(config)
    if traced is None:
        loop = LinearizedLoop(nonstop, context, control_period)
    else:
        loop = LinearizedTrace(traced, control_period)
    stable = _stable(config, loop)
    chosen = _resolving(stable, nonstop, context, control_period, duration, length)
    reasons = []
    if stable.max_step_size < config.max_step_size:
        reasons.append("the fastest mode of the loop")
    if chosen.max_step_size < stable.max_step_size:
        reasons.append("the commanded motion between the controllers' samples")
    hidden, is_in_doubt = _hidden_growth(loop, chosen.max_step_size, duration)
    return ChosenStep(chosen, tuple(reasons), hidden, is_in_doubt)


def stable_config(config: SimulatorConfig, nonstop: Diagram, context: Context) -> SimulatorConfig:
    """The configuration with a step that the fixed-step Runge-Kutta scheme is stable at.

    Explicit schemes blow up, at first in silence, where the step is too long for the
    fastest mode; for the third-order one that is at 1.73 divided by the mode's rad/s.
    Steps of any other scheme, and shorter ones, are the user's.

    Raises:
        ScenarioError: the fastest mode asks for steps that would take for ever.
    """
    if not has_chosen_steps(config):
        return config
    return _stable(config, LinearizedLoop(nonstop, context, 0.0))


def _stable(config: SimulatorConfig, loop: LinearizedLoop) -> SimulatorConfig:
    mode = loop.fastest_mode
    longest = _STABLE_STEP / mode if mode > 0 else math.inf
    require(
        longest >= SHORTEST_STEP,
        "fastest mode",
        f"{mode:.3g} rad/s",
        "give less stiffness, damping, drag or gain to what moves so fast, or heavier bodies; it "
        f"asks for steps below {SHORTEST_STEP:g} s",
    )
    if config.max_step_size <= longest:
        return config
    # A whole part of the signals' period, so that no step is cut short by it.
    return with_step(config, SIGNAL_PERIOD / math.ceil(SIGNAL_PERIOD / longest))


def _hidden_growth(loop: LinearizedLoop, step: float, duration: float) -> tuple[str, bool]:
    """A sentence on a step (s) that hides, or causes, that a small deviation grows.

    Long steps damp what oscillates, so that an unstable loop may look stable. The second value
    tells whether there may be a difference though nothing is said.
    """
    if not loop.is_continuous:
        return "", False
    exact, stepped = loop.growths(step)
    grown, difference = duration * max(exact, stepped), duration * abs(stepped - exact)
    if grown < _GROWN or difference < _DIFFERENTLY_GROWN:
        amplified = difference * math.exp(min(grown, 100.0) - _GROWN)
        return "", grown >= _GROWN and amplified >= _DIFFERENTLY_GROWN
    said = (
        f"at the start a small deviation grows by {exact:.2g} 1/s, and by {stepped:.2g} 1/s with "
        f"steps of {1e3 * step:.3g} ms, which do not show whether the loop is stable; give a "
        f"shorter simulator_config.max_step_size, such as {step / 8:.2g}"
    )
    return said, False


def _resolving(
    config: SimulatorConfig,
    nonstop: Diagram,
    context: Context,
    control_period: float,
    duration: float,
    length: float,
) -> SimulatorConfig:
    """The configuration with a step that resolves the most demanding commanded motion.

    Between the controllers' samples the carriers' references move along straight lines. At each
    sample they jump by what the motion curves meanwhile, and a carrier rings. From the instant of
    the reference at which it curves most, a short trial is flown with the step and with halves
    of it, until a half makes no difference. Small jumps are not tried. Where each half makes a
    difference the motion is resolved by no step, and the step stays.
    """
    time, curvature = _most_demanding(nonstop, context, duration)
    if curvature * control_period**2 / 2 < _SMALL_JUMP * length:
        return config
    flights = ShortFlights(nonstop, context, config)
    try:
        flights.context.SetTime(time)
        on_reference(nonstop, flights.context)
        start = SavedState.of(flights.context)
        time = max(_TRIAL, 3 * control_period)
        flown = flights.fly(start, time)
        for halvings, step in enumerate(_halved(config.max_step_size)):
            again = flights.fly(start, time, 2 ** (halvings + 1))
            if difference(flown, again) <= _RESOLVED:
                return with_step(config, step)
            flown = again
    except Exception:  # whatever blocks may raise there: the run itself will tell
        pass
    return config


def _halved(step: float) -> list[float]:
    """The step, and halves of it."""
    return [part for i in range(_HALVINGS + 1) if (part := step / 2**i) >= SHORTEST_STEP]


def has_chosen_steps(config: SimulatorConfig) -> bool:
    """Whether the steps are those of the default scheme, and of the length that is asked for."""
    return config.integration_scheme == "runge_kutta3" and not config.use_error_control


def with_step(config: SimulatorConfig, step: float) -> SimulatorConfig:
    """The configuration with that step in s: itself where that is its own."""
    if config.max_step_size == step:
        return config
    config = copy.deepcopy(config)
    config.max_step_size = step
    return config


def _most_demanding(nonstop: Diagram, context: Context, duration: float) -> tuple[float, float]:
    """When the reference curves most (s), and by how much a carrier's path does (m/s²)."""
    port = nonstop.GetOutputPort("reference")
    load = LoadState.view(nonstop.GetOutputPort("load_state").Eval(context))
    carriers = CarrierStates.view(nonstop.GetOutputPort("carrier_state").Eval(context))
    lever = np.max(np.linalg.norm(carriers.positions - load.position, axis=1))
    times = np.linspace(0, duration, _INSTANTS, endpoint=False)
    ahead = "reference_preview"
    preview = nonstop.GetOutputPort(ahead).Eval(context) if nonstop.HasOutputPort(ahead) else None
    if preview is None or preview.end_time < duration:
        moved = copied_context(nonstop, context)
        Simulator(nonstop, moved).Initialize()  # whatever samples or holds takes its first value
        preview = ReferencePreview(lambda time: moved.SetTime(time) or port.Eval(moved).copy())
    reference = LoadReference.view(preview.at(times))
    turning = np.linalg.norm(reference.angular_acceleration, axis=1)
    turning = turning + np.sum(reference.angular_velocity**2, axis=1)
    curvatures = np.linalg.norm(reference.acceleration, axis=1) + lever * turning
    hardest = np.argmax(curvatures)
    return float(times[hardest]), float(curvatures[hardest])


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
