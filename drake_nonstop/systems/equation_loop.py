"""A loop whose blocks all have equations: its functions, and its states in a context."""

import threading
import time
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    Context,
    Diagram,
    InputPortIndex,
    OutputPortIndex,
    System,
)

from drake_nonstop.systems.block import (
    set_state_values,
    state_values,
    title,
)
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import STATE
from drake_nonstop.systems.loop_equations import LoopEquations, Now, Sample, Structure
from drake_nonstop.systems.native import Interpreted, Native, native
from drake_nonstop.systems.wiring import require_context
from drake_nonstop.validation import ScenarioError

_MOST_LOOPS = 32  # whose equations and functions are kept


def without_equations(diagram: Diagram) -> str:
    """Which block of a diagram has no equations, in words; empty: all have some."""
    if diagram.num_input_ports() > 0:
        names = [diagram.get_input_port(k).get_name() for k in range(diagram.num_input_ports())]
        return f"inputs = {', '.join(names)}: it has none from outside of the loop"
    for block in diagram.GetSystems():
        if not isinstance(block, EquationBlock) or not block.is_told_by_equations:
            return (
                f"{title(block)} = {type(block).__name__}: it has no equations; a Block with "
                "static `equations` would be compiled"
            )
    return ""


class LoopFunctions:
    """The functions of loops with equal equations; they hold none of the loops' systems."""

    def __init__(self, structure: Structure):
        self.equations = LoopEquations(structure)
        self._samples: dict[Any, Sample] = {}
        self._native: dict[Any, Native | None] = {}
        self._nows: dict[Any, Now | None] = {}
        self._derivatives: dict[Any, Any] = {}
        self._spent: dict[Any, tuple[int, float]] = {}  # samples, and the time of each, s

    def sample(self, key: Any) -> Sample:
        """The function of a sample; the key are the arguments of `LoopEquations.sample`."""
        if key not in self._samples:
            self._samples[key] = self.equations.sample(*key)
        return self._samples[key]

    def native(self, key: Any, lanes: int, *, builds: bool | None = None) -> Native | None:
        """The same as C, from the cache, or compiled if it `builds`; None: it is not compiled.

        To look into the cache takes as long as to write the C: with None, what has been loaded by
        this process alone counts.
        """
        found, is_known = self._native.get((key, lanes)), (key, lanes) in self._native
        if found is None and (builds or (builds is not None and not is_known)):
            found = native(self.sample(key).function, lanes=lanes, builds=builds)
            self._native[key, lanes] = found
        return found

    def spent(self, key: Any, samples: int) -> float:
        """About the time, s, of all samples so far in CasADi's virtual machine, with so many more.

        The samples are those of the function of a sample, by its key.
        """
        _, each = self._spent.get(key, (0, 0.0))
        if not each:
            function = self.sample(key).function
            x, p = (np.zeros(function.numel_in(k)) for k in (0, 2))
            widths = function.numel_in(3), function.numel_out(1), function.numel_out(2)
            rows, shown, steps = (np.zeros((1, width)) for width in widths)
            evaluator = Interpreted(function)
            for _ in range(3):  # the first one takes longer
                start = time.perf_counter()
                evaluator.fly(np.arange(2.0), x, p, rows, shown, steps, np.inf)
                each = time.perf_counter() - start
        count = self._spent.get(key, (0, 0.0))[0] + samples
        self._spent[key] = count, each
        return count * each

    def derivative(self, function: casadi.Function) -> casadi.Function:
        """The derivatives of (x_next, shown), or of the one result, by x and by p."""
        if function not in self._derivatives:
            given = function.mx_in()
            made = function.call(given)[:2]
            by = [casadi.jacobian(result, given[k]) for result in made for k in (0, 2)]
            found = casadi.Function("derivatives", given, list(map(casadi.densify, by)))
            self._derivatives[function] = found
        made_before: casadi.Function = self._derivatives[function]
        return made_before

    def directions(self, now: Now, count: int) -> casadi.Function:
        """The derivatives of a function of an instant in some directions, a column each."""
        if (now, count) not in self._derivatives:
            one = now.function.forward(1)
            shared = [*range(now.function.n_in() + 1)]
            made = one.map("directions", "serial", count, shared, [])
            self._derivatives[now, count] = made
        made_before: casadi.Function = self._derivatives[now, count]
        return made_before

    def now(self, name: str, *arguments: Any, **named: Any) -> Now | None:
        """A function of an instant: what a method of `LoopEquations` makes."""
        key = name, arguments, tuple(named.items())
        if key not in self._nows:
            method = getattr(self.equations, name)
            self._nows[key] = method(*arguments, **named) if callable(method) else method
        return self._nows[key]


_kept: OrderedDict[Any, LoopFunctions] = OrderedDict()
_lock = threading.RLock()


def _functions_of(structure: Structure) -> LoopFunctions:
    """The functions of a loop, those of an equal one if there was one."""
    key = structure.key
    if key is None:
        return LoopFunctions(structure)
    with _lock:
        found = _kept.pop(key, None) or LoopFunctions(structure)
        _kept[key] = found
        while len(_kept) > _MOST_LOOPS:
            _kept.popitem(last=False)
    return found


