"""Floquet analysis of the loop around the carriers' periodic motion while the load rests."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.analysis.stated_errors import without_noise
from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig
from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.blocks.observed_carrier_trajectory import (
    OBSERVER_RATES,
    ObservedCarrierTrajectoryConfig,
)
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.blocks.phase import AccumulatedPhaseConfig
from drake_nonstop.diagrams.nonstop import BOXES, SAMPLE_AND_HOLD, box_of, make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.mechanics.rotation import quaternion_rate
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.mechanics.tuning import correction_rate
from drake_nonstop.model.block import AUTO
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.validation import ScenarioError, require

_PHASES = 15  # of a turn, at which the loop is linearized
_AT_ONCE = 64  # maps that are interpolated, so few that they stay in a core's cache
NEUTRAL = 1 + 1e-4  # above the multipliers of slow integrators, with rounding
_CHANGES_OF_WIND = ("start_time", "rise_time")  # fields of its blocks
_LOAD = box_of("load_state")
# Rates with which loops of the shipped scenarios are stable: of corrections over those that are
# "auto", of observers in 1/s.
_KNOWN_SHARE, _KNOWN_RATE = 3.0, 2.0
# Usual values of what may make a loop unstable, in the order in which they are tried.
_USUAL: dict[str, Any] = {
    **{
        f"carrier_trajectory.{name}": getattr(ObservedCarrierTrajectoryConfig, name)
        for name in OBSERVER_RATES
    },
    "carrier_trajectory.correction_rates": AUTO,
    "load_feedback.measures_attitude": True,
}
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
    cause: str = ""  # a sentence on the field that makes the loop unstable, if one is known

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


def explained_stability(
    scenario: Scenario, is_lost: bool, progress: Callable[[str, float], None]
) -> Stability | None:
    """Returns `linearize` of drawn numbers with the field to blame as its `cause`, or None.

    It is None unless the load was lost, or references are corrected, or cables observed, faster
    than is known to be stable. Cables have two nodes at most, whose derivatives take seconds.
    """
    config, system = scenario.carrier_trajectory, scenario.system
    known = _KNOWN_SHARE * correction_rate(system.cable_length, system.gravity)
    rates: Any = getattr(config, "correction_rates", AUTO)
    observers = [getattr(config, name, 0.0) for name in OBSERVER_RATES]
    is_fast = max(observers) > _KNOWN_RATE or (rates != AUTO and max(rates) > known)
    if not is_fast and (hasattr(scenario.cables, "nodes") or not is_lost):
        return None
    for name in ("cables", "carrier_trajectory"):
        if hasattr(config := getattr(scenario, name), "nodes"):
            few = dataclasses.replace(config, nodes=min(config.nodes, 2))
            scenario = dataclasses.replace(scenario, **{name: few})
    found = linearize(scenario, progress)
    for path, usual in _USUAL.items():
        box, _, name = path.partition(".")
        stated = getattr(getattr(scenario, box), name, usual)
        if found.is_stable or stated == usual:
            continue
        other = linearize(changed(scenario, [as_override(path, usual)]))
        if other.is_stable:
            found.cause = (
                f"{as_override(path, stated).replace('=', ' = ')}: about the load at rest a small "
                f"deviation grows, {found.rate:+.2g} 1/s; give {dump_plain(usual, path)}, with "
                f"which it decays, {other.rate:+.2g} 1/s"
            )
            break
    return found


def at_rest(scenario: Scenario) -> Scenario:
    """The scenario with a load at rest in its first pose, and constant ξ and A.

    The paper's phase becomes an accumulated one, which is the same while ξ is constant; there is
    no disturbance, the wind is steady, and the feedback has no error but its delay.

    Raises:
        ScenarioError: the load of the scenario turns all the time.
    """
    require(
        not hasattr(scenario.load_trajectory, "yaw_rate"),
        "load_trajectory",
        "SteadyTurn",
        "this study is about a load at rest; give RestToRest, and a pattern with orbits",
    )
    quiet = without_noise(scenario)
    wind: Any = quiet.wind
    changing = [name for name in _CHANGES_OF_WIND if hasattr(wind, name)]
    return dataclasses.replace(
        quiet,
        load_trajectory=RestToRestConfig(
            **_parameters(scenario.load_trajectory, "start_position", "start_roll_pitch_yaw")
        ),
        load_disturbance=NoDisturbanceConfig(),
        wind=dataclasses.replace(wind, **dict.fromkeys(changing, 0.0)) if changing else wind,
        phase=AccumulatedPhaseConfig(),
        optimization_layer=ConstantParametersConfig(
            **_parameters(scenario.optimization_layer, "frequency", "amplitude", "speed_bound")
        ),
    )


def _parameters(config: Any, *names: str) -> dict[str, Any]:
    """Names of parameters that a config, perhaps of the user's own block, has."""
    return {name: getattr(config, name) for name in names if hasattr(config, name)}


