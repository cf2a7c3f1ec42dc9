"""How stable the loop is around the periodic motion of its carriers while the load rests."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig
from drake_nonstop.blocks.load_feedback import NoisyFeedbackConfig
from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.blocks.phase import AccumulatedPhaseConfig
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.mechanics.rotation import cross, rotate_quaternion
from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.loading import Scenario, changed, dump_scenario, parse_scenario
from drake_nonstop.simulation.equilibrium import set_equilibrium
from drake_nonstop.simulation.simulate import stable_config
from drake_nonstop.studies.workers import worker_processes

_STEP = 1e-6  # of the differences, in SI units
_PHASES = 15  # of a turn, at which the loop is linearized
_NEUTRAL = 1 + 1e-4  # a multiplier that slow integrators come near, and rounding over
_BISECTIONS = 5
_LOAD = "load_plant"
_EXOGENOUS = ("phase", "sample_and_hold")  # states that nothing drives, or that are taken anew


@dataclass(kw_only=True)
class Stability:
    """The Floquet multipliers of the loop, and the mode that is damped least.

    A small deviation grows in one turn of the carriers by the largest magnitude of the
    `multipliers` (complex, the largest first): below 1 the loop is stable. `rate` is
    that growth in 1/s, `frequency` the rad/s that the mode swings with at the turn's start, and
    `shares` how much of it is whose motion (they add up to 1).
    """

    period: float  # s
    multipliers: NDArray
    frequency: float
    shares: dict[str, float]

    @property
    def largest(self) -> float:
        """The largest magnitude of a multiplier."""
        return float(abs(self.multipliers[0]))

    @property
    def is_stable(self) -> bool:
        """Whether small deviations decay, or stay as they are to four digits."""
        return self.largest < _NEUTRAL

    @property
    def rate(self) -> float:
        """The rate at which a deviation grows, in 1/s; negative where it decays."""
        return math.log(max(self.largest, 1e-300)) / self.period


def at_rest(scenario: Scenario) -> Scenario:
    """The scenario with a load that rests where it starts, and ξ and A constant.

    A printed phase becomes an accumulated one, which is the same while ξ is constant; there is no
    wind, and of the feedback's errors the delay alone.
    """
    feedback = scenario.load_feedback
    if isinstance(feedback, NoisyFeedbackConfig):
        feedback = NoisyFeedbackConfig(delay=feedback.delay, period=feedback.period)
    return dataclasses.replace(
        scenario,
        fused_plant=False,
        load_trajectory=RestToRestConfig(
            **_told(scenario.load_trajectory, "start_position", "start_roll_pitch_yaw")
        ),
        load_feedback=feedback,
        load_disturbance=NoDisturbanceConfig(),
        phase=AccumulatedPhaseConfig(),
        optimization_layer=ConstantParametersConfig(
            **_told(scenario.optimization_layer, "frequency", "amplitude", "speed_bound")
        ),
    )


def _told(config: Any, *names: str) -> dict[str, Any]:
    """Those of the parameters that a config, perhaps the user's own, has."""
    return {name: getattr(config, name) for name in names if hasattr(config, name)}


def linearize(scenario: Scenario) -> Stability:
    """The Floquet multipliers of a scenario's loop around the motion of a resting load.

    The loop as built, with its sampled controllers, its delays and its integrator, is taken
    from sample to sample, and differentiated at some phases of a turn; the product of
    these maps is that of a whole turn (own derivation). What has no dynamics of its own,
    the phase, is left out: its multiplier is 1 in any loop.

    Raises:
        ScenarioError: the scenario cannot be built.
    """
    resting = at_rest(scenario)
    nonstop = make_nonstop(resting)
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    sample = scenario.control_period or 0.01
    turn = 2 * math.pi / resting.optimization_layer.frequency
    samples = max(1, round(turn / sample))
    config = stable_config(resting.simulator, nonstop, context)

    coordinates = _Coordinates(nonstop)
    simulator = Simulator(nonstop, context)
    ApplySimulatorConfig(config, simulator)

    # Before each phase the loop runs from its equilibrium until whatever is late is there.
    delay = getattr(scenario.load_feedback, "delay", 0.0)
    lead = 1 + math.ceil(delay / sample - 1e-9)
    steps = []
    for phase in 2 * math.pi * np.arange(_PHASES) / _PHASES:
        _start_orbit(nonstop, context, phase - 2 * math.pi * lead / samples)
        simulator.Initialize()
        simulator.AdvanceTo(lead * sample)
        steps.append(_sample_map(coordinates, simulator, context.Clone(), sample))
    monodromy = np.eye(coordinates.size)
    for step in _interpolated(np.array(steps), samples):
        monodromy = step @ monodromy
    multipliers, vectors = np.linalg.eig(monodromy)
    order = np.argsort(-np.abs(multipliers), kind="stable")
    mode = vectors[:, order[0]]
    # How the mode goes on in the first sample tells its frequency, up to half the sample's rate.
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
    """A function of the phase at `count` even phases of a turn, given at an odd number (k, …).

    The trigonometric interpolation, which for a smooth periodic function is as good as exact.
    """
    orders = np.fft.fftfreq(len(values), 1 / len(values))
    spectrum = np.fft.fft(values, axis=0) / len(values)
    for phase in 2 * math.pi * np.arange(count) / count:
        yield np.tensordot(np.exp(1j * orders * phase), spectrum, axes=1).real


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


