"""Cables with mass and drag, for the box "Cable Forces"."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.bowed_line import (
    TimeWindow,
    lines_between,
    motion_over_window,
    with_feedback,
)
from drake_nonstop.mechanics.cable import beside_vectors, ends_of_cables
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.lumped_cable import (
    CableMaterial,
    lumped_cables,
    straight_nodes,
)
from drake_nonstop.mechanics.planned_orbit import FlightTerms
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import MOST_NODES, CarrierStates, nodes_layout
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import AIRCRAFT, Model, per_cable
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.tracing import for_each
from drake_nonstop.validation import (
    StrictFields,
    checked,
    require,
    require_ranges,
    require_whole,
    warn_user,
)

_OF_AIR = f"{AIRCRAFT}air_density"
_MATERIAL = ("length", "stiffness", "damping", "diameter", "density", "drag", "friction")
CABLE_MATERIAL = tuple(f"cable_{name}" for name in _MATERIAL)  # fields of the system
_AIR_DENSITY = 1.225  # kg/m³, where no aircraft say it
# Of the fastest wave along a cable; cable_damping counts up to that.
_MAX_DAMPING_RATIO = 0.3
_WINDOW, _INSTANTS = 0.75, 9  # s, before and after the start, in which the nodes' motion counts


def check_nodes(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no number of nodes."""
    require_whole(field, value, 1, MOST_NODES)


def require_stretch(model: Model) -> None:
    """Raises ScenarioError for simulated cables without stretch."""
    require(
        np.all(np.isfinite(model.cable_stiffness)),
        "simulated.cable_stiffness",
        model.system.cable_stiffness,
        "simulated cables stretch: give finite numbers greater than zero here, also where "
        "system.cable_stiffness is .inf",
    )


def tell_of_equilibrium(cables: Block, context: Context) -> None:
    """Warns where all carriers are in one place, as before an equilibrium was looked for."""
    state = cables.GetInputPort("carrier_state").Eval(context)
    if not np.any(np.ptp(CarrierStates.view(state).positions, axis=0)):
        warn_user(
            "start = all carriers in one place: call set_equilibrium(diagram, context) before the "
            "flight, or set_default_equilibrium(diagram) once the diagram is built"
        )


def air_density_name(model: Model) -> tuple[str, ...]:
    """The parameter of the air's density; none where no aircraft say it."""
    return () if model.aircraft is None else (_OF_AIR,)


def air_density_where_unsaid(model: Model) -> dict[str, NDArray]:
    """The air's density where no aircraft say it, as a block's constant."""
    return {} if model.aircraft is not None else {_OF_AIR: np.array([_AIR_DENSITY])}


@dataclass(kw_only=True)
class LumpedCablesConfig(StrictFields):
    """How finely cables are resolved; what they are made of is the system's."""

    nodes: int = checked(12, check_nodes)  # of each cable


