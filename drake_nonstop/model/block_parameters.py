"""What a block's context holds of the scenario: numbers of the system and of the block's config."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.model.aircraft import FLIGHT_FIELDS
from drake_nonstop.model.system import AIRCRAFT, Model
from drake_nonstop.systems.parameters import NumericParameters
from drake_nonstop.validation import ScenarioError

# An aircraft's, but for what its motion does not go by.
AIRCRAFT_NUMBERS = (
    *(AIRCRAFT + name for name in FLIGHT_FIELDS),
    "cable_length",
    "gravity",
)
AUTO = "auto"  # in the place of a field of a config that follows from the system
LOAD = ("load_mass", "load_inertia", "load_drag", "load_angular_drag", "gravity")


def _nothing(model: Model, config: Any) -> None:
    pass


def _none(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {}


class BlockParameters(NumericParameters):
    """The parameters of a block, at first those of its model and its config.

    Args:
        model: the block's.
        of_system: the names of fields of the system, and of `Model.offset_parameter`.
        config: the block's, None where it has no parameters of its own.
        own: the names of fields of the config.
        check: raises ScenarioError for a model and a config that do not make the block.
        structure: what of their numbers decides how it is built, such as whether a gain is zero.
        fixed: fields of the system that it takes over as it is built.
        follow: takes the parameters that are of the system, numbers or arrays (1,) or (3, 3), by
            name, and returns what fields of the config are where they are `AUTO`.
    """

    def __init__(
        self,
        model: Model,
        of_system: Iterable[str] = (),
        *,
        config: Any = None,
        own: Iterable[str] = (),
        check: Callable[[Model, Any], None] = _nothing,
        structure: Callable[[Model, Any], Any] = _nothing,
        fixed: tuple[str, ...] = (),
        follow: Callable[[Mapping[str, Any]], dict[str, Any]] = _none,
    ):
        self.model, self.config, self.fixed = model, config, fixed
        self.check, self.structure, self.follow = check, structure, follow
        self.of_system, self.own = tuple(of_system), tuple(own)
        values = {name: model.number(name) for name in self.of_system}
        following = follow(values)
        of_config = {
            name: following[name] if self.is_auto(name) else getattr(config, name)
            for name in self.own
        }
        super().__init__(values | of_config)

    def is_auto(self, name: str) -> bool:
        """Whether a field of the config is `AUTO`."""
        return bool(getattr(self.config, name) == AUTO)


def rigid_load(
    load_mass: Any, load_inertia: Any, load_drag: Any, load_angular_drag: Any, gravity: Any
) -> RigidLoad:
    """The load of these parameters, `LOAD`, numbers or symbols."""
    return RigidLoad(
        mass=load_mass,
        inertia=load_inertia,
        drag=load_drag,
        angular_drag=load_angular_drag,
        gravity=gravity,
    )


def required_aircraft(model: Model, box: str, block: str) -> Aircraft:
    """The model's aircraft.

    Raises:
        ScenarioError: there is none.
    """
    if model.aircraft is None:
        raise ScenarioError(
            f"system.aircraft = none: {box} = {block} flies aircraft; give "
            f"{{model: rascal_110}}, or choose another block for {box}"
        )
    return model.aircraft


def aircraft_of(numbers: Mapping[str, Any]) -> Aircraft:
    """The aircraft of `AIRCRAFT_NUMBERS`, numbers or symbols; what flight does not go by is NaN."""
    given = {name.removeprefix(AIRCRAFT): numbers[name] for name in AIRCRAFT_NUMBERS}
    return Aircraft._make(given.get(name, math.nan) for name in Aircraft._fields)
