"""A sampled loop of blocks as one function from sample to sample, equal to its diagram to rounding.

It is composed of the blocks' equations, see `systems/loop_equations.py`, and evaluated as C or by
CasADi's virtual machine. Layers, whose answers are no equations, are asked in Python when they are
due, after the states of all other blocks have stepped.
"""

import functools
import logging
import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    SimulatorConfig,
)
from pydrake.systems.framework import (
    Context,
    Diagram,
    OutputPortIndex,
    PortDataType,
)

from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.systems.block import title
from drake_nonstop.systems.compiled_flight import CompiledFlight, sample_times
from drake_nonstop.systems.equation_loop import EquationLoop, without_equations
from drake_nonstop.systems.loop_equations import Sample, Step
from drake_nonstop.systems.native import LANES, Interpreted, Native
from drake_nonstop.systems.sensitivities import Sensitivities, sensitivities_of
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.systems.wiring import require_context
from drake_nonstop.validation import ScenarioError, require, require_known

_ROUNDING = 1e-9  # s, of a duration
_STRETCH = 1.01  # of the longest step: a last one that is as much longer is one step
_WORTH_LOOKING = 0.25  # s, of flights in CasADi's virtual machine, from which on C is looked for
_WORTH_C = 3.0  # s, from which on it is compiled
_WORTH_LANES = 4  # flights
_LATER = "later runs of loops like it take it from the cache"
_LOG = logging.getLogger("drake_nonstop")


class NotCompiledError(ScenarioError):
    """A loop cannot be a `CompiledLoop`; its diagram flies it."""


def reason_against(diagram: Diagram, config: SimulatorConfig, control_period: float) -> str:
    """Why a loop cannot be a `CompiledLoop`, in words; empty where it can."""
    if not control_period > 0:
        return f"control_period = {control_period:g}: it goes from sample to sample"
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return "simulator_config: it takes the steps of runge_kutta3 without error control"
    reason = without_equations(diagram)
    if reason:
        return reason
    for block in diagram.GetSystems():
        steps = block.equations_of_block.period
        if steps and abs(block.sample_period / control_period - 1) > _ROUNDING:
            return (
                f"{title(block)} = {type(block).__name__}: it steps every {steps:g} s, no multiple "
                "of the control period"
            )
    return ""


def schedule_of(period: float, shown: int, longest: float) -> list[Step]:
    """The steps that Drake's integrators take in a sample: one ends at each signal.

    Of a sample's period in s, in which signals are shown so often; the last step before a signal
    may be shorter than the longest one, in s.
    """
    steps = []
    for k in range(shown):
        begin, end, left = k * period / shown, (k + 1) * period / shown, period / shown
        while left > _STRETCH * longest:
            steps.append(Step(begin, longest, begin + longest, is_shown=False))
            begin += longest
            left -= longest
        steps.append(Step(begin, left, end, is_shown=True))
    return steps


