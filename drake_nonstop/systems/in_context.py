"""The values of a block in a context, as the methods of a block for a trace ask for them."""

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context


class InContext:
    """As `systems.diagram_trace.At`, in a context of the block, of any scalar type.

    With it `traced_output`, `traced_update` and `traced_rates` are what Drake calls, too.
    """

    def __init__(self, block: Any, context: Context):
        self._block, self._context = block, context

    def input(self, name: str) -> NDArray:
        """What an input port reads."""
        return self._block.GetInputPort(name).Eval(self._context)

    def input_or(self, name: str, other: NDArray) -> NDArray:
        """What an input port reads, or something else where it is not connected."""
        return self.input(name) if self.has_input(name) else other

    def has_input(self, name: str) -> bool:
        """Whether an input port is connected."""
        return self._block.GetInputPort(name).HasValue(self._context)

    def known(self, name: str, size: int) -> NDArray:
        """What the block's `quantities_over` makes at the present time."""
        return self._block.quantities_over([name], self.time)[0][0]

    @property
    def time(self) -> NDArray:
        """In s, (1,)."""
        return np.array([self._context.get_time()])

    def state(self, group: int) -> NDArray:
        """The continuous state (0), or a discrete group (from 1 on)."""
        if group == 0:
            return self._context.get_continuous_state_vector().CopyToVector()
        return self._context.get_discrete_state(group - 1).CopyToVector()


def shown(block: Any, port: str) -> Callable[[Context, BasicVector], None]:
    """Computes an output port by `traced_output`; it does not hold the block."""
    me: Any = weakref.ref(block)

    def calc(context: Context, output: BasicVector) -> None:
        output.SetFromVector(me().traced_output(port, InContext(me(), context)))

    return calc
