"""Box "Cable Forces" of the figure."""

from dataclasses import dataclass

from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics.cable import cable_forces_and_tensions
from drake_nonstop.system import Model
from drake_nonstop.validation import is_number, require


@dataclass(kw_only=True)
class CablesConfig:
    """No parameters: length, stiffness and damping are the system's."""


class Cables(LeafSystem):
    """Massless, tension-only spring-dampers from the load to the carriers.

    .. pydrake_system::

        name: Cables
        input_ports:
        - load_state
        - carrier_state
        output_ports:
        - cable_forces
        - tensions

    `load_state` (13), `carrier_state` (6n) in W; `cable_forces` (3n) are those on the
    load, in N, in W; `tensions` (n) in N, 0 where slack. See `mechanics.cable`.

    Raises:
        ScenarioError: the simulated stiffness is not finite.
    """

    def __init__(self, model: Model, config: CablesConfig | None = None):
        super().__init__()
        require(
            is_number(model.cable_stiffness),
            "simulated.cable_stiffness",
            model.cable_stiffness,
            "simulated cables stretch: give a finite number greater than zero here, also where "
            "system.cable_stiffness is .inf",
        )

        def forces(load_state: NDArray, carrier_state: NDArray) -> tuple[NDArray, NDArray]:
            return cable_forces_and_tensions(
                load_state,
                carrier_state,
                attachments=model.attachments,
                rest_length=model.cable_length,
                stiffness=model.cable_stiffness,
                damping=model.cable_damping,
            )

        self._cables = CompiledFunction(forces, [13, 6 * model.n], name=self.get_name)
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        self._carrier_state = self.DeclareVectorInputPort("carrier_state", 6 * model.n)
        inputs = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("cable_forces", 3 * model.n, self._calc_forces, inputs)
        self.DeclareVectorOutputPort("tensions", model.n, self._calc_tensions, inputs)

    def _evaluate(self, context: Context) -> tuple[NDArray, ...]:
        return self._cables(self._load_state.Eval(context), self._carrier_state.Eval(context))

    def _calc_forces(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._evaluate(context)[0])

    def _calc_tensions(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._evaluate(context)[1])
