"""Drawn blocks of a user's own: states, inputs, events, declarations true and false, and traces.

`python tests/drawn_own_blocks.py 100` flies that many with both engines, and tells what became of
each: flown by the compiled loop, or named and flown by the diagram; and the largest difference.
"""

import dataclasses
import sys
import warnings
from collections import Counter
from typing import Any

import numpy as np
from casadi import sin, tanh
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    RunStopped,
    ScenarioError,
    ScenarioWarning,
    StepCheck,
    load_scenario,
    simulate,
)
from drake_nonstop.simulation.compiled_run import NOT_COMPILED

REFUSED = "no engine flies it"
PERIOD = 0.01  # s, of the controllers
SIZES = {
    "reference": 22,
    "measured_load_state": 13,
    "load_state": 13,
    "carrier_state": 24,
    "wrench": 6,
    "parameters": 2,
}
BOXES: dict[str, dict[str, list[float]]] = {  # what each makes, where nothing happens
    "optimization_layer": {"parameters": [2.0, 1.2]},
    "wrench_controller": {"wrench": [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], "wrench_rate": [0.0] * 6},
    "load_disturbance": {"disturbance_wrench": [0.0] * 6},
}


def _factor(port: str) -> float:
    """How much an output moves."""
    return 1.0 if port == "parameters" else 0.1


@dataclasses.dataclass
class Draw:
    """What a block is."""

    box: str
    inputs: list[str]
    state: str  # discrete, abstract, attribute (in no context), or none
    events: list[tuple[str, str, float, float]]  # kind, trigger, period and offset in s
    is_sampled: bool
    tickets: str  # that the outputs are declared to depend on
    reads: str  # what they depend on besides the state: nothing, time, steps, input, calls
    trace: str  # none, true or false