def _sample_map(
    coordinates: "_Coordinates", simulator: Simulator, at: Context, sample: float
) -> NDArray:
    """The Jacobian (k, k) of the map over a sample, at a context, by central differences."""
    context = simulator.get_mutable_context()

    def advanced(change: NDArray) -> dict[str, NDArray]:
        context.SetTimeStateAndParametersFrom(at)
        coordinates.move(context, change)
        # The events of this instant only, not those of a start.
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(at.get_time() + sample)
        return coordinates.read(context)

    columns = [
        coordinates.difference(advanced(step), advanced(-step)) / (2 * _STEP)
        for step in _STEP * np.eye(coordinates.size)
    ]
    return np.column_stack(columns)


class _Coordinates:
    """The deviations of a diagram's states, those of the load's attitude as a rotation vector."""

    def __init__(self, nonstop: Diagram):
        self._nonstop = nonstop
        blocks = [block for block in nonstop.GetSystems() if block.get_name() not in _EXOGENOUS]
        values = [_values(nonstop, block, nonstop.CreateDefaultContext()) for block in blocks]
        sizes = [
            len(value) - (block.get_name() == _LOAD)
            for block, value in zip(blocks, values, strict=True)
        ]
        ends = np.cumsum(sizes)
        self._blocks = {
            block.get_name(): (block, slice(end - size, end))
            for block, size, end in zip(blocks, sizes, ends, strict=True)
            if size > 0
        }
        self.places = {name: place for name, (_, place) in self._blocks.items()}
        self.size = int(ends[-1])

    def move(self, context: Context, change: NDArray) -> None:
        """Moves the states of a context by a small change (k,)."""
        for name, (block, place) in self._blocks.items():
            values = _values(self._nonstop, block, context)
            by = change[place]
            if name == _LOAD:
                values[:4] = rotate_quaternion(values[:4], by[:3])
                values[4:] += by[3:]
            else:
                values += by
            own = self._nonstop.GetMutableSubsystemContext(block, context)
            count = own.num_continuous_states()
            own.SetContinuousState(values[:count])
            for i in range(own.num_discrete_state_groups()):
                size = own.get_discrete_state(i).size()
                own.SetDiscreteState(i, values[count : count + size])
                count += size

    def read(self, context: Context) -> dict[str, NDArray]:
        """The states, an array per block."""
        return {
            name: _values(self._nonstop, block, context)
            for name, (block, _) in self._blocks.items()
        }

    def difference(self, after: dict[str, NDArray], before: dict[str, NDArray]) -> NDArray:
        """The small change (k,) that leads from one reading to another."""
        changes = []
        for name in self._blocks:
            change = after[name] - before[name]
            if name == _LOAD:
                # q̇ = ½ (0, ω) ⊗ q, the other way round; the norm of q does not matter.
                q, rate = before[name][:4], change[:4]
                vector = q[0] * rate[1:] - rate[0] * q[1:] - cross(rate[1:], q[1:])
                change = np.concatenate([2 * vector / (q @ q), change[4:]])
            changes.append(change)
        return np.concatenate(changes)


def _values(nonstop: Diagram, block: System, context: Context) -> NDArray:
    """All of a block's states in one array, the continuous ones first."""
    own = nonstop.GetSubsystemContext(block, context)
    discrete = [
        own.get_discrete_state(i).CopyToVector() for i in range(own.num_discrete_state_groups())
    ]
    return np.concatenate([own.get_continuous_state_vector().CopyToVector(), *discrete])


@dataclass(kw_only=True)
class Margin:
    """How the largest multiplier goes with one parameter.

    `values` rise; `largest` and `rates` (1/s) are those of the linearized loop there. The loop is
    stable from `low` to `high` around the `nominal` value; None where it is still so at the last
    value that was tried, and both are the nominal value where it is unstable there.
    """

    name: str
    unit: str
    nominal: float
    values: list[float]
    largest: list[float]
    rates: list[float]
    low: float | None
    high: float | None


