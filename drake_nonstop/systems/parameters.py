"""Named numbers and arrays in one numeric parameter of a context.

A leaf system that goes by them has them as its attribute `parameters`. The vector is its first
numeric parameter, one of Drake's own.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector_, Context, Diagram, System

from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.documentation import declared_by


def declared(system: System, first: int = 0) -> Iterator[tuple[System, "NumericParameters", int]]:
    """The systems in a system, itself included, that have parameters.

    Each with these, and with the index of their vector among the numeric parameters of the
    system's context, counted from `first` on.
    """
    own = declared_by(system, "parameters")
    if isinstance(own, NumericParameters):
        yield system, own, first
    if isinstance(system, Diagram):
        for part in system.GetSystems():
            yield from declared(part, first)
            first += part.num_numeric_parameter_groups()


def parameters_in(block: System, context: Context) -> dict[str, NDArray]:
    """The parameters of a block with one vector of them, by name, in the block's own context."""
    [(_, own, group)] = declared(block)
    return own.view(context.get_numeric_parameter(group).CopyToVector())


class NumericParameters:
    """Named numbers and arrays, one behind another in a vector.

    Attributes:
        defaults: by name, as arrays; a number has the shape ().
        vector: the defaults in one.
        of_system: the names of those that are fields of the scenario's system.
    """

    of_system: tuple[str, ...] = ()

    def __init__(self, defaults: Mapping[str, ArrayLike]):
        self.defaults = {name: np.array(value, float) for name, value in defaults.items()}
        self.vector = np.concatenate([np.zeros(0), *map(np.ravel, self.defaults.values())])
        ends = np.cumsum([0, *(value.size for value in self.defaults.values())])
        self._places = {
            name: slice(int(start), int(end))
            for name, start, end in zip(self.defaults, ends, ends[1:], strict=False)
        }

    def __len__(self) -> int:
        return len(self.vector)

    def place(self, name: str) -> slice:
        """Where the entries of one are in the vector."""
        return self._places[name]

    def view(self, vector: NDArray) -> dict[str, NDArray]:
        """By name, each with its shape, a number with (1,), of a vector of numbers or symbols."""
        return {
            name: vector[place].reshape(self.defaults[name].shape or 1)
            for name, place in self._places.items()
        }


def declare_parameters(block: LeafBlock, parameters: NumericParameters) -> None:
    """Declares them as the block's first numeric parameter."""
    block.DeclareNumericParameter(BasicVector_[block.scalar](parameters.vector))
