"""Floquet analysis of the loop around the carriers' periodic motion while the load rests."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig
from drake_nonstop.blocks.load_feedback import MeasurementConfig
from drake_nonstop.blocks.load_trajectory import RestToRestConfig, SteadyTurnConfig
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.blocks.phase import AccumulatedPhaseConfig
from drake_nonstop.diagrams.nonstop import BOXES, SAMPLE_AND_HOLD, box_of, make_nonstop
from drake_nonstop.loop.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.loop.equilibrium import set_equilibrium
from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotate_quaternion,
    rotation_vector,
)
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.simulation.step_size import stable_config
from drake_nonstop.systems.port_state import PortState, set_state_values, state_values
from drake_nonstop.validation import require

_NOISES = ("position_noise", "orientation_noise", "velocity_noise", "angular_velocity_noise")
_STEP = 1e-6  # of differences, in SI units
_PHASES = 15  # of a turn, at which the loop is linearized
_ONE_THREAD = 2**17  # multiplications in a product; OpenBLAS starts threads above 2^18
NEUTRAL = 1 + 1e-4  # above the multipliers of slow integrators, with rounding
_CHANGES_OF_WIND = ("start_time", "rise_time", "gust", "load_gust")  # fields of its blocks
_LOAD = box_of("load_state")
# Whose states are not perturbed.
_EXOGENOUS = (SAMPLE_AND_HOLD, *(name for name, box in BOXES.items() if not box.is_linearized))


@dataclass(kw_only=True)
class Stability:
    """The Floquet multipliers of the loop, and its least stable mode.

    In each period, a turn of the carriers, a small deviation grows in the long run by the
    largest magnitude of the multipliers: the loop is stable where that is below 1.
    """

    period: float  # s
    multipliers: NDArray  # (k,), complex, the largest magnitude first
    frequency: float  # rad/s, of the least stable mode at the start of the period
    shares: dict[str, float]  # of each block's states in that mode; their sum is 1

    @property
    def largest(self) -> float:
        """The largest magnitude of a multiplier."""
        return float(abs(self.multipliers[0]))

    @property
    def is_stable(self) -> bool:
        """Whether small deviations decay, or stay constant to four digits."""
        return self.largest < NEUTRAL

    @property
    def rate(self) -> float:
        """The rate at which a deviation grows, in 1/s; negative where it decays."""
        return math.log(max(self.largest, 1e-300)) / self.period


def at_rest(scenario: Scenario) -> Scenario:
    """The scenario with a load at rest in its first pose, and constant ξ and A.

    The paper's phase becomes an accumulated one, which is the same while ξ is constant; there is
    no disturbance, the wind is steady, and the feedback has no error but its delay.

    Raises:
        ScenarioError: the load of the scenario turns all the time.
    """
    require(
        not isinstance(scenario.load_trajectory, SteadyTurnConfig),
        "load_trajectory",
        "SteadyTurn",
        "this study is about a load at rest; give RestToRest, and a pattern with orbits",
    )
    feedback = scenario.load_feedback
    if isinstance(feedback, MeasurementConfig):
        # What a filter behind it believes stays.
        feedback = dataclasses.replace(feedback, **dict.fromkeys(_NOISES, 0.0), seed=0)
    return dataclasses.replace(
        scenario,
        load_trajectory=RestToRestConfig(
            **_parameters(scenario.load_trajectory, "start_position", "start_roll_pitch_yaw")
        ),
        load_feedback=feedback,
        load_disturbance=NoDisturbanceConfig(),
        wind=_steady(scenario.wind),
        phase=AccumulatedPhaseConfig(),
        optimization_layer=ConstantParametersConfig(
            **_parameters(scenario.optimization_layer, "frequency", "amplitude", "speed_bound")
        ),
    )


def _steady(wind: Any) -> Any:
    """The wind without gusts, risen from the beginning on."""
    changing = [name for name in _CHANGES_OF_WIND if hasattr(wind, name)]
    return dataclasses.replace(wind, **dict.fromkeys(changing, 0.0)) if changing else wind


def _parameters(config: Any, *names: str) -> dict[str, Any]:
    """Those of the named parameters that a config, perhaps of the user's own block, has."""
    return {name: getattr(config, name) for name in names if hasattr(config, name)}


