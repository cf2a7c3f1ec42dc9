"""Floquet analysis of the loop around the carriers' periodic motion while the load rests."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
)
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.analysis.sampled_maps import map_of_turn
from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig
from drake_nonstop.blocks.load_feedback import MeasurementConfig
from drake_nonstop.blocks.load_trajectory import RestToRestConfig, SteadyTurnConfig
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.blocks.phase import AccumulatedPhaseConfig
from drake_nonstop.blocks.wind import GustyWindConfig, SteadyWindConfig
from drake_nonstop.blocks.wind_estimator import LoadAnemometerConfig, WindObserverConfig
from drake_nonstop.diagrams.nonstop import BOXES, SAMPLE_AND_HOLD, box_of, make_nonstop
from drake_nonstop.loop.start import port_slopes, set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.mechanics.rotation import quaternion_rate
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, LoadState
from drake_nonstop.planning.problem_config import with_fields_of
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.studies.run_all import Progress, no_progress
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.validation import require

_NOISES = ("position_noise", "orientation_noise", "velocity_noise", "angular_velocity_noise")
_STEP = 1e-6  # of differences, in SI units
_PHASES = 15  # of a turn, at which the loop is linearized
_SMALLEST = 1e-6  # of the largest singular value: what a port does not show
NEUTRAL = 1 + 1e-4  # above the multipliers of slow integrators, with rounding
_CHANGES_OF_WIND = ("start_time", "rise_time")  # fields of its blocks
_LOAD = box_of("load_state")
# Whose states are not perturbed.
_EXOGENOUS = [name for name, box in BOXES.items() if not box.is_linearized]


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
        quiet: dict[str, Any] = dict.fromkeys(_NOISES, 0.0)
        feedback = dataclasses.replace(feedback, **quiet, seed=0)
    estimator = scenario.wind_estimator
    if isinstance(estimator, WindObserverConfig):
        estimator = dataclasses.replace(estimator, airspeed_noise=0.0)
    elif isinstance(estimator, LoadAnemometerConfig):
        estimator = dataclasses.replace(estimator, noise=0.0, airspeed_noise=0.0)
    return dataclasses.replace(
        scenario,
        load_trajectory=RestToRestConfig(
            **_parameters(scenario.load_trajectory, "start_position", "start_roll_pitch_yaw")
        ),
        load_feedback=feedback,
        load_disturbance=NoDisturbanceConfig(),
        wind=_steady(scenario.wind),
        wind_estimator=estimator,
        phase=AccumulatedPhaseConfig(),
        optimization_layer=ConstantParametersConfig(
            **_parameters(scenario.optimization_layer, "frequency", "amplitude", "speed_bound")
        ),
    )


def _steady(wind: Any) -> Any:
    """The wind without gusts, risen from the beginning on."""
    if isinstance(wind, GustyWindConfig):
        wind = with_fields_of(SteadyWindConfig, wind)
    changing = [name for name in _CHANGES_OF_WIND if hasattr(wind, name)]
    return dataclasses.replace(wind, **dict.fromkeys(changing, 0.0)) if changing else wind


def _parameters(config: Any, *names: str) -> dict[str, Any]:
    """Names of parameters that a config, perhaps of the user's own block, has."""
    return {name: getattr(config, name) for name in names if hasattr(config, name)}


def linearize(scenario: Scenario, progress: Progress = no_progress) -> Stability:
    """The Floquet multipliers of a scenario's loop around the motion of a resting load.

    The loop is simulated as it is, with its sampled controllers, delays and integrator. The map
    from one sample to the next is differentiated at some phases of a turn and interpolated
    between them; the product of these Jacobians is the map of a whole turn (own derivation).
    The derivatives are exact where the loop can be compiled, and central differences of its
    diagram elsewhere. The phase is left out: its multiplier is 1 in any loop.

    Args:
        scenario: of the loop.
        progress: called with a description and the share that is done.

    Raises:
        ScenarioError: the scenario cannot be built.
    """
    from scipy.linalg import block_diag  # here: the import takes 0.2 s, which runs do not need

    check(scenario)
    scenario = scenario.sampled()
    resting = at_rest(scenario)
    nonstop = make_nonstop(resting, at_equilibrium=False)
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    sample = scenario.control_period or 0.01
    turn = 2 * math.pi / resting.optimization_layer.frequency
    samples = max(1, round(turn / sample))
    config = with_largest_step(resting.simulator_config, nonstop, context)

    states = _States(nonstop)
    own = states.deviations(context)
    loop = None
    if not reason_against(nonstop, config, sample):
        loop = CompiledLoop(nonstop, config, sample, signals=(), compiles=False)

    # Before each phase the loop runs from its equilibrium until the delays are filled. Sampled
    # states step from the second sample on.
    delay = getattr(scenario.load_feedback, "delay", 0.0)
    lead = 2 + math.ceil(delay / sample - 1e-9)
    steps = []
    for k in range(_PHASES):
        progress("linearizing", k / _PHASES)
        phase = 2 * math.pi * k / _PHASES
        _start_orbit(nonstop, context, phase - 2 * math.pi * lead / samples)
        if loop and not loop.blocks_without_derivatives:
            steps.append(_exact_map(states, loop, context, lead))
        else:
            simulator = Simulator(nonstop, context)
            ApplySimulatorConfig(config, simulator)
            steps.append(_differenced_map(states, simulator, lead, sample))
    deviations = block_diag(*own.values())
    back = np.linalg.pinv(deviations)
    turn_map = back @ map_of_turn(np.stack(steps), samples) @ deviations
    multipliers, vectors = np.linalg.eig(turn_map)
    order = np.argsort(-np.abs(multipliers), kind="stable")
    mode = vectors[:, order[0]]
    # The mode's change in the first sample gives its frequency, up to half the sampling rate.
    after_a_sample = np.vdot(mode, back @ steps[0] @ deviations @ mode)
    weights = np.abs(mode) ** 2
    ends = np.cumsum([matrix.shape[1] for matrix in own.values()])
    parts = np.split(weights / weights.sum(), ends[:-1])
    shares = {name: float(part.sum()) for name, part in zip(own, parts, strict=True)}
    held = shares.pop(SAMPLE_AND_HOLD, 0.0)  # what other blocks showed a sample before
    shares = {name: share / (1 - held) for name, share in shares.items()}
    return Stability(
        period=samples * sample,
        multipliers=multipliers[order],
        frequency=float(abs(np.angle(after_a_sample)) / sample),
        shares=shares,
    )


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


