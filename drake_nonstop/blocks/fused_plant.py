"""Load, cables, carriers and their controller in one block, stepped from sample to sample."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, State
from pydrake.systems.primitives import Selector

from drake_nonstop.mechanics.carrier import motion_after
from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.parameters import NumericParameters
from drake_nonstop.systems.traced_block import Equations, splitting, stacking
from drake_nonstop.systems.tracing import TracedFunction
from drake_nonstop.validation import ScenarioError

_HELD = "disturbance_wrench"
_MOVING, _ACCELERATION = "carrier_reference", "carrier_reference_acceleration"
_JERK = "carrier_reference_jerk"
_TIME = -1  # the place of the time in a `_Memory`


class FusedPlant(DiagramBlock):
    """Several blocks in one, stepped from one sample of the controllers to the next.

    The blocks' equations are traced to one function, with all steps in a control period of the
    third-order Runge-Kutta scheme of Drake's RungeKutta3Integrator, so that Python is called once
    in a period instead of five times in each stage of each step. The state is discrete. An output
    between two samples is that of as many, shorter steps from the earlier one.

    .. pydrake_system::

        name: FusedPlant
        input_ports:
        - disturbance_wrench
        - (the parts' inputs that are not outputs of other parts)
        output_ports:
        - (the parts' outputs)

    Names and sizes are those of the parts' ports. Over a period the `disturbance_wrench` is
    held at its value at the beginning, the `carrier_reference` moves along its velocities, or with
    its accelerations and jerks, as that of `CarrierTrajectory`, and other inputs are assumed to be
    constant. If they are, the results at the samples are those of the parts to round-off, if the
    integrator's step divides the period and no event cuts a step short.

    Blocks that hold their outputs between samples say so by `is_sampled`. Their subclasses inherit
    it: one whose outputs change between samples has to set it to False.

    Args:
        parts: the equations of the blocks by their names, each after its sources.
        period: the controllers' sample time in s.
        steps: the integrator's steps in a period.
        hold_order: of the motion of the `carrier_reference`, as of `CarrierTrajectory`; its
            accelerations and jerks are further inputs from 2 and 3 on.

    Attributes:
        kept_parameters: by the names of the parts, the parameters of their blocks, whose values it
            keeps as they were.
    """

    kept_parameters: Mapping[str, Sequence[NumericParameters]]

    def __init__(
        self,
        parts: Mapping[str, Equations],
        *,
        period: float,
        steps: int,
        hold_order: int = 1,
    ):
        super().__init__()
        self.kept_parameters = {}
        together = _CombinedEquations(parts, hold_order)
        builder = DiagramBuilder()
        stepped = builder.AddNamedSystem("stepped", _Stepped(together, period, steps))
        stacked = builder.AddNamedSystem("stacked", Selector(stacking(together.inputs)))
        builder.Connect(stacked.get_output_port(), stepped.GetInputPort("inputs"))
        builder.ExportInput(stepped.GetInputPort(_HELD), _HELD)
        for name in together.inputs:
            builder.ExportInput(stacked.GetInputPort(name), name)
        results = together.states | together.outputs
        states = builder.AddNamedSystem("states", Selector(splitting(together.states)))
        outputs = builder.AddNamedSystem("outputs", Selector(splitting(results)))
        builder.Connect(stepped.GetOutputPort("states"), states.get_input_port())
        builder.Connect(stepped.GetOutputPort("results"), outputs.get_input_port())
        for name in results:
            if name not in parts:
                source = states if name in together.states else outputs
                builder.ExportOutput(source.GetOutputPort(name), name)
        builder.BuildInto(self)

    def CalcKineticEnergy(self, context: Context) -> float:
        """Raises ScenarioError: of the parts it has the equations only."""
        raise _no_energy()

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Raises ScenarioError, likewise."""
        raise _no_energy()

    def set_states(self, context: Context, **states: NDArray) -> None:
        """Sets states by the names that `states` gives them; the context is the block's own."""
        stepped = self.GetSubsystemByName("stepped")
        stepped.set_states(self.GetMutableSubsystemContext(stepped, context), states)

    def states(self, context: Context) -> dict[str, NDArray]:
        """The states at the last sample, by their ports, or their parts where there is no port."""
        stepped = self.GetSubsystemByName("stepped")
        return stepped.states(self.GetSubsystemContext(stepped, context))

    def settle(self, context: Context) -> None:
        """Goes on from the state at the context's time, instead of from that at the last sample.

        What follows is stepped more finely; the disturbance stays as it is held.
        """
        stepped = self.GetSubsystemByName("stepped")
        stepped.settle(self.GetMutableSubsystemContext(stepped, context))

    def rates(self, context: Context) -> dict[str, NDArray]:
        """The states' rates at the last sample, by the same names."""
        stepped = self.GetSubsystemByName("stepped")
        return stepped.rates(self.GetSubsystemContext(stepped, context))


def _no_energy() -> ScenarioError:
    return ScenarioError(
        "fused_plant = true: energies are those of separate blocks; give fused_plant = false"
    )


class _CombinedEquations:
    """The equations of all parts as one.

    `inputs` are the sizes of the inputs from outside, except the disturbance, and `outputs`
    those of the parts' outputs, by the names of the ports. `states` are those of the parts'
    states, by the names of the ports that show them or, where there is none, of the parts.
    `derivatives` are the inputs with which the `carrier_reference` moves.
    """

    def __init__(self, parts: Mapping[str, Equations], hold_order: int):
        self._parts = parts
        initial = {part.state_port or name: part.initial_state for name, part in parts.items()}
        self.initial_states = {name: state for name, state in initial.items() if len(state)}
        self.states = {name: len(state) for name, state in self.initial_states.items()}
        self.outputs: dict[str, int] = {}
        read: dict[str, int] = {}
        for part in parts.values():
            self.outputs |= part.outputs
            read |= part.inputs
        self.derivatives = (_ACCELERATION, _JERK)[: hold_order - 1]
        for name in self.derivatives:
            read[name] = read[_MOVING] // 2
        known = {*self.states, *self.outputs, _HELD}
        self.inputs = {name: size for name, size in read.items() if name not in known}

    def __call__(self, state: NDArray, inputs: NDArray, held: NDArray) -> tuple[NDArray, NDArray]:
        """The rates of the states, stacked, and the outputs, likewise."""
        signals = _split(state, self.states) | _split(inputs, self.inputs) | {_HELD: held}
        rates, outputs = {}, []
        for name, part in self._parts.items():
            own = part.state_port or name
            has_state = own in self.states
            given = [signals[own]] if has_state else []
            found = part.function(*given, *(signals[port] for port in part.inputs))
            values = [value.ravel() for value in (found if isinstance(found, tuple) else (found,))]
            if has_state:
                rates[own] = values.pop(0)
            signals |= zip(part.outputs, values, strict=True)
            outputs += values
        return np.concatenate([rates[own] for own in self.states]), np.concatenate(outputs)


class _Memory(NamedTuple):
    """The discrete state of a `_Stepped`."""

    states: NDArray  # of the parts at the last sample, stacked
    held: NDArray  # (6,), N m and N, the disturbance since then, in W
    time: NDArray  # (1,), s, of the last sample; infinite before the first

    @classmethod
    def view(cls, values: NDArray) -> "_Memory":
        """The parts of a vector, of numbers or symbols: views, not copies."""
        end = len(values) + _TIME - WRENCH_SIZE
        return cls(values[:end], values[end:_TIME], values[_TIME:])


class _Stepped(InnerBlock):
    """Steps the parts; its state is a `_Memory`."""

    def __init__(self, together: _CombinedEquations, period: float, steps: int):
        super().__init__()
        self._sizes = together.states
        self._size = size = sum(together.states.values())
        input_size, output_size = sum(together.inputs.values()), sum(together.outputs.values())
        if self.scalar is float:
            self._at, self._step = _traced(together, steps, self.box)
        self._inputs = self.DeclareVectorInputPort("inputs", input_size)
        self._held = self.DeclareVectorInputPort(_HELD, WRENCH_SIZE)
        initial_states = np.concatenate([*together.initial_states.values()])
        memory = _Memory(initial_states, np.zeros(WRENCH_SIZE), np.array([np.inf]))
        self.DeclareDiscreteState(np.concatenate(memory))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._begin)
        # With the sample-and-hold, which then sees the state that this step ends with.
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, self._sample)
        sources = {
            self.input_port_ticket(self._inputs.get_index()),
            self.xd_ticket(),
            self.time_ticket(),
        }
        self._results = self.DeclareVectorOutputPort(
            "results", size + output_size, self._calc_results, sources
        )
        self.DeclareVectorOutputPort("states", size, self._calc_states, sources)

    def set_states(self, context: Context, states: Mapping[str, NDArray]) -> None:
        """As `FusedPlant.set_states`."""
        memory = context.get_discrete_state_vector().CopyToVector()
        _Memory.view(memory).states[:] = np.concatenate(
            [*(self.states(context) | dict(states)).values()]
        )
        context.SetDiscreteState(memory)

    def settle(self, context: Context) -> None:
        """As `FusedPlant.settle`."""
        memory = context.get_discrete_state_vector().CopyToVector()
        parts = _Memory.view(memory)
        parts.states[:] = self._results.Eval(context)[: self._size]
        parts.time[:] = context.get_time()
        context.SetDiscreteState(memory)

    def states(self, context: Context) -> dict[str, NDArray]:
        """As `FusedPlant.states`."""
        memory = context.get_discrete_state_vector().CopyToVector()
        return _split(_Memory.view(memory).states, self._sizes)

    def rates(self, context: Context) -> dict[str, NDArray]:
        """As `FusedPlant.rates`."""
        memory = context.get_discrete_state_vector().value()
        states, held, _ = _Memory.view(memory)
        rate, _ = self._at(states, self._inputs.Eval(context), held)
        return _split(rate.copy(), self._sizes)

    def _calc_results(self, context: Context, output: BasicVector) -> None:
        self.require_floats("set fused_plant = false")
        memory, time = context.get_discrete_state_vector().value(), context.get_time()
        if not memory[_TIME] <= time:  # before the first sample
            memory = np.append(memory[:_TIME], time)
        (results,) = self._step(self._inputs.Eval(context), memory, np.array([time]))
        output.SetFromVector(results)

    def _calc_states(self, context: Context, output: BasicVector) -> None:
        self.require_floats("set fused_plant = false")
        values = context.get_discrete_state_vector().value()
        if context.get_time() > values[_TIME]:  # neither at the sample nor before the first
            values = self._results.Eval(context)
        output.SetFromVector(values[: self._size])

    def _begin(self, context: Context, state: State) -> None:
        self.require_floats("set fused_plant = false")
        self._remember(context, state, context.get_discrete_state_vector().value())

    def _sample(self, context: Context, state: State) -> None:
        self._remember(context, state, self._results.Eval(context))

    def _remember(self, context: Context, state: State, values: NDArray) -> None:
        memory = [values[: self._size], self._held.Eval(context), [context.get_time()]]
        state.get_mutable_discrete_state().set_value(np.concatenate(memory))