def find_margins(
    scenario: Scenario, progress: Callable[[str, float], None] = lambda what, share: None
) -> list[Margin]:
    """The margins against carrier mass, the carriers' gains, delay and control period.

    One of them at a time is changed, in processes of their own, one per core.

    Args:
        scenario: what is changed.
        progress: called with what is being done and how much of it is done.

    Raises:
        ScenarioError: the scenario cannot be built.
    """
    axes = _axes(scenario)
    resting = dump_scenario(at_rest(scenario))  # as text, which can be sent to a process
    jobs = [(axis, value) for axis in axes for value in sorted({*axis.values, axis.nominal})]
    found: dict[str, dict[float, tuple[float, float]]] = {axis.name: {} for axis in axes}
    with worker_processes() as executor:
        futures = {
            executor.submit(_measure, resting, axis, value): (axis, value) for axis, value in jobs
        }
        for done, future in enumerate(as_completed(futures)):
            axis, value = futures[future]
            found[axis.name][value] = future.result()
            progress("linearizing", (done + 1) / len(jobs))
        edges = {
            (axis.name, side): executor.submit(_edge, resting, axis, found[axis.name], side)
            for axis in axes
            for side in (-1, 1)
        }
        for done, _ in enumerate(as_completed(edges.values())):
            progress("searching the boundaries", (done + 1) / len(edges))
        return [
            Margin(
                name=axis.name,
                unit=axis.unit,
                nominal=axis.nominal,
                values=sorted(found[axis.name]),
                largest=[found[axis.name][value][0] for value in sorted(found[axis.name])],
                rates=[found[axis.name][value][1] for value in sorted(found[axis.name])],
                low=edges[axis.name, -1].result(),
                high=edges[axis.name, 1].result(),
            )
            for axis in axes
        ]


@dataclass(kw_only=True)
class _Axis:
    """A parameter: how to set it (a format of the value), and where to look at it."""

    name: str
    unit: str
    setting: str
    nominal: float
    values: list[float]
    is_continuous: bool = True


_CONTROLLER_PARAMETERS = (
    ("position_gain", "K_p", "N/m"),
    ("velocity_gain", "K_d", "N s/m"),
    ("frequency", "carrier frequency", "rad/s"),
    ("damping", "carrier damping", "of critical"),
)


def _axes(scenario: Scenario) -> list[_Axis]:
    sample = scenario.control_period or 0.01
    controller = scenario.carrier_controller
    factors = np.geomspace(1 / 8, 8, 13)
    axes = [
        _Axis(
            name=name,
            unit=unit,
            setting=setting,
            nominal=nominal,
            values=(nominal * factors).tolist(),
        )
        for name, unit, setting, nominal in (
            (
                "carrier mass",
                "kg",
                "simulated.carrier_mass={}",
                overridden(scenario.system, scenario.simulated).carrier_mass,
            ),
            *(
                (name, unit, f"carrier_controller.{field}={{}}", getattr(controller, field))
                for field, name, unit in _CONTROLLER_PARAMETERS
                if hasattr(controller, field)
            ),
        )
        if nominal > 0
    ]
    feedback, late = scenario.load_feedback, "load_feedback.delay={}"
    if not isinstance(feedback, NoisyFeedbackConfig):
        feedback = NoisyFeedbackConfig(period=sample)
        late = f"load_feedback=!NoisyFeedback {{{{delay: {{}}, period: {sample}}}}}"
    return [
        *axes,
        _Axis(
            name="delay",
            unit="s",
            setting=late,
            nominal=feedback.delay,
            values=[k * sample for k in range(9)],
            is_continuous=False,
        ),
        _Axis(
            name="control period",
            unit="s",
            setting="control_period={}",
            nominal=scenario.control_period,
            values=[0.0, 0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04],
        ),
    ]


def _measure(resting: str, axis: _Axis, value: float) -> tuple[float, float]:
    """The largest multiplier's magnitude, and the rate, with a parameter's value."""
    scenario = parse_scenario(resting, trust=True)  # as the one that it is a copy of
    found = linearize(changed(scenario, [axis.setting.format(value)]))
    return found.largest, found.rate


def _edge(
    resting: str, axis: _Axis, found: dict[float, tuple[float, float]], side: int
) -> float | None:
    """The value at which the loop loses its stability, below (-1) or above (1) the nominal one."""
    inside = axis.nominal
    if found[inside][0] >= _NEUTRAL:
        return inside
    for value in sorted(found)[::side]:
        if side * (value - inside) <= 0:
            continue
        if found[value][0] < _NEUTRAL:
            inside = value
            continue
        outside = value
        for _ in range(_BISECTIONS if axis.is_continuous and inside > 0 else 0):
            middle = math.sqrt(inside * outside)
            if _measure(resting, axis, middle)[0] < _NEUTRAL:
                inside = middle
            else:
                outside = middle
        return inside
    return None