def _differenced_map(states: "_States", simulator: Simulator, lead: int, sample: float) -> NDArray:
    """The Jacobian (k, k) of the map over a sample (s) after some others, by central differences.

    The simulator's context is at the start of a flight.
    """
    simulator.Initialize()
    simulator.AdvanceTo(lead * sample)
    context = simulator.get_mutable_context()
    at = context.Clone()
    values = states.read(at)

    def advanced(change: NDArray) -> NDArray:
        context.SetTimeStateAndParametersFrom(at)
        states.write(context, values + change)
        # With this instant's events, but without those of an initialization.
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(at.get_time() + sample)
        return states.read(context)

    steps = _STEP * np.eye(states.size)
    return np.column_stack([(advanced(step) - advanced(-step)) / (2 * _STEP) for step in steps])


def _exact_map(states: "_States", loop: CompiledLoop, context: Context, lead: int) -> NDArray:
    """The same by a loop's exact derivatives, from a context at the start of a flight."""
    places, flight = states.places_in(loop), loop.fly(context)
    flight.fly(lead)
    return flight.map_jacobian()[np.ix_(places, places)]


class _States:
    """The states that are perturbed, of one block after the other."""

    def __init__(self, nonstop: Diagram):
        self._nonstop = nonstop
        context = nonstop.CreateDefaultContext()
        blocks = [block for block in nonstop.GetSystems() if block.get_name() not in _EXOGENOUS]
        counts = [len(state_values(self._own(block, context))) for block in blocks]
        self._counts = {block: n for block, n in zip(blocks, counts, strict=True) if n > 0}
        self.size = sum(counts)

    def _own(self, block: System, context: Context) -> Context:
        return self._nonstop.GetMutableSubsystemContext(block, context)

    def read(self, context: Context) -> NDArray:
        """The states (size,) in a context of the loop."""
        return np.concatenate([state_values(self._own(block, context)) for block in self._counts])

    def write(self, context: Context, values: NDArray) -> None:
        """Sets them in a context of the loop."""
        parts = np.split(values, np.cumsum([*self._counts.values()])[:-1])
        for block, part in zip(self._counts, parts, strict=True):
            set_state_values(self._own(block, context), part)

    def places_in(self, loop: CompiledLoop) -> list[int]:
        """Where each state is among those of a loop."""
        context = self._nonstop.CreateDefaultContext()
        numbers = 2.0**40 + np.arange(self.size)  # each state's own, that no state has
        self.write(context, numbers)
        found = loop.state_of(context)
        return [int(np.flatnonzero(found == number)[0]) for number in numbers]

    def deviations(self, context: Context) -> dict[str, NDArray]:
        """Each block's deviations (states, coordinates): of all of its states but one.

        Those of the load's are a rotation vector and the changes of what else `load_state` shows,
        and orthonormal ones of what it does not show; its quaternion's norm has none.
        """
        return {
            block.get_name(): (
                _load_deviations(block, self._own(block, context))
                if block.get_name() == _LOAD
                else np.eye(count)
            )
            for block, count in self._counts.items()
        }


def _load_deviations(load: System, context: Context) -> NDArray:
    from scipy.linalg import block_diag, null_space  # likewise

    port = load.GetOutputPort("load_state")
    quaternion = LoadState.view(port.Eval(context)).quaternion
    rotations = [quaternion_rate(quaternion, axis) for axis in np.eye(3)]
    shown = block_diag(np.transpose(rotations), np.eye(LOAD_STATE_SIZE - 4))
    slopes = port_slopes(port, context)
    hidden = null_space(slopes, rcond=_SMALLEST)
    return np.hstack([np.linalg.pinv(slopes, rcond=_SMALLEST) @ shown, hidden])