class EquationLoop:
    """A loop whose blocks all have equations.

    Args:
        diagram: the loop.

    Attributes:
        blocks: the diagram's own, in its order.
        layers: those of them that are asked in Python, by their numbers.
        functions: of the loop; loops of equal equations share them.
        equations: of the loop.

    Raises:
        ScenarioError: a block has none, see `without_equations`.
    """

    def __init__(self, diagram: Diagram):
        reason = without_equations(diagram)
        if reason:
            raise ScenarioError(f"{reason}; simulate its diagram, or change that")
        self.diagram, self.blocks = diagram, list[Any](diagram.GetSystems())
        self.numbers = {block: k for k, block in enumerate(self.blocks)}
        self.functions = _functions_of(_structure_of(diagram, self.numbers))
        self.equations = self.functions.equations
        self.layers: dict[int, Any] = {
            k: block for k, block in enumerate(self.blocks) if block.equations_of_block.answers
        }

    def _contexts(self, context: Context, blocks: Collection[int]) -> Iterator[tuple[int, Context]]:
        for k in blocks:
            yield k, self.diagram.GetSubsystemContext(self.blocks[k], context)

    def state_of(self, context: Context) -> NDArray:
        """The states (k,) of all blocks in a context of the diagram."""
        require_context("context", self.diagram, context)
        state = np.zeros(self.equations.state_size)
        for k, own in self._contexts(context, self.equations.places):
            state[self.equations.places[k]] = state_values(own)
        return state

    def parameters_of(self, context: Context) -> NDArray:
        """The parameters (p,) of all blocks in a context of the diagram."""
        values = np.zeros(self.equations.parameter_size)
        for k, own in self._contexts(context, self.equations.parameter_places):
            place = self.equations.parameter_places[k]
            values[place] = own.get_numeric_parameter(0).CopyToVector()
        return values

    def write_state(self, context: Context, state: NDArray) -> None:
        """Sets the states of the blocks in a context of the diagram."""
        for k, place in self.equations.places.items():
            own = self.diagram.GetMutableSubsystemContext(self.blocks[k], context)
            set_state_values(own, state[place])

    def write_parameters(self, context: Context, parameters: NDArray) -> None:
        """Sets the parameters of the blocks in a context of the diagram."""
        for k, place in self.equations.parameter_places.items():
            own = self.diagram.GetMutableSubsystemContext(self.blocks[k], context)
            own.get_mutable_numeric_parameter(0).SetFromVector(parameters[place])

    @property
    def state_names(self) -> list[str]:
        """Of each state its block's name, and its number there."""
        return [
            f"{self.blocks[k].get_name()}[{i}]"
            for k, place in self.equations.places.items()
            for i in range(place.stop - place.start)
        ]

    @property
    def parameter_names(self) -> list[str]:
        """Of each parameter its block's name and its own, and of an array's entry its number."""
        return [
            f"{self.blocks[k].get_name()}.{name}{list(at) or ''}"
            for k in self.equations.parameter_places
            for name, value in self.equations.structure.blocks[k].parameters.defaults.items()
            for at in np.ndindex(value.shape)
        ]

    def arguments(self, now: Now, x: NDArray, time: float, p: NDArray) -> list[NDArray]:
        """What a function of an instant takes, of a state, a time in s, and parameters."""
        rows = [self.blocks[k].quantity_at(name, time) for k, name in now.quantities]
        return [x, np.array([time]), p, np.concatenate([np.zeros(0), *rows])]

    def rates_jacobian(self, context: Context) -> NDArray:
        """The derivatives (m, m) of the rates of the continuous states by these, in a context."""
        equations, time = self.equations, context.get_time()
        x, p = self.state_of(context), self.parameters_of(context)
        moving, others = np.split(x, [equations.moving_size])
        _, _, row = self.arguments(equations.rates, x, time, p)[1:]
        given = [moving, others, time, p, equations.held[2](x, p), row]
        size = equations.moving_size
        seeds = [np.zeros((casadi.DM(part).numel(), size)) for part in given]
        seeds[0] = np.eye(size)
        derivative = self.functions.directions(equations.rates, size)
        found: NDArray = derivative.call([*given, [], *seeds])[0].full()
        return found


def _structure_of(diagram: Diagram, numbers: Mapping[System, int]) -> Structure:
    blocks: list[Any] = diagram.GetSystems()
    sources = {}
    for (reader, index), (maker, output) in diagram.connection_map().items():
        name = reader.get_input_port(InputPortIndex(int(index))).get_name()
        source = maker.get_output_port(OutputPortIndex(int(output))).get_name()
        if name in reader.equations_of_block.inputs:
            sources[numbers[reader], name] = numbers[maker], source
    every = []
    for block in blocks:
        own = block.equations_of_block
        every.append((1 if STATE in own.results else 0) if own.answers else block.every)
    return Structure([block.equations_of_block for block in blocks], every, sources)