def linearize(scenario: Scenario) -> Stability:
    """The Floquet multipliers of a scenario's loop around the motion of a resting load.

    The loop is simulated as it is, with its sampled controllers, delays and integrator. The map
    from one sample to the next is differentiated at some phases of a turn and interpolated
    between them; the product of these Jacobians is the map of a whole turn (own derivation).
    The derivatives are exact where the loop can be compiled, and central differences of its
    diagram elsewhere. The phase is left out: its multiplier is 1 in any loop.

    Raises:
        ScenarioError: the scenario cannot be built.
    """
    check(scenario)
    scenario = scenario.sampled()
    resting = at_rest(scenario)
    nonstop = make_nonstop(resting, at_equilibrium=False)
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    sample = scenario.control_period or 0.01
    turn = 2 * math.pi / resting.optimization_layer.frequency
    samples = max(1, round(turn / sample))
    config = stable_config(resting.simulator_config, nonstop, context)

    coordinates = _Coordinates(nonstop, context)
    sample_map: _DifferencedMaps | _ExactMaps
    sample_map = _DifferencedMaps(coordinates, nonstop, context, config, sample)
    if not reason_against(nonstop, config, sample, compiles=False):
        loop = CompiledLoop(nonstop, config, sample, signals=(), compiles=False)
        if not loop.blocks_without_derivatives:
            sample_map = _ExactMaps(coordinates, loop, context)

    # Before each phase the loop runs from its equilibrium until the delays are filled.
    delay = getattr(scenario.load_feedback, "delay", 0.0)
    lead = 1 + math.ceil(delay / sample - 1e-9)
    steps = []
    for phase in 2 * math.pi * np.arange(_PHASES) / _PHASES:
        _start_orbit(nonstop, context, phase - 2 * math.pi * lead / samples)
        steps.append(sample_map.after(lead))
    monodromy = _product(_interpolated(np.array(steps), samples), coordinates.size)
    multipliers, vectors = np.linalg.eig(monodromy)
    order = np.argsort(-np.abs(multipliers), kind="stable")
    mode = vectors[:, order[0]]
    # The mode's change in the first sample gives its frequency, up to half the sampling rate.
    after_a_sample = np.vdot(mode, steps[0] @ mode)
    weights = np.abs(mode) ** 2
    shares = {
        name: float(weights[places].sum() / weights.sum())
        for name, places in coordinates.places.items()
    }
    return Stability(
        period=samples * sample,
        multipliers=multipliers[order],
        frequency=float(abs(np.angle(after_a_sample)) / sample),
        shares=shares,
    )


def _interpolated(values: NDArray, count: int) -> Iterator[NDArray]:
    """A function of the phase at `count` even phases of a turn, from an odd number k of (k, …).

    By trigonometric interpolation, whose error for a smooth periodic function is near rounding.
    """
    orders = np.fft.fftfreq(len(values), 1 / len(values))
    spectrum = np.fft.fft(np.eye(len(values)), axis=0) / len(values)
    for phase in 2 * math.pi * np.arange(count) / count:
        weights = (np.exp(1j * orders * phase) @ spectrum).real
        yield np.einsum("k,k...->...", weights, values)


