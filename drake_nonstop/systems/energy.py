"""Kinetic and potential energies of diagrams with blocks that are written in Python.

Drake's own sums over a diagram ask systems in C++ only: what overrides `DoCalcKineticEnergy` in
Python is never called. A block has methods of the names of Drake's instead, `CalcKineticEnergy` and
`CalcPotentialEnergy`, and the sums are made here.
"""

import types
from typing import Any

from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.systems.block import DiagramBlock, is_converted, title
from drake_nonstop.systems.wiring import require_context
from drake_nonstop.validation import ScenarioError


def kinetic_energy(system: System, context: Context) -> float:
    """The kinetic energy (J) of a system of floats: of a diagram, the sum of its subsystems'.

    Of a system written in Python it is what its method `CalcKineticEnergy(context)` returns, zero
    without one, and of any other that of Drake's. For a diagram around a loop, whose own
    `CalcKineticEnergy` is Drake's and leaves blocks in Python out.

    Raises:
        ScenarioError: a loop was converted or cloned, whose blocks have no such methods any more;
            or the context is that of another system.
    """
    return _total(system, context, "CalcKineticEnergy")


def potential_energy(system: System, context: Context) -> float:
    """The potential energy (J), in the same way, by `CalcPotentialEnergy`."""
    return _total(system, context, "CalcPotentialEnergy")


def _total(system: Any, context: Context, method: str) -> float:
    if is_converted(system):
        raise ScenarioError(
            f"{title(system)} = {type(system).__name__}, converted or cloned: ask the loop "
            "that it was made of, in a context of its own, after SetTimeStateAndParametersFrom"
        )
    require_context("context", system, context)
    is_own = isinstance(getattr(type(system), method), types.FunctionType)
    if isinstance(system, Diagram) and (not is_own or isinstance(system, LoopDiagram)):
        return sum(
            (
                _total(part, system.GetSubsystemContext(part, context), method)
                for part in system.GetSystems()
            ),
            0.0,
        )
    return float(getattr(system, method)(context))


class LoopDiagram(DiagramBlock):
    """A Diagram whose energies are those of its blocks, in Python or not.

    Drake's conversions, `Clone` among them, make a plain Diagram of it, whose energies are those of
    systems in C++ only.
    """

    def CalcKineticEnergy(self, context: Context) -> float:  # noqa: N802
        """The sum (J) over the blocks, see `kinetic_energy`."""
        return kinetic_energy(self, context)

    def CalcPotentialEnergy(self, context: Context) -> float:  # noqa: N802
        """The sum (J) over the blocks, see `potential_energy`."""
        return potential_energy(self, context)

    # Nothing is kept.
    EvalKineticEnergy, EvalPotentialEnergy = CalcKineticEnergy, CalcPotentialEnergy