class LumpedCables(Block):
    """Cables that weigh, bow and swing: nodes with mass and drag between springs that only pull.

    With the tensions T and directions u of the segments above and below a node of the mass m,

        m v̇ = T₊ u₊ − T₋ u₋ + ½ ρ d L₀/N (C_D ‖w_n‖ w_n + π C_f ‖w_t‖ w_t) − m g e₃,

    see `mechanics.lumped_cable`. Length, stiffness, damping, diameter, density, drag and friction
    are the system's, the air's density that of its aircraft. Load and carriers feel the tensions at
    their ends: aircraft then have no share of their cable's drag in their polar.

    `cable_state` is the state; it starts in the cables' own bow in the motion that the controllers
    plan, with their ends where load and carriers are. Steps follow the fastest wave,
    2 N √(K_c/M) rad/s, M the cable's mass.

    Raises:
        ScenarioError: there is no node, or no mass; the cable breaks under the load at rest, or
            weighs more than it carries.
    """

    reads = ("load_state", "carrier_state", "wind", "load_wind")
    makes = ("cable_state", "cable_forces", "carrier_cable_forces", "tensions")
    state_ports = ("cable_state",)
    system = ("attachments", *CABLE_MATERIAL, "gravity")

    tell_start = tell_of_equilibrium
    bears_drag = True  # of its cables, which aircraft then do not

    @staticmethod
    def equations(
        state: NDArray,
        load_state: NDArray,
        carrier_state: NDArray,
        wind: NDArray,
        load_wind: NDArray,
        *,
        attachments: NDArray,
        **numbers: Any,
    ) -> tuple[NDArray, ...]:
        def lumped_cable(
            state: NDArray,
            carrier_state: NDArray,
            wind: NDArray,
            attachment: NDArray,
            material: NDArray,
            load_state: NDArray,
            load_wind: NDArray,
        ) -> NDArray:
            """The nodes' rates, the forces at both ends and the tension at the load, (6 N + 7,)."""
            moved = lumped_cables(
                *(state, load_state, carrier_state, wind, load_wind),
                attachments=attachment[None],
                cable=CableMaterial(*material[:, None]),
                max_damping_ratio=_MAX_DAMPING_RATIO,
            )
            forces = moved.load_forces[0], moved.carrier_forces[0], moved.tensions[0]
            return np.concatenate([moved.rates, *forces])

        n = len(attachments)
        own = [*(_by_cable(values, n) for values in (state, carrier_state, wind)), attachments]
        found = for_each(lumped_cable, [*own, material_rows(numbers, n)], [load_state, load_wind])
        rates, forces, carrier_forces, tensions = np.split(found, [-7, -4, -1], axis=1)
        rates = rates.reshape(n, -1, 3).swapaxes(0, 1)
        return rates.ravel(), forces, carrier_forces, tensions[:, 0]

    @classmethod
    def check(cls, model: Model, config: LumpedCablesConfig) -> None:
        require_ranges("cables", config)
        system, field = model.system, model.field
        remedy = "give a number above zero: nodes have mass"
        for name in ("cable_diameter", "cable_density"):
            is_positive = np.all(per_cable(system, name) > 0)
            require(is_positive, f"{field}.{name}", getattr(system, name), remedy)
        require_stretch(model)
        carried = model.gravity * system.load_mass / model.n
        loads = model.gravity * model.cable_mass, model.cable_breaking_load
        weights, breaking = (np.broadcast_to(load, model.n) for load in loads)
        diameters = np.broadcast_to(per_cable(system, "cable_diameter"), model.n)
        is_list = isinstance(system.cable_diameter, list)
        for i in range(model.n):
            cable, index = (f"cable {i + 1}", f"[{i}]") if is_list else ("each cable", "")
            said, bears = f"{field}.cable_diameter{index}", f"carries {carried:.3g} N of the load"
            remedy = f"{cable} weighs {weights[i]:.3g} N, and {bears}; give a thinner or shorter "
            require(weights[i] < carried, said, f"{diameters[i]:g}", f"{remedy}one, or more load")
            bears = f"carries {carried + weights[i]:.3g} N at rest"
            remedy = f"{cable} breaks at {breaking[i]:.3g} N, and {bears}; give a thicker one"
            is_strong = carried + weights[i] < breaking[i]
            require(is_strong, said, f"{diameters[i]:g}", remedy)

    def constants(self, model: Model, config: LumpedCablesConfig) -> dict[str, Any]:
        return super().constants(model, config) | air_density_where_unsaid(model)

    def block_parameters(self, model: Model, config: LumpedCablesConfig) -> BlockParameters:
        return BlockParameters(model, (*self.system, *air_density_name(model)))

    def layouts(self, model: Model, config: LumpedCablesConfig) -> dict[str, Layout]:
        return {"cable_state": nodes_layout(config.nodes)}

    def state(self, model: Model) -> NDArray:
        """Upright cables above the load."""
        above = model.attachments + np.outer(model.cable_length, [0.0, 0.0, 1.0])
        carriers = np.concatenate([above.ravel(), np.zeros(above.size)])
        return self._straight(model.initial_load_state, carriers)

    def trim(
        self,
        context: Context,
        reference: NDArray | None = None,
        planned: NDArray | None = None,
        desired_cable_forces: NDArray | None = None,
        desired_cable_force_rates: NDArray | None = None,
        reference_higher_rates: NDArray | None = None,
    ) -> None:
        """Sets the nodes for the load and the carriers of now: where they move steadily.

        They are straight lines where the controllers' plan is not known, and where no line pulls
        from the load to its carrier.
        """
        load, carriers, wind, load_wind = (self.GetInputPort(s).Eval(context) for s in self.reads)
        nodes = self._straight(load, carriers)
        signals = (reference, planned, desired_cable_forces, desired_cable_force_rates)
        plan = [signal for signal in signals if signal is not None]
        if len(plan) == 4:
            model, window = self.model, TimeWindow.of(_WINDOW, _INSTANTS)
            higher_rates = np.zeros(6) if reference_higher_rates is None else reference_higher_rates
            forces, rates = (signal.reshape(-1, 3) for signal in plan[2:])
            terms = FlightTerms.along(
                model.load,
                LoadMotion.along(plan[0], higher_rates),
                load_wind,
                pseudo_inverse=model.pseudo_inverse,
                offset=model.pattern.offset,
            )
            of_window = terms, model.pattern.forces, plan[1], window, model.attachments
            along, attachments = motion_over_window(*of_window)
            forces = with_feedback(window, along, forces, rates)
            (low, high), (_, velocities) = ends_of_cables(load, carriers, model.attachments)
            attachments = attachments + (low - attachments[_INSTANTS // 2])
            lines = lines_between(
                forces,
                attachments,
                np.stack([high, velocities]),
                load_wind,
                window,
                cable=self._cable(context),
                nodes=self.config.nodes,
                gusts=wind.reshape(-1, 3) - load_wind,
            )
            nodes = nodes if lines is None else np.concatenate([part.ravel() for part in lines])
        context.SetContinuousState(nodes)

    def _straight(self, load_state: NDArray, carrier_state: NDArray) -> NDArray:
        """The nodes on straight lines."""
        own = {"attachments": self.model.attachments, "nodes": self.config.nodes}
        return straight_nodes(load_state, carrier_state, **own)

    def _cable(self, context: Context) -> CableMaterial:
        """The cables of a context of the block."""
        numbers = self.constants(self.model, self.config)
        return cable_material(numbers | parameters_in(self, context))


def _by_cable(values: NDArray, n: int) -> NDArray:
    """Vectors of n cables (k, n, 3), flat, as a row (3k,) for each cable."""
    return values.reshape(-1, n, 3).swapaxes(0, 1).reshape(n, -1)


def cable_material(numbers: dict[str, Any]) -> CableMaterial:
    """The cables of a block's numbers, by the names of its parameters and constants."""
    names = (*CABLE_MATERIAL, _OF_AIR, "gravity")
    return CableMaterial._make(beside_vectors(numbers[name]) for name in names)


def material_rows(numbers: dict[str, Any], n: int) -> NDArray:
    """The material of n cables (n, 9), of a block's numbers: a row for each cable."""
    columns = (np.broadcast_to(np.ravel(number), n) for number in cable_material(numbers))
    return np.stack([*columns], axis=1)


def material_of(model: Model) -> CableMaterial:
    """The cables of a model."""
    names = (*CABLE_MATERIAL, "gravity", *air_density_name(model))
    numbers = {name: np.atleast_1d(model.number(name)) for name in names}
    return cable_material(numbers | air_density_where_unsaid(model))
