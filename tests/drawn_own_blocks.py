"""Drawn blocks of a user's own: equations with states, periods, quantities and the time."""

import dataclasses
import warnings
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from drake_nonstop import Block, ScenarioWarning, load_scenario, simulate

PERIOD = 0.01  # s, of the controllers
READS = "reference", "measured_load_state", "load_state", "carrier_state", "parameters"
BOXES: dict[str, dict[str, list[float]]] = {  # what each makes, where nothing happens
    "optimization_layer": {"parameters": [2.0, 1.2]},
    "wrench_controller": {"wrench": [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], "wrench_rate": [0.0] * 6},
    "load_disturbance": {"disturbance_wrench": [0.0] * 6},
}


@dataclasses.dataclass
class OwnConfig:
    """Its one parameter."""

    gain: float = 0.1


def squashed(values):
    """A number (1,) below 1 that all entries move."""
    return np.tanh(np.sum(values, keepdims=True))


class Own(Block):
    """Outputs near those at rest, which a state of three numbers moves; members are drawn."""

    period = 0.0  # s, of a sampled state
    keeps_state = has_quantity = False

    def state(self, model):
        return np.array([0.1, 0.0, -0.1]) if self.keeps_state else None

    def constants(self, model, config):
        return {"own": type(self)}

    def step_period(self, model, config):
        return self.period

    def quantities(self, model):
        return {"hum": 2} if self.has_quantity else {}

    def precomputed_inputs(self, names, times):
        return [np.stack([np.sin(40 * times), np.cos(30 * times)], axis=1) for _ in names]

    @staticmethod
    def equations(*given, own, gain):
        given = [*given]
        state = given.pop(0) if own.keeps_state else np.zeros(3)
        time = given.pop() if own.reads_time else np.zeros(1)
        moved = gain * np.sum(state, keepdims=True) + 0.1 * gain * np.sin(9 * time)
        read = sum((gain * squashed(values) for values in given), start=np.zeros(1))
        rests = [BOXES[own.drawn_box][name] for name in own.makes]
        outputs = [np.concatenate([r + 0.1 * (moved + read) for r in rest]) for rest in rests]
        if not own.keeps_state:
            return tuple(outputs)
        change = np.concatenate([read, np.sin(7 * time), np.zeros(1)]) - 2 * state
        return state + 0.01 * change if own.makes_next_state else change, *outputs


def start(*given, own, gain):
    """The state at the start of a run."""
    total = sum(map(squashed, given[1 : 1 + len(own.reads)]), start=np.zeros(1))
    return np.concatenate([0.2 + gain * total, [0.1, 0.0]])


class Plain(LeafSystem):
    """One without equations."""

    def __init__(self, box: str):
        super().__init__()
        for name, rest in BOXES[box].items():
            self.DeclareVectorOutputPort(
                name, len(rest), lambda context, output, r=rest: output.SetFromVector(r)
            )


def drawn(seed: int) -> tuple[str, Any]:
    """The box and the block of a seed."""
    rng = np.random.default_rng([34, seed])

    def one(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    box, state = one(*BOXES), one("continuous", "sampled", "none")
    feeds_back = ("carrier_state", "parameters") if box != "load_disturbance" else ()
    fitting = [name for name in READS if name not in (*BOXES[box], *feeds_back)]
    if rng.random() < 0.15:
        return box, lambda model: Plain(box)
    members: dict[str, Any] = {
        "__module__": __name__,
        "drawn_box": box,
        "makes": tuple(BOXES[box]),
        "reads": tuple(sorted({one(*fitting) for _ in range(rng.integers(0, 3))})),
        "keeps_state": state != "none",
        "is_sampled": state != "continuous",
        "period": one(PERIOD, PERIOD, 2 * PERIOD, 3 * PERIOD, 0.007) * (state == "sampled"),
        "reads_time": one(True, False),
        "has_quantity": one(True, False),
        "start": one(True, False),
        "makes_next_state": one(True, False) and state == "sampled",
    }
    if members.pop("start") and state != "none":
        members["start"] = staticmethod(start)
    return box, type("OwnBlock", (Own,), members)


def compare(seed: int) -> tuple[float, str]:
    """The largest difference of a signal between the engines, and why the diagram was simulated.

    Where that is empty the compiled loop has flown all of it.
    """
    box, block = drawn(seed)
    overrides = ["simulation_duration=0.3", "load_trajectory.start_time=0"]
    if box != "optimization_layer":
        overrides.append("optimization_layer=ConstantParameters")
    scenario = load_scenario("quintic", overrides)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        runs = [simulate(scenario, engine=each, **{box: block}) for each in ("diagram", "compiled")]
    worst = 0.0
    for of_one, of_other in zip(*((run.signals, run.steps) for run in runs), strict=True):
        for name, values in of_one.items():
            if not name.endswith("solve_time"):
                difference = np.abs(of_other[name] - values).max(initial=0.0)
                worst = max(worst, float(difference / (1 + np.abs(values).max(initial=0.0))))
    kind, _, reason = runs[1].engine.partition(": ")
    return worst, "" if kind == "compiled" else reason