def _traced(
    together: _CombinedEquations, steps: int, name: Callable[[], str]
) -> tuple[TracedFunction, TracedFunction]:
    """Rates and outputs of states, inputs and disturbance; states and outputs after `steps`."""
    size, input_size = sum(together.states.values()), sum(together.inputs.values())
    at = TracedFunction(together, [size, input_size, WRENCH_SIZE], name=name)

    def stepped(inputs: NDArray, memory: NDArray, time: NDArray) -> NDArray:
        state, held, sample_time = _Memory.view(memory)
        elapsed = time - sample_time
        step = elapsed / steps

        def rate(state: NDArray, since: NDArray) -> NDArray:
            parts = _split(inputs, together.inputs)
            after = since - elapsed
            derivatives = [parts[name] for name in together.derivatives]
            parts[_MOVING] = motion_after(parts[_MOVING], after, *derivatives)
            if len(derivatives) == 2:
                parts[_ACCELERATION] = derivatives[0] + after * derivatives[1]
            return at.traced(state, np.concatenate([*parts.values()]), held)[0]

        for i in range(steps):
            start = i * step
            first = rate(state, start)
            second = rate(state + step / 2 * first, start + step / 2)
            third = rate(state - step * first + 2 * step * second, start + step)
            state = state + step / 6 * (first + 4 * second + third)
        return np.concatenate([state, at.traced(state, inputs, held)[1]])

    return at, TracedFunction(stepped, [input_size, size + WRENCH_SIZE + 1, 1], name=name)


def _split(vector: NDArray, sizes: Mapping[str, int]) -> dict[str, NDArray]:
    """The parts of a vector of these sizes, by their names."""
    ends = np.cumsum([*sizes.values()])
    return dict(zip(sizes, np.split(vector, ends[:-1]), strict=True))
