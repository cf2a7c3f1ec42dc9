"""Box "Cable Force Distribution" of the figure."""

from dataclasses import dataclass

from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem, ValueProducer

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class CableForceDistributionConfig:
    """No parameters: the pattern is the scenario's."""


class CableForceDistribution(LeafSystem):
    """f_d = G† w_d + f̃⁰ + N λ and its exact rate (eqs. 16, 19-21).

    .. pydrake_system::

        name: CableForceDistribution
        input_ports:
        - measured_load_state
        - wrench
        - wrench_rate
        - internal_force
        output_ports:
        - desired_cable_forces
        - desired_cable_force_rates

    `measured_load_state` (13), `wrench` and `wrench_rate` (6, [torque; force]) in W,
    `internal_force` (2m); the outputs (3n) are in W, in N and N/s.
    """

    def __init__(self, model: Model, config: CableForceDistributionConfig | None = None):
        super().__init__()

        def distribute(*inputs: NDArray) -> tuple[NDArray, NDArray]:
            return cable_forces_and_rates(
                *inputs,
                pseudo_inverse=model.pseudo_inverse,
                basis=model.pattern.basis,
                offset=model.pattern.offset,
            )

        self._distribute = CompiledFunction(distribute, [13, 6, 6, 2 * model.m], name=self.get_name)
        self._ports = [
            self.DeclareVectorInputPort("measured_load_state", 13),
            self.DeclareVectorInputPort("wrench", 6),
            self.DeclareVectorInputPort("wrench_rate", 6),
            self.DeclareVectorInputPort("internal_force", 2 * model.m),
        ]
        inputs = {self.all_input_ports_ticket()}
        self._forces_and_rates = self.DeclareCacheEntry(
            "forces and rates", ValueProducer(Value(()).Clone, self._calc), inputs
        )
        result = {self._forces_and_rates.ticket()}
        self.DeclareVectorOutputPort("desired_cable_forces", 3 * model.n, self._calc_forces, result)
        self.DeclareVectorOutputPort(
            "desired_cable_force_rates", 3 * model.n, self._calc_rates, result
        )

    def _calc(self, context: Context, value: AbstractValue) -> None:
        forces, rates = self._distribute(*[port.Eval(context) for port in self._ports])
        value.set_value((forces.copy(), rates.copy()))

    def _calc_forces(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._forces_and_rates.Eval(context)[0])

    def _calc_rates(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._forces_and_rates.Eval(context)[1])
