"""How a disturbance of 1 mm grows in a flight, beside what is predicted of its formation."""

import math

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import PlantStates, set_equilibrium
from drake_nonstop.loop.step import with_step
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.stability import at_rest
from drake_nonstop.systems.tracing import NotFiniteError

DISTURBANCE = 1e-3  # m
_LARGEST = 0.1  # of the radius of the attachments, up to which deviations count as small
_PER_TURN = 8
_STEP = 2.5e-4  # s; a longer one damps the load's fast rotation on its cables


def deviations(scenario: Scenario, duration: float) -> tuple[NDArray, NDArray]:
    """How far apart two flights are at times (k,), s: one begins with a load that is 1 mm off.

    The distance (k,), m, is that of positions and of attitudes times the attachments' radius. The
    flights end where it is no longer small.
    """
    nonstop = make_nonstop(scenario, at_equilibrium=False)
    simulators = []
    for by in (0.0, DISTURBANCE):
        context = nonstop.CreateDefaultContext()
        set_equilibrium(nonstop, context)
        load = nonstop.GetOutputPort("load_state").Eval(context).copy()
        LoadState.view(load).position[:] += by / math.sqrt(3)
        PlantStates(nonstop).set_states(context, load_state=load)
        simulator = Simulator(nonstop, context)
        step = min(_STEP, scenario.simulator_config.max_step_size)
        ApplySimulatorConfig(with_step(scenario.simulator_config, step), simulator)
        simulator.Initialize()
        simulators.append(simulator)
    radius = float(np.linalg.norm(np.array(scenario.system.attachments), axis=1).max())
    turn = 2 * math.pi / scenario.optimization_layer.frequency
    times, distances = [], []
    for time in np.arange(turn, duration * _PER_TURN, turn) / _PER_TURN:
        try:
            for simulator in simulators:
                simulator.AdvanceTo(time)
        except NotFiniteError:
            break
        one, other = (
            LoadState.view(nonstop.GetOutputPort("load_state").Eval(simulator.get_context()))
            for simulator in simulators
        )
        attitudes = 2 * radius * (one.quaternion - other.quaternion)
        distance = np.linalg.norm(np.concatenate([one.position - other.position, attitudes]))
        times.append(time)
        distances.append(float(distance))
        if distance > _LARGEST * radius:
            break
    return np.array(times), np.array(distances)


def measured_rate(scenario: Scenario, duration: float = 20.0) -> float:
    """The rate, 1/s, at which the disturbance grows in the end while the load rests.

    It is that over the last half of the time, in whole turns where there are any.
    """
    times, distances = deviations(at_rest(scenario), duration)
    half = len(times) // 2
    back = max(half - half % _PER_TURN, min(half, _PER_TURN))
    return float(np.log(distances[-1] / distances[-1 - back]) / (times[-1] - times[-1 - back]))


def measured_growth(scenario: Scenario) -> float:
    """The logarithm of how many times the disturbance grows on the way, from any turn on."""
    _, distances = deviations(scenario, scenario.simulation_duration)
    logarithms = np.log(distances)
    return float(np.max(logarithms - np.minimum.accumulate(logarithms)))
