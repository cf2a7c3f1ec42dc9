"""The traced functions of a loop, and how they are evaluated: as C, or in CasADi's machine."""

import ctypes
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.loop.lane_functions import LaneFunction, lanes_code
from drake_nonstop.systems.compilation import (
    CompilationError,
    Compiled,
    compiled,
    compiled_for_processor,
    digest,
)
from drake_nonstop.systems.tracing import bound, object_array

_WORTH_LOOKING = 100  # samples, less than are flown while the cache is looked up
_WORTH_SHORTENING = 1_500  # samples, which save about what it takes
_WORTH_TEXT = 20_000  # samples of lanes, less than are flown while their C text is made
_WORTH_LANES = 100_000  # samples, a tenth of those that save what the compilation takes
_FLY_SAMPLES = files(__package__).joinpath("fly_samples.c").read_text()


class Reading(NamedTuple):
    """An input from a system outside of a trace, and when it is read.

    `output` is the number of a port, or the name of a quantity that the system knows beforehand,
    see `systems.diagram_trace.TraceContext.known`.
    """

    system: int  # its number among all in the diagram
    output: int | str
    offset: float  # s, after the sample


@dataclass
class Symbols:
    """The symbols of a function for what stands outside, in the order in which it is read.

    Those of a function that calls others are MX, with `arguments` of its own.
    """

    numbers: Mapping[System, int]  # of all systems
    symbols: dict[Reading, Any] = field(default_factory=dict)
    arguments: list[casadi.MX] = field(default_factory=list)

    def at(self, offset: float) -> Any:
        """Gives the values of outputs, of a given size, at an instant."""

        def give(system: System, output: int | str, size: int) -> NDArray:
            return self.of(Reading(self.numbers[system], output, offset), size)

        return give

    def of(self, reading: Reading, size: int) -> Any:
        """The symbols of a reading; one of MX is a vector."""
        kind = casadi.MX if self.arguments else casadi.SX
        symbol = self.symbols.setdefault(reading, kind.sym("outside", size))
        return [symbol] if self.arguments else object_array(symbol)


class Traced(NamedTuple):
    """Results in symbols, of arguments and of what stands outside."""

    results: list[casadi.SX]
    arguments: list[casadi.SX]
    symbols: Symbols


class LoopFunction:
    """A traced function of the state, the parameters, the time and what stands outside.

    The last of its results is the sum of the squares of those that are checked. Where it is that of
    a `whole` sample, it is evaluated sample by sample.
    """

    def __init__(self, traced: Traced, *, is_whole: bool = False):
        results, arguments, symbols = traced
        self.has_calls = bool(symbols.arguments)
        self.readings, read = [*symbols.symbols], [*symbols.symbols.values()]
        self.argument_sizes = [argument.numel() for argument in arguments]
        checked = results[:-1] if is_whole else results  # not what tells of updates to be made
        results = [*results, casadi.sumsqr(casadi.vertcat(*checked))]
        if self.has_calls:
            stacked, results = _stacked([*arguments, *read], results)
        else:
            stacked = casadi.vertcat(*arguments, *read)
        self._not_short: tuple[casadi.SX, list[casadi.SX]] | None = (stacked, results)
        self.function = casadi.Function("loop", [stacked], results)
        self.compiled: Compiled | None = None  # the same, as C
        self.besides = _FLY_SAMPLES if is_whole else ""
        self._digest = ""
        self.reason = ""  # why it is not compiled
        self.lanes: LaneFunction | None = None  # the same, of several flights, as C
        self._has_no_lanes = False  # they cannot be compiled
        self._lane_samples, self._next_look = 0, _WORTH_TEXT  # that have been asked for

    def shorten(self) -> None:
        """Computes what is the same in two places once; the numbers stay, to the bit."""
        if self._not_short is not None:
            stacked, results = self._not_short
            self.function = casadi.Function("loop", [stacked], casadi.cse(results))
            self._not_short = None

    def compile(self, waits: bool) -> None:
        """Takes C of the cache; else waits for it, or has it compiled beside for a later call."""
        if self.compiled is not None:
            return
        self._digest = self._digest or digest(self.function, self.besides)
        own = {"besides": self.besides, "own_digest": self._digest}
        try:
            self.compiled, self.reason = compiled(self.function, **own, waits=waits), ""
        except CompilationError as error:
            self.reason = str(error)

    def compile_lanes(self, *, builds: bool, begins: bool = False) -> None:
        """Takes C of several flights side by side, as of `compiled_for_processor`."""
        if self.lanes is None and not self._has_no_lanes:
            self.shorten()
            make = functools.partial(lanes_code, self.function, self.argument_sizes)
            library = compiled_for_processor(make, builds=builds, begins=begins)
            if library is not None:
                self.lanes = LaneFunction(library, self.function)
            self._has_no_lanes = builds and library is None

    def lanes_for(self, samples: int) -> LaneFunction | None:
        """Lanes for so many samples more; of many they are looked up, of more compiled beside."""
        self._lane_samples += samples
        if self.lanes is None and self._lane_samples >= self._next_look:
            self._next_look = 2 * self._lane_samples
            self.compile_lanes(builds=False, begins=self._lane_samples >= _WORTH_LANES)
        return self.lanes


def _stacked(
    arguments: list[casadi.MX], results: list[casadi.MX]
) -> tuple[casadi.MX, list[casadi.MX]]:
    """One symbol in place of the arguments, and the results as functions of it."""
    ends = np.cumsum([0, *(argument.numel() for argument in arguments)]).tolist()
    stacked = casadi.MX.sym("stacked", ends[-1])
    inner = casadi.Function("inner", arguments, results)
    return stacked, inner.call(casadi.vertsplit(stacked, ends), True, False)