def linearize(
    scenario: Scenario, progress: Callable[[str, float], None] = lambda what, share: None
) -> Stability:
    """The Floquet multipliers of a scenario's loop around the motion of a resting load.

    They have the attributes that `drake-nonstop stability` prints: `largest`, `is_stable`, and the
    growth `rate` in 1/s of the least stable mode.

    The compiled loop is differentiated, with its sampled controllers, delays and integrator. The
    map from one sample to the next is found at some phases of a turn and interpolated between
    them; the product of these Jacobians is the map of a whole turn (own derivation). The phase is
    left out: its multiplier is 1 in any loop.

    Args:
        scenario: of the loop.
        progress: called with a description of the task and the share of it that is done.

    Raises:
        ScenarioError: the scenario cannot be built, or its loop cannot be compiled.
    """
    from scipy.linalg import block_diag  # here: the import takes 0.2 s, which runs do not need

    check(scenario)
    scenario = scenario.sampled()
    resting = at_rest(scenario)
    nonstop = make_nonstop(resting, at_equilibrium=False)
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    sample = scenario.control_period
    config = with_largest_step(resting.simulator_config, nonstop, context)
    reason = reason_against(nonstop, config, sample)
    if reason:
        raise ScenarioError(f"stability = unknown: only a compiled loop has derivatives; {reason}")
    loop = CompiledLoop(nonstop, config, sample, signals=(), compiles=False)
    if loop.blocks_without_derivatives:
        names = ", ".join(loop.blocks_without_derivatives)
        raise ScenarioError(f"stability = unknown: the answers of {names} have no derivatives")
    turn = 2 * math.pi / resting.optimization_layer.frequency
    samples = max(1, round(turn / sample))
    places = _places(nonstop, loop)
    own = {name: np.eye(len(numbers)) for name, numbers in places.items()}
    own[_LOAD] = _load_deviations(nonstop, context, len(places[_LOAD]))
    chosen = np.concatenate([*places.values()])

    # Before each phase the loop runs from its equilibrium until the delays are filled. Sampled
    # states step from the second sample on.
    delay = getattr(scenario.load_feedback, "delay", 0.0)
    lead = 2 + math.ceil(delay / sample - 1e-9)
    maps = []
    for k in range(_PHASES):
        progress("linearizing", k / _PHASES)
        phase = 2 * math.pi * k / _PHASES
        _start_orbit(nonstop, context, phase - 2 * math.pi * lead / samples)
        flight = loop.fly(context)
        flight.fly(lead)
        maps.append(flight.map_jacobian()[np.ix_(chosen, chosen)])
    deviations = block_diag(*own.values())
    back = np.linalg.pinv(deviations)
    turn_map = back @ map_of_turn(np.stack(maps), samples) @ deviations
    multipliers, vectors = np.linalg.eig(turn_map)
    order = np.argsort(-np.abs(multipliers), kind="stable")
    mode = vectors[:, order[0]]
    # The mode's change in the first sample gives its frequency, up to half the sampling rate.
    after_a_sample = np.vdot(mode, back @ maps[0] @ deviations @ mode)
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


def map_of_turn(maps: NDArray, samples: int) -> NDArray:
    """The map (s, s) of a turn of so many samples, of maps (k, s, s) of one at even phases of it.

    Its eigenvalues are the Floquet multipliers. Between the phases the maps are interpolated by
    trigonometric polynomials, whose error for a smooth function is near rounding.
    """
    count, turn = len(maps), np.eye(maps.shape[1])
    spectrum = np.fft.rfft(np.eye(count), axis=0) / count
    orders = np.arange(len(spectrum))
    weights = np.where((orders == 0) | (2 * orders == count), 1.0, 2.0)
    for start in range(0, samples, _AT_ONCE):
        turns = np.arange(start, min(start + _AT_ONCE, samples)) / samples
        waves = np.exp(2j * np.pi * np.outer(turns, orders)) * weights
        steps = (waves @ spectrum).real @ maps.reshape(count, -1)
        for step in steps.reshape(len(turns), *maps.shape[1:]):
            turn = step @ turn
    return turn


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


def _places(nonstop: Diagram, loop: CompiledLoop) -> dict[str, NDArray]:
    """Where the states of each block that are perturbed are among those of the loop."""
    context, places = nonstop.CreateDefaultContext(), {}
    for block in nonstop.GetSystems():
        own = nonstop.GetMutableSubsystemContext(block, context)
        count = len(state_values(own))
        if count > 0 and block.get_name() not in _EXOGENOUS:
            numbers = 2.0**40 + np.arange(count)  # each state's own, that no state has
            set_state_values(own, numbers)
            found = loop.state_of(context)
            places[block.get_name()] = np.array([np.flatnonzero(found == n)[0] for n in numbers])
            set_state_values(own, np.zeros(count))
    return places


def _load_deviations(nonstop: Diagram, context: Context, count: int) -> NDArray:
    """Deviations (count, count - 1) of the load's state: its quaternion's norm has none."""
    load = nonstop.GetOutputPort("load_state").Eval(context)
    quaternion = LoadState.view(load).quaternion
    deviations = np.zeros((count, count - 1))
    deviations[:4, :3] = np.transpose([quaternion_rate(quaternion, axis) for axis in np.eye(3)])
    deviations[4:, 3:] = np.eye(count - 4)
    return deviations