def drawn(seed: int) -> Draw:
    """The block of a seed."""
    rng = np.random.default_rng([34, seed])

    def one(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    box = one(*BOXES)
    has_inputs = box != "load_disturbance" or rng.random() < 0.4
    fitting = [name for name in SIZES if name not in BOXES[box]]
    if box == "wrench_controller":
        fitting = ["reference", "measured_load_state"]
    inputs = sorted({one(*fitting) for _ in range(2)}) if has_inputs else []
    is_fair = rng.random() < 0.6  # as the compiled loop flies it, but for one thing at most
    state = "discrete" if is_fair else one("discrete", "abstract", "attribute", "none")
    if box == "load_disturbance" and is_fair and not inputs:
        state = one("none", "discrete")
    trace = one("none", "none", "true") if is_fair else one("none", "none", "true", "false")
    period = PERIOD if trace != "none" else one(PERIOD, PERIOD, 2 * PERIOD)
    events = [("discrete", "periodic", period, PERIOD)] if state == "discrete" else []
    if trace == "none" and state == "discrete" and rng.random() < 0.4:
        events.append(("discrete", "initialization", 0.0, 0.0))
    for _ in range(one(0, 0, 0, 0, 1) if is_fair else one(0, 1, 2)):
        kind = one("discrete", "unrestricted", "publish")
        trigger = one("periodic", "periodic", "per step", "initialization")
        other = one(PERIOD, 2 * PERIOD, 3 * PERIOD, 0.007, 0.13)
        events.append((kind, trigger, other, one(0.0, PERIOD, 0.003, 0.11)))
    false = ("nothing",) * 4 + ("time", "steps", "input", "calls")
    tickets = "all state" if is_fair else one("xd", "all state", "time", "nothing", "all")
    if state == "none" and is_fair:
        tickets, false = "time", ("time", "steps")
    return Draw(
        box=box,
        inputs=inputs,
        state=state,
        events=events,
        is_sampled=is_fair or bool(rng.random() < 0.85),
        tickets=tickets,
        reads=one(*false),
        trace=trace,
    )


class OwnBlock(LeafSystem):
    """The block of a draw: outputs near those at rest, which a state of three numbers moves."""

    def __init__(self, draw: Draw):
        super().__init__()
        self.draw, self.is_sampled = draw, draw.is_sampled
        self.own, self.calls = np.zeros(3), 0
        self.read = [self.DeclareVectorInputPort(name, SIZES[name]) for name in draw.inputs]
        if draw.state == "discrete":
            self.DeclareDiscreteState(3)
        if draw.state == "abstract":
            self.DeclareAbstractState(AbstractValue.Make(np.zeros(3)))
        state = {"abstract": self.xa_ticket, "discrete": self.xd_ticket}.get(draw.state)
        tickets = {
            "xd": {(state or self.nothing_ticket)()},
            "all state": {self.all_state_ticket()},
            "time": {self.all_state_ticket(), self.time_ticket()},
            "nothing": {self.nothing_ticket()},
            "all": {self.all_sources_ticket()},
        }[draw.tickets]
        for name, rest in BOXES[draw.box].items():
            self.DeclareVectorOutputPort(name, len(rest), self._calc(name), tickets)
        for kind, trigger, period, offset in draw.events:
            name = {"discrete": "DiscreteUpdate", "unrestricted": "UnrestrictedUpdate"}.get(kind)
            name, on = name or "Publish", "".join(word.title() for word in trigger.split())
            on = {"PerStep": "PerStep", "Initialization": "Initialization"}.get(on, "Periodic")
            timing = (period, offset) if trigger == "periodic" else ()
            getattr(self, f"Declare{on}{name}Event")(*timing, getattr(self, f"_{kind}"))

    def _state(self, context):
        if self.draw.state == "discrete":
            return context.get_discrete_state_vector().CopyToVector()
        return (
            context.get_abstract_state(0).get_value() if self.draw.state == "abstract" else self.own
        )

    def _next(self, context):
        read = np.concatenate([np.zeros(1), *(port.Eval(context) for port in self.read)])
        own = self._state(context)
        return 0.9 * own + [np.tanh(read.sum()) * 0.1, 0.1, 0.1 * np.sin(7 * context.get_time())]

    def _set(self, values):
        if self.draw.state == "attribute":
            self.own = values

    def _discrete(self, context, state):
        values = self._next(context)
        self._set(values)
        if self.draw.state == "discrete":
            state.set_value(values)

    def _unrestricted(self, context, state):
        values = self._next(context)
        self._set(values)
        if self.draw.state == "discrete":
            state.get_mutable_discrete_state().set_value(values)
        if self.draw.state == "abstract":
            state.get_mutable_abstract_state(0).set_value(values)

    def _publish(self, context):
        self._set(self._next(context))

    def _calc(self, port):
        def calc(context, output):
            self.calls += 1
            moved = 0.1 * self._state(context).sum() + self._extra(context.get_time())
            if self.draw.reads == "input" and self.read:
                moved += 0.1 * np.tanh(self.read[0].Eval(context).sum())
            output.SetFromVector(np.array(BOXES[self.draw.box][port]) + moved * _factor(port))

        return calc

    def _extra(self, time):
        """What the outputs depend on besides state and inputs, at a time in s."""
        return {
            "time": 0.1 * np.sin(9 * time),
            "steps": 0.1 * (time > 0.155),
            "calls": 1e-2 * (self.calls % 7),
        }.get(self.draw.reads, 0.0)


class TracedBlock(OwnBlock):
    """With a trace, which is false where that is drawn."""

    def traced_output(self, port, at):
        (time,) = at.time
        moved = 0.1 * at.state(1).sum() if self.draw.state == "discrete" else 0.0 * time
        if self.draw.reads in ("time", "steps"):
            moved = moved + self._extra(time)
        if self.draw.reads == "input" and self.draw.inputs:
            moved = moved + 0.1 * tanh(at.input(self.draw.inputs[0]).sum())
        if self.draw.trace == "false":
            moved = 1.01 * moved + 1e-4
        return np.array([r + moved * _factor(port) for r in BOXES[self.draw.box][port]])


class UpdatedBlock(TracedBlock):
    """With updates in its trace."""

    def traced_output(self, port, at):
        return super().traced_output(port, at)

    def traced_update(self, at):
        (time,) = at.time
        read = sum((at.input(name).sum() for name in self.draw.inputs), start=0.0 * time)
        change = [0.1 * tanh(read), 0.1 + 0.0 * read, 0.1 * sin(7 * time)]
        return [0.9 * at.state(1) + np.array(change)]


def own_block(draw: Draw) -> OwnBlock:
    """The block of a draw."""
    if draw.trace == "none":
        return OwnBlock(draw)
    return UpdatedBlock(draw) if draw.state == "discrete" and draw.events else TracedBlock(draw)


def compare(seed: int) -> tuple[float, str]:
    """The largest difference of a signal between the engines, and how the block was named.

    Where that is empty the compiled loop has flown all of it. `REFUSED`: no engine flies it.
    """
    draw = drawn(seed)
    overrides = ["simulation_duration=0.3", "load_trajectory.start_time=0"]
    if draw.box != "optimization_layer":
        overrides.append("optimization_layer=ConstantParameters")
    scenario = load_scenario("quintic", overrides)
    replaced: dict[str, Any] = {draw.box: lambda model: own_block(draw)}
    runs, told, refused = [], [], []
    for engine in ("diagram", "compiled"):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", ScenarioWarning)
            try:
                run = simulate(scenario, engine=engine, check_step=StepCheck.NOTHING, **replaced)
                runs.append(run)
            except (RunStopped, ScenarioError) as error:
                refused.append(str(error))
        told += [text for w in found if (text := str(w.message)).startswith(NOT_COMPILED)]
    if refused:
        assert not runs
        assert len({*refused}) == 1, refused
        return 0.0, REFUSED
    worst = 0.0
    for of_one, of_other in zip(*((run.signals, run.steps) for run in runs), strict=True):
        for name, values in of_one.items():
            if not name.endswith("solve_time"):
                difference = np.abs(of_other[name] - values).max(initial=0.0)
                worst = max(worst, float(difference / (1 + np.abs(values).max(initial=0.0))))
    assert len(told) <= 1, told
    return worst, "".join(told)


def main(first: int, count: int) -> None:
    """Compares that many blocks."""
    found, largest = Counter(), 0.0
    for seed in range(first, first + count):
        worst, told = compare(seed)
        kind = told if told == REFUSED else "named" if told else "compiled"
        found[kind, drawn(seed).box, worst < 1e-9] += 1
        largest = max(largest, worst)
        print(seed, f"{worst:.1e}", told or "compiled", drawn(seed), flush=True)
    for (kind, box, is_equal), number in sorted(found.items()):
        print(kind, box, "equal" if is_equal else "DIFFERENT", number)
    print(f"the largest difference {largest:.1e}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