@dataclass
class LoopFunctions:
    """Functions of loops of one content."""

    at_start: LoopFunction
    shown: LoopFunction
    after_sample: LoopFunction
    at_sample: LoopFunction  # its updates
    whole: LoopFunction | None  # where no blocks are stepped between it and `after_sample`: both
    samples: int = 0  # that loops have asked for
    rest: LoopFunction | None = None  # see `CompiledLoop.rest_function`; None: not asked for

    @property
    def of_samples(self) -> list[LoopFunction]:
        """Functions that are evaluated at every sample, or nearly."""
        return [self.at_sample, self.after_sample] if self.whole is None else [self.whole]

    def prepare(self, samples: int | None, compiles: bool) -> None:
        """Takes C for those of samples and `rest`, or shortens them, as `CompiledLoop` says."""
        self.samples += samples or 0
        for function in filter(None, [*self.of_samples, self.rest]):
            if compiles and (samples is None or self.samples >= _WORTH_LOOKING):
                function.compile(waits=samples is None)
            is_slow = not compiles or function.compiled is None
            if is_slow and (samples is None or self.samples >= _WORTH_SHORTENING):
                function.shorten()


class Evaluation:
    """Evaluates a function, in memory of its own, as C where that is there and asked for."""

    def __init__(self, function: LoopFunction, compiles: bool):
        self.readings = function.readings
        evaluated, library = function.function, None
        if compiles and function.compiled is not None:
            evaluated, library = function.compiled
        self._input = np.zeros(evaluated.size1_in(0))
        self._outputs = [np.zeros(evaluated.size1_out(k)) for k in range(evaluated.n_out())]
        self._kept_alive, self.evaluate = bound(evaluated, [self._input], self._outputs)
        self._arguments = function.argument_sizes
        self._fly = self._flying_in_python
        if library is not None and hasattr(library, "fly_samples"):
            own = self._input, self._outputs, self._arguments
            self._fly = _FlyingInC(library, evaluated, *own).fly

    @property
    def output_sizes(self) -> list[int]:
        """The numbers of entries of the results."""
        return [*map(len, self._outputs)]

    def __call__(self, inputs: Sequence[NDArray]) -> list[NDArray]:
        """The results for all arguments, and for what stands outside."""
        np.concatenate(inputs, out=self._input)
        self.evaluate()
        return [output.copy() for output in self._outputs]

    def fly(
        self, inputs: Sequence[NDArray], times: NDArray, outside: NDArray, largest: float
    ) -> tuple[NDArray, NDArray, NDArray]:
        """Evaluates the function of a whole sample again and again, each time from its own state.

        It ends before a sample that a block has to make an update for, or at which a result is
        larger than `largest` (SI), or is no number. Of samples at times (k,), s, and what stands
        outside (k, size); `inputs` are the other arguments. Returns the state after the last
        sample, and of each the signals and the signals of steps, in rows.
        """
        state, parameters, *answers = inputs
        time = np.zeros(1)
        np.concatenate([state, parameters, time, *answers, outside[0]], out=self._input)
        _, signals, steps, *_ = self._outputs
        rows = np.empty((len(times), len(signals))), np.empty((len(times), len(steps)))
        flown = self._fly(times, outside, largest**2, *rows)
        return self._input[: len(state)].copy(), rows[0][:flown].copy(), rows[1][:flown].copy()

    def _flying_in_python(
        self, times: NDArray, outside: NDArray, limit: float, signals: NDArray, steps: NDArray
    ) -> int:
        """Calls fly_samples.c."""
        own = self._input
        state, own_signals, own_steps, _, is_valid, norm = self._outputs
        place, start = sum(self._arguments[:2]), sum(self._arguments)
        for k, time in enumerate(times):
            own[place] = time
            own[start:] = outside[k]
            self.evaluate()
            if not norm[0] < limit or not (is_valid == 1).all():
                return k
            signals[k], steps[k] = own_signals, own_steps
            own[: len(state)] = state
        return len(times)


class _FlyingInC:
    """Calls fly_samples.c in a function's library, in work memory of its own.

    `own_input`, `outputs` and `arguments`, the sizes of what is stacked in the input, are those of
    an `Evaluation`.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        function: casadi.Function,
        own_input: NDArray,
        outputs: list[NDArray],
        arguments: Sequence[int],
    ):
        self._call = library.fly_samples
        self._call.restype = ctypes.c_longlong
        self._call.argtypes = [ctypes.c_longlong, ctypes.c_double, *[ctypes.c_void_p] * 12]
        state, signals, steps, _, is_valid, _ = map(len, outputs)
        start = sum(arguments)
        places = [sum(arguments[:2]), start]
        sizes = [state, signals, steps, is_valid, len(own_input) - start]
        self._layout = np.array(places, np.int64), np.array(sizes, np.int64)
        self._values = own_input, np.array([output.ctypes.data for output in outputs], np.uintp)
        self._kept_alive = function, outputs
        self._work = (
            np.zeros(function.sz_arg(), np.uintp),
            np.zeros(function.sz_res(), np.uintp),
            np.zeros(function.sz_iw(), np.int64),
            np.zeros(function.sz_w()),
        )

    def fly(
        self, times: NDArray, outside: NDArray, limit: float, signals: NDArray, steps: NDArray
    ) -> int:
        """Calls fly_samples.c; the arrays are contiguous, and `outside` has a row per time."""
        given = *self._layout, times, outside, *self._values, signals, steps, *self._work
        addresses = (array.ctypes.data for array in given)
        return int(self._call(len(times), limit, *addresses))