class CompiledLoop(EquationLoop):
    """A loop as a compiled function, which is stepped from sample to sample.

    Args:
        diagram: the loop; all its blocks have equations, or are layers.
        config: the integrator's step.
        control_period: s, of the controllers' samples.
        signal_period: s, between the instants at which signals are shown, at which a step of the
            integrator ends, too; a whole part of the control period, or None: every sample.
        signals: those that are shown at these instants, names of the diagram's vector-valued
            output ports; None: all of them.
        step_signals: those that are shown at the end of every step of the integrator.
        compiles: whether C is compiled, which takes seconds where it is not in the cache; None:
            `prepare` decides; False: CasADi's virtual machine evaluates.

    Attributes:
        signals, step_signals: the names of the signals with their sizes, in order.
        step_ends: (steps,), s, where the integrator's steps end after a sample.
        shown_per_sample: the number of instants of the signals in a sample.

    Raises:
        ScenarioError: a block has no equations, see `reason_against`, or the signals' period is no
            part of the control period.
    """

    def __init__(
        self,
        diagram: Diagram,
        config: SimulatorConfig,
        control_period: float,
        *,
        signal_period: float | None = None,
        signals: Collection[str] | None = None,
        step_signals: Collection[str] = (),
        compiles: bool | None = True,
    ):
        reason = reason_against(diagram, config, control_period)
        if reason:
            raise NotCompiledError(f"{reason}; simulate its diagram, or change that")
        super().__init__(diagram)
        self.control_period, self.config = control_period, config
        shown = control_period / (signal_period or control_period)
        self.shown_per_sample = round(shown)
        is_whole = self.shown_per_sample > 0 and math.isclose(shown, self.shown_per_sample)
        remedy = f"give a whole part of the control period, {control_period:g} s"
        require(is_whole, "signal_period", signal_period, remedy)
        sizes, made = {}, {}
        for k in range(diagram.num_output_ports()):
            port = diagram.get_output_port(k)
            if port.get_data_type() == PortDataType.kVectorValued:
                maker, index = diagram.get_output_port_locator(OutputPortIndex(k))
                sizes[port.get_name()] = port.size()
                made[port.get_name()] = self.numbers[maker], maker.get_output_port(index).get_name()
        for name in (*(signals or ()), *step_signals):
            require_known(name, [*sizes], "signals", name)
        self.signals = {name: sizes[name] for name in (sizes if signals is None else signals)}
        self.step_signals = {name: sizes[name] for name in step_signals}
        self._makers = made
        self._compiles = compiles
        self._rows: dict[Any, NDArray] = {}
        self._key = self._sample_key(config)
        self.step_ends = np.array([step.end for step in self._key[0]])
        if compiles:
            self.evaluator(builds=True)

    def _sample_key(self, config: SimulatorConfig) -> Any:
        """The arguments of `LoopEquations.sample` with the steps of a config."""
        period, shown = self.control_period, self.shown_per_sample
        schedule = schedule_of(period, shown, config.max_step_size)
        names = self.signals, self.step_signals
        return (tuple(schedule), period, *(tuple(self._makers[n] for n in own) for own in names))

    def evaluator(self, *, builds: bool | None = None) -> Native:
        """Evaluator of one flight: C, as of `LoopFunctions.native`, or its substitute."""
        if self._compiles is not False:
            found = self.functions.native(self._key, 1, builds=builds)
            if found is not None:
                return found
        return self._interpreted

    @functools.cached_property
    def _interpreted(self) -> Interpreted:
        return Interpreted(self.sample.function)

    @property
    def sample(self) -> Sample:
        """The function of a sample."""
        return self.functions.sample(self._key)

    @property
    def is_compiled(self) -> bool:
        """Whether it is evaluated as C, and not by CasADi's virtual machine."""
        return not isinstance(self.evaluator(), Interpreted)

    def prepare(self, samples: int, flights: int = 1) -> None:
        """Uses C, compiled if necessary, where it saves time for that number of samples.

        That takes some seconds, which a line of the log tells.
        """
        if self._compiles is None and not self.is_compiled:
            seconds = self.functions.spent(self._key, samples * flights)
            if seconds > _WORTH_LOOKING:
                self.evaluator(builds=False)
            if seconds > _WORTH_C and not self.is_compiled:
                _LOG.warning(
                    "the loop is compiled as C, once, which takes some seconds: %s", _LATER
                )
                self.evaluator(builds=True)
        if flights >= _WORTH_LANES and self.is_compiled:
            self.prepare_lanes()

    def prepare_lanes(self) -> None:
        """Compiles the C for several flights side by side, which takes some seconds."""
        if self._compiles is not False:
            self.functions.native(self._key, LANES, builds=True)

    def lanes(self) -> Native | None:
        """Evaluator of several flights side by side; None: it is not compiled."""
        if self._compiles is False:
            return None
        return self.functions.native(self._key, LANES, builds=False)

    # Flights

    def rows_of(self, first: int, count: int) -> NDArray:
        """The rows (count, size) of samples: each block is asked once for each of its times.

        Those made last are kept, since flights side by side have the same.
        """
        key = self._key, first, count
        if key in self._rows:
            return self._rows[key]
        ends = sample_times(np.arange(first, first + count + 1), self.control_period)
        readings = self.sample.readings
        columns: list[Any] = [None] * len(readings)
        for block in dict.fromkeys(reading.block for reading in readings):
            own = [k for k, reading in enumerate(readings) if reading.block == block]
            names = [*dict.fromkeys(readings[k].quantity for k in own)]
            offsets = [*dict.fromkeys(readings[k].offset for k in own)]
            at = [ends[1:] if o == self.control_period else ends[:-1] + o for o in offsets]
            times, places = np.unique(np.array(at), return_inverse=True)
            places = places.reshape(len(at), -1)
            made = self.blocks[block].precomputed_inputs(names, times)
            rows = dict(zip(names, made, strict=True))
            for k in own:
                place = places[offsets.index(readings[k].offset)]
                columns[k] = rows[readings[k].quantity][place]
        self._rows = {key: np.hstack([np.zeros((count, 0)), *columns])}
        return self._rows[key]

    def fly(self, context: Context, largest: float = LARGEST) -> CompiledFlight:
        """A flight from a context of the diagram at t = 0; the context does not change.

        In flight a value beyond `largest`, in SI units, raises NotFiniteError.

        Raises:
            ScenarioError: the context is at another time, or that of another diagram.
        """
        require_context("context", self.diagram, context)
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")
        return CompiledFlight(self, context, largest)

    def run(self, context: Context, duration: float) -> tuple[NDArray, dict[str, NDArray]]:
        """The times (instants,), s, and the signals (instants, size) by their names.

        The context is as of `fly`, the duration, in s, a multiple of the control period. A stall
        does not end it, other than a run of `simulate`.

        Raises:
            ScenarioError: the duration is no such multiple, or the context is at another time, or
                that of another diagram.
            NotFiniteError: a value is not finite, or is too large.
        """
        samples = self._samples_of(duration)
        rows = self.fly(context).fly(samples)
        times = self.control_period / self.shown_per_sample * np.arange(len(rows))
        return times, by_name(self.signals, rows)

    def _samples_of(self, duration: float) -> int:
        samples = round(duration / self.control_period) if math.isfinite(duration) else -1
        is_multiple = samples >= 0 and abs(samples * self.control_period - duration) < _ROUNDING
        remedy = f"give a multiple of the control period, {self.control_period:g} s"
        require(is_multiple, "duration", duration, remedy)
        return samples

    # Derivatives

    @property
    def blocks_without_derivatives(self) -> list[str]:
        """The names of the layers: their answers have no derivatives."""
        return [block.get_name() for block in self.layers.values()]

    def sensitivities(self, context: Context, duration: float) -> Sensitivities:
        """Derivatives of the end of a `run` by the state of its context and by parameters.

        CasADi differentiates the function of a sample; from sample to sample the chain rule does.

        Raises:
            ScenarioError: as of `run`; or a layer searches.
            NotFiniteError: a value is not finite, or is too large.
        """
        for block in self.layers.values():
            raise ScenarioError(
                f"{block.get_name()} = {type(block).__name__}: its answers have no derivatives; "
                "give another block, such as ConstantParameters in place of a layer that searches"
            )
        return sensitivities_of(self, context, self._samples_of(duration))
