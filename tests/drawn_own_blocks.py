"""Drawn blocks of a user's own: equations with states, periods, quantities and the time."""

import dataclasses
import warnings
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from drake_nonstop import Block, ScenarioWarning, load_scenario, simulate
from drake_nonstop.run.compiled_run import NOT_COMPILED

PERIOD = 0.01  # s, of the controllers
READS = "reference", "measured_load_state", "load_state", "carrier_state", "parameters"
BOXES: dict[str, dict[str, list[float]]] = {  # what each makes, where nothing happens
    "optimization_layer": {"parameters": [2.0, 1.2]},
    "wrench_controller": {"wrench": [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], "wrench_rate": [0.0] * 6},
    "load_disturbance": {"disturbance_wrench": [0.0] * 6},
}


@dataclasses.dataclass
class Draw:
    """What a block is."""

    box: str
    reads: tuple[str, ...]
    state: str  # continuous, sampled or none
    period: float  # s, of a sampled state
    reads_time: bool
    has_quantity: bool
    has_start: bool
    makes_next_state: bool
    has_equations: bool  # or it is a LeafSystem


def drawn(seed: int) -> Draw:
    """The block of a seed."""
    rng = np.random.default_rng([34, seed])

    def one(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    box = one(*BOXES)
    state = one("continuous", "sampled", "none")
    feeds_back = ("carrier_state", "parameters") if box != "load_disturbance" else ()
    fitting = [name for name in READS if name not in (*BOXES[box], *feeds_back)]
    is_plain = rng.random() < 0.15
    return Draw(
        box=box,
        reads=tuple(sorted({one(*fitting) for _ in range(rng.integers(0, 3))})),
        state=state,
        period=one(PERIOD, PERIOD, 2 * PERIOD, 3 * PERIOD, 0.007),
        reads_time=one(True, False),
        has_quantity=one(True, False),
        has_start=one(True, False),
        makes_next_state=one(True, False),
        has_equations=not is_plain,
    )


@dataclasses.dataclass
class OwnConfig:
    """Its one parameter."""

    gain: float = 0.1


def squashed(values):
    """A number (1,) below 1 that all entries move."""
    return np.tanh(np.sum(values, keepdims=True))


class Own(Block):
    """The block of a draw: outputs near those at rest, which a state of three numbers moves."""

    draw: Draw

    def state(self, model):
        return None if self.draw.state == "none" else np.array([0.1, 0.0, -0.1])

    def constants(self, model, config):
        return {"draw": self.draw}

    def step_period(self, model, config):
        return self.draw.period if self.draw.state == "sampled" else 0.0

    def quantities(self, model):
        return {"hum": 2} if self.draw.has_quantity else {}

    def precomputed_inputs(self, names, times):
        return [np.stack([np.sin(40 * times), np.cos(30 * times)], axis=1) for _ in names]

    @staticmethod
    def equations(*given, draw, gain):
        given = [*given]
        state = given.pop(0) if draw.state != "none" else np.zeros(3)
        time = given.pop() if draw.reads_time else np.zeros(1)
        moved = gain * np.sum(state, keepdims=True) + 0.1 * gain * np.sin(9 * time)
        read = sum((gain * squashed(values) for values in given), start=np.zeros(1))
        shift = 0.1 * (moved + read)
        outputs = [np.concatenate([r + shift for r in rest]) for rest in BOXES[draw.box].values()]
        if draw.state == "none":
            return tuple(outputs)
        change = np.concatenate([read, np.sin(7 * time), np.zeros(1)]) - 2 * state
        return state + 0.01 * change if draw.makes_next_state else change, *outputs


def start(*given, draw, gain):
    """The state at the start of a run."""
    reads = given[1 : 1 + len(draw.reads)]
    total = sum(map(squashed, reads), start=np.zeros(1))
    return np.concatenate([0.2 + gain * total, [0.1, 0.0]])


class Plain(LeafSystem):
    """One without equations."""

    def __init__(self, draw: Draw):
        super().__init__()
        for name, rest in BOXES[draw.box].items():
            self.DeclareVectorOutputPort(
                name, len(rest), lambda context, output, r=rest: output.SetFromVector(r)
            )


def own_block(draw: Draw, model: Any) -> Any:
    """The block of a draw."""
    if not draw.has_equations:
        return Plain(draw)
    members: dict[str, Any] = {
        "__module__": __name__,
        "draw": draw,
        "reads": draw.reads,
        "makes": tuple(BOXES[draw.box]),
        "is_sampled": draw.state == "sampled" or draw.state == "none",
        "reads_time": draw.reads_time,
        "makes_next_state": draw.makes_next_state and draw.state == "sampled",
    }
    draw.makes_next_state = members["makes_next_state"]
    if draw.has_start and draw.state != "none":
        members["start"] = staticmethod(start)
    if draw.state == "continuous":
        members["state"] = Own.state
    return type("OwnBlock", (Own,), members)(model)


def compare(seed: int) -> tuple[float, str]:
    """The largest difference of a signal between the engines, and how the block was named.

    Where that is empty the compiled loop has flown all of it.
    """
    draw = drawn(seed)
    overrides = ["simulation_duration=0.3", "load_trajectory.start_time=0"]
    if draw.box != "optimization_layer":
        overrides.append("optimization_layer=ConstantParameters")
    scenario = load_scenario("quintic", overrides)
    replaced: dict[str, Any] = {draw.box: lambda model: own_block(draw, model)}
    runs, told = [], []
    for engine in ("diagram", "compiled"):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", ScenarioWarning)
            run = simulate(scenario, engine=engine, **replaced)
        runs.append(run)
        told += [text for w in found if (text := str(w.message)).startswith(NOT_COMPILED)]
    worst = 0.0
    for of_one, of_other in zip(*((run.signals, run.steps) for run in runs), strict=True):
        for name, values in of_one.items():
            if not name.endswith("solve_time"):
                difference = np.abs(of_other[name] - values).max(initial=0.0)
                worst = max(worst, float(difference / (1 + np.abs(values).max(initial=0.0))))
    assert len(told) <= 1, told
    return worst, "".join(told)
