"""The integral in a sampled controller."""

from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiscreteValues

from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.diagram_trace import At


class SampledIntegrator(LeafBlock):
    """Adds its input, times the period, at every sample but the first.

    Unlike Drake's DiscreteTimeIntegrator it takes no step at the start.

    .. pydrake_system::

        name: SampledIntegrator
        input_ports:
        - rate
        output_ports:
        - integral
    """

    def __init__(self, size: int, period: float):
        super().__init__()
        self._period = period
        self._rate = self.DeclareVectorInputPort("rate", size)
        index = self.DeclareDiscreteState(size)
        self.DeclareStateOutputPort("integral", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._add)

    def traced_output(self, port: str, at: At) -> NDArray:
        """As of `systems.diagram_trace`."""
        return at.state(1)

    def traced_update(self, at: At) -> list[NDArray]:
        """As of `systems.diagram_trace`."""
        return [at.state(1) + self._period * at.input("rate")]

    def _add(self, context: Context, discrete_state: DiscreteValues) -> None:
        integral = context.get_discrete_state_vector().CopyToVector()
        discrete_state.set_value(integral + self._period * self._rate.Eval(context))