def _product(steps: Iterable[NDArray], size: int) -> NDArray:
    """The product of square matrices, the first one on the right.

    By parts so small that NumPy's OpenBLAS starts no threads, as `einsum` starts none: in a process
    per core they would wait for each other, a hundred times as long as the products take.
    """
    width = max(1, _ONE_THREAD // size**2)
    parts = np.split(np.eye(size), range(width, size, width), axis=1)
    for step in steps:
        parts = [step @ part for part in parts]
    return np.hstack(parts)


def _start_orbit(nonstop: Diagram, context: Context, phase: float) -> None:
    """Sets a context to the loop's equilibrium at t = 0, with the carriers at a phase (rad)."""
    context.SetTimeStateAndParametersFrom(nonstop.CreateDefaultContext())
    block = nonstop.GetSubsystemByName("phase")
    own = nonstop.GetMutableSubsystemContext(block, context)
    if own.num_continuous_states():
        own.SetContinuousState([phase, 0.0])
    else:
        own.SetDiscreteState([phase, 0.0])
    set_equilibrium(nonstop, context)


class _DifferencedMaps:
    """The Jacobians of the map over a sample by central differences of the diagram.

    Args:
        coordinates: what is differentiated.
        nonstop: the loop.
        context: at the start of a flight, each time.
        config: the integrator's step.
        sample: s.
    """

    def __init__(
        self,
        coordinates: "_Coordinates",
        nonstop: Diagram,
        context: Context,
        config: SimulatorConfig,
        sample: float,
    ):
        self._coordinates, self._sample = coordinates, sample
        self._simulator = Simulator(nonstop, context)
        ApplySimulatorConfig(config, self._simulator)

    def after(self, lead: int) -> NDArray:
        """The Jacobian (k, k) of the sample after some others."""
        self._simulator.Initialize()
        self._simulator.AdvanceTo(lead * self._sample)
        context, coordinates = self._simulator.get_mutable_context(), self._coordinates
        at = context.Clone()

        def advanced(change: NDArray) -> dict[str, NDArray]:
            context.SetTimeStateAndParametersFrom(at)
            coordinates.move(context, change)
            # With this instant's events, but without those of an initialization.
            self._simulator.Initialize(InitializeParams(suppress_initialization_events=True))
            self._simulator.AdvanceTo(at.get_time() + self._sample)
            return coordinates.read(context)

        columns = [
            coordinates.difference(advanced(step), advanced(-step)) / (2 * _STEP)
            for step in _STEP * np.eye(coordinates.size)
        ]
        return np.column_stack(columns)


class _ExactMaps:
    """The same by a loop's exact derivatives.

    Args:
        coordinates: what is differentiated.
        loop: that of the diagram.
        context: at the start of a flight, each time.
    """

    def __init__(self, coordinates: "_Coordinates", loop: CompiledLoop, context: Context):
        self._coordinates, self._loop, self._context = coordinates, loop, context
        self._places = coordinates.places_in(self._loop.state_of)

    def after(self, lead: int) -> NDArray:
        """The Jacobian (k, k) of the sample after some others."""
        flight = self._loop.fly_with_derivatives(self._context)
        nothing = flight.start(np.zeros((len(flight.state), 0)))
        for _ in range(lead):
            flight.advance(nothing)
        before = self._coordinates.slopes(flight.state, self._places)
        slopes = flight.advance(before)
        after = self._coordinates.slopes(flight.state, self._places)
        return np.linalg.lstsq(after, slopes, rcond=None)[0]


class _Coordinates:
    """Small deviations of a diagram's states; that of the load's attitude is a rotation vector.

    The load's state may have another form than `load_state`, or more entries. The deviations are
    then those of the state, but for the one that changes the norm of the quaternion.

    Args:
        nonstop: the loop.
        context: at the start.
    """

    def __init__(self, nonstop: Diagram, context: Context):
        self._nonstop = nonstop
        blocks = [block for block in nonstop.GetSystems() if block.get_name() not in _EXOGENOUS]
        sizes = [len(self._values(block, context)) for block in blocks]
        self._directions: NDArray | None = None  # (states, coordinates) of a load of another form
        if _LOAD in (names := [block.get_name() for block in blocks]):
            place = names.index(_LOAD)
            self._directions = _directions(blocks[place], self._own(blocks[place], context))
            sizes[place] = (
                sizes[place] - 1 if self._directions is None else self._directions.shape[1]
            )
        ends = np.cumsum(sizes)
        self._blocks = {
            block.get_name(): (block, slice(end - size, end))
            for block, size, end in zip(blocks, sizes, ends, strict=True)
            if size > 0
        }
        self.places = {name: place for name, (_, place) in self._blocks.items()}
        self.size = int(ends[-1])

    def _own(self, block: System, context: Context) -> Context:
        return self._nonstop.GetMutableSubsystemContext(block, context)

    def _values(self, block: System, context: Context) -> NDArray:
        return state_values(self._own(block, context))

    def move(self, context: Context, change: NDArray) -> None:
        """Moves the states of a context by a small change (k,)."""
        for name, (block, place) in self._blocks.items():
            by = change[place]
            if not np.any(by):
                continue
            values = self._values(block, context)
            if name != _LOAD:
                values += by
            elif self._directions is not None:
                values += self._directions @ by
            else:
                quaternion, *others = LoadState.view(values)
                rotated = rotate_quaternion(quaternion, by[:3])
                values = np.concatenate([rotated, np.concatenate(others) + by[3:]])
            set_state_values(self._own(block, context), values)

    def places_in(self, state_of: Callable[[Context], NDArray]) -> dict[str, NDArray]:
        """Where the states of each block are in another order of all of the diagram's.

        Args:
            state_of: the states of a context in that order.
        """
        context, count = self._nonstop.CreateDefaultContext(), 2.0**40  # that no state has
        numbers = {}
        for name, (block, _) in self._blocks.items():
            size = len(self._values(block, context))
            numbers[name] = count + np.arange(size)  # each state's own
            set_state_values(self._own(block, context), numbers[name])
            count += size
        found = state_of(context)
        return {
            name: np.array([int(np.flatnonzero(found == number)[0]) for number in own])
            for name, own in numbers.items()
        }

    def slopes(self, state: NDArray, places: dict[str, NDArray]) -> NDArray:
        """The derivatives (states, k) of all states by the coordinates.

        Args:
            state: all states, in another order.
            places: of those of the blocks in it, see `places_in`.
        """
        slopes = np.zeros((len(state), self.size))
        for name, (_, place) in self._blocks.items():
            own = np.eye(place.stop - place.start)
            if name == _LOAD and self._directions is not None:
                own = self._directions
            elif name == _LOAD:
                w, x, y, z = LoadState.view(state[places[name]]).quaternion
                own = np.vstack([np.zeros(len(own)), own])  # the quaternion has an entry more
                own[:4, :3] = np.array([[-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w]]) / 2
            slopes[places[name], place] = own
        return slopes

    def read(self, context: Context) -> dict[str, NDArray]:
        """The states, an array per block."""
        return {name: self._values(block, context) for name, (block, _) in self._blocks.items()}

    def difference(self, after: dict[str, NDArray], before: dict[str, NDArray]) -> NDArray:
        """The small change (k,) that leads from one reading to another."""
        changes = []
        for name in self._blocks:
            if name != _LOAD:
                changes.append(after[name] - before[name])
                continue
            if self._directions is not None:
                changes.append(self._directions.T @ (after[name] - before[name]))
                continue
            (start, *start_others), (end, *end_others) = (
                LoadState.view(reading[name]) for reading in (before, after)
            )
            rotation = rotation_vector(quaternion_product(end, quaternion_conjugate(start)))
            changes += [rotation, np.concatenate(end_others) - np.concatenate(start_others)]
        return np.concatenate(changes)


def _directions(load: System, context: Context) -> NDArray | None:
    """Orthonormal deviations (states, coordinates) of a load's state, but for its norm's.

    None where the state is the `load_state` itself.
    """
    port = load.GetOutputPort("load_state")
    slopes = PortState(load, port).slopes(context)
    if slopes.shape[0] == slopes.shape[1] and np.allclose(slopes, np.eye(len(slopes)), atol=1e-9):
        return None
    stretched = np.zeros(len(slopes))
    LoadState.view(stretched).quaternion[:] = LoadState.view(port.Eval(context)).quaternion
    direction = np.linalg.pinv(slopes) @ stretched
    if not np.allclose(slopes @ direction, stretched, atol=1e-6):
        return np.eye(slopes.shape[1])  # the port shows no norm of a quaternion
    _, _, rows = np.linalg.svd(direction[None])
    return rows[1:].T
