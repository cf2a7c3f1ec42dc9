"""Numbers of a loop's blocks, set in a context by their names."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import Context, Context_, Diagram

from drake_nonstop.systems.block import title
from drake_nonstop.systems.parameters import declared
from drake_nonstop.systems.wiring import require_context
from drake_nonstop.validation import require, require_array, require_known


def get_parameter(diagram: Diagram, context: Context, name: str) -> float | NDArray:
    """A number, or an array, of the first block that takes it; names as in `set_parameter`."""
    _, group, place, shape = _places(diagram, context, name)[0]
    values = context.get_numeric_parameter(group).CopyToVector()[place]
    return values.reshape(shape) if shape else values[0]


def set_parameter(diagram: Diagram, context: Context, name: str, value: Any) -> None:
    """Sets a number, or an array, in the contexts of all blocks that take it.

    "wrench_controller.position_gain" is of one block, "system.load_mass" of all controllers, and
    "simulated.load_mass" of the plant. Gains that are "auto" keep the numbers that they were built
    with, and the state stays: `set_equilibrium` finds the start anew.

    Args:
        diagram: the loop, or one around it, before a conversion.
        context: the diagram's own, or that of the diagram converted to AutoDiffXd.
        name: of a block, "system" or "simulated", and of the number.
        value: in SI units; its shape and finiteness alone are checked.

    Raises:
        ScenarioError: no block takes it, or the value has another shape or is not finite.
    """
    for block, group, place, shape in _places(diagram, context, name):
        vector = context.get_numeric_parameter(group).CopyToVector()
        require_array(name, value if vector.dtype == float else _plain(value), shape, "in SI units")
        vector[place] = np.ravel(np.asarray(value, dtype=vector.dtype))
        context.get_mutable_numeric_parameter(group).SetFromVector(vector)
        if hasattr(block, "begin_anew") and isinstance(context, Context):
            block.begin_anew(diagram.GetMutableSubsystemContext(block, context))


def _places(
    diagram: Diagram, context: Context, name: str
) -> list[tuple[Any, int, slice, tuple[int, ...]]]:
    """The blocks that take a number, the index of its vector, its place there, and its shape."""
    if isinstance(context, Context_[AutoDiffXd]):
        counts = [each.num_numeric_parameter_groups() for each in (context, diagram)]
        require(counts[0] == counts[1], "context", "another one", "give that of the diagram")
    else:
        require_context("diagram", diagram, context)
    found: dict[str, list[Any]] = {}
    block: Any
    for block, own, group in declared(diagram):
        for field, value in own.defaults.items():
            is_of_system = field in own.of_system
            roles = [block.parameters.model.field] if is_of_system else []
            for owner in (title(block), *roles):
                at = block, group, own.place(field), value.shape
                found.setdefault(f"{owner}.{field}", []).append(at)
    require_known(name, [*found], "parameter", name)
    return found[name]


_plain = np.vectorize(lambda v: v.value() if isinstance(v, AutoDiffXd) else v, otypes=[object])
