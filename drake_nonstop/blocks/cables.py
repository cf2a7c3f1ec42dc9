"""Box "Cable Forces" of the figure."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.lumped_cables import LumpedCables, LumpedCablesConfig
from drake_nonstop.mechanics.cable import cable_forces_and_tensions, cables_elastic_energy
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.validation import StrictFields, is_number, require, require_array

# What the cables are made of, and the fields of the system that say it.
_OF_SYSTEM = {
    "rest_length": "cable_length",
    "stiffness": "cable_stiffness",
    "damping": "cable_damping",
}


class _CableForces(Block):
    """Massless, tension-only spring-dampers from the load to the carriers."""

    reads = ("load_state", "carrier_state")
    makes = ("cable_forces", "carrier_cable_forces", "tensions")
    system = tuple(_OF_SYSTEM.values())
    of_model = ("attachments",)

    @staticmethod
    def equations(
        load_state: NDArray, carrier_state: NDArray, *, attachments: NDArray, **cables: NDArray
    ) -> tuple[NDArray, ...]:
        forces, tensions = cable_forces_and_tensions(
            load_state, carrier_state, attachments=attachments, **_columns(cables)
        )
        return forces, forces, tensions

    def CalcPotentialEnergy(self, context: Context) -> float:
        """That of the stretched cables, J; the context is the block's own."""
        states = (self.GetInputPort(name).Eval(context) for name in self.reads)
        columns = _columns(parameters_in(self, context))
        del columns["damping"]
        return float(
            cables_elastic_energy(*states, attachments=self.model.attachments, **columns)[0]
        )


def _columns(parameters: dict[str, NDArray]) -> dict[str, NDArray]:
    """Material of the cables, each (1, 1) or (n, 1), of a block's parameters."""
    values = {
        name: parameters.get(name, parameters.get(field)) for name, field in _OF_SYSTEM.items()
    }
    return {name: value[:, None] for name, value in values.items() if value is not None}


@dataclass(kw_only=True)
class CablesConfig(StrictFields):
    """No parameters: length, stiffness and damping are the system's."""


class Cables(_CableForces):
    """Cables of the system's length, stiffness and damping.

    Massless, tension-only spring-dampers (eq. 4), see `mechanics.cable`.

    Raises:
        ScenarioError: the simulated stiffness is not finite.
    """

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require(
            is_number(model.system.cable_stiffness),
            "simulated.cable_stiffness",
            model.system.cable_stiffness,
            "simulated cables stretch: give a finite number greater than zero here, also where "
            "system.cable_stiffness is .inf",
        )


@dataclass(kw_only=True)
class IndividualCablesConfig(StrictFields):
    """A number per cable; none: the system's for all."""

    stiffness: list[float] = field(default_factory=list)  # N/m
    damping: list[float] = field(default_factory=list)  # N s/m
    rest_length: list[float] = field(default_factory=list)  # m, unstretched


class IndividualCables(_CableForces):
    """Cables of different length, stiffness and damping.

    Massless, tension-only spring-dampers (eq. 4), see `mechanics.cable`.

    Raises:
        ScenarioError: a list has another length than there are cables, or a number in it is
            out of range.
    """

    @classmethod
    def check(cls, model: Model, config: IndividualCablesConfig) -> None:
        system = model.system
        stiffness = _each(model, "stiffness", config.stiffness, system.cable_stiffness)
        _each(model, "damping", config.damping, system.cable_damping)
        rest_length = _each(model, "rest_length", config.rest_length, system.cable_length)
        require(np.all(stiffness > 0), "cables.stiffness", config.stiffness, "give no zero")
        require(np.all(rest_length > 0), "cables.rest_length", config.rest_length, "give no zero")

    def block_parameters(self, model: Model, config: IndividualCablesConfig) -> BlockParameters:
        given = [name for name in _OF_SYSTEM if getattr(config, name)]
        others = [field for name, field in _OF_SYSTEM.items() if name not in given]
        return BlockParameters(model, others, config=config, own=given)


def _each(model: Model, name: str, given: list[float], default: float) -> NDArray:
    """The given values (n,), or n times the default."""
    values = require_array(f"cables.{name}", given or [default] * model.n, [None], "one per cable")
    require(
        len(values) == model.n and np.all(values >= 0),
        f"cables.{name}",
        given or default,
        f"give {model.n} numbers that are not negative, one per cable, or none",
    )
    return values


VARIANTS = (Cables, IndividualCables, LumpedCables)

__all__ = ["Cables", "CablesConfig", "IndividualCables", "IndividualCablesConfig"]
__all__ += ["LumpedCables", "LumpedCablesConfig"]
