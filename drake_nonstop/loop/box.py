"""A box of a control figure, and the rule that pairs blocks with their configs."""

import dataclasses
import sys
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import SIGNALS
from drake_nonstop.systems.documentation import config_class, declared_by


class Kind(Enum):
    """Group of a box, which is its colour in the drawing."""

    PLANT = "plant"
    TRAJECTORY = "trajectory"
    WRENCH = "wrench"
    INNER_LOOP = "inner loop"
    OPTIMIZATION = "optimization"
    ADDITION = "addition"  # not in the paper's figure


class Place(NamedTuple):
    """Where a box stands in the drawing, and which way its signals run (1: rightwards)."""

    column: int
    row: int
    flow: int
    kind: Kind


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box, as the scenario, the diagram, the drawing and the studies know it.

    Attributes:
        variants: the blocks that it can be, the default first. Block X is in the same module as
            the dataclass of its parameters, XConfig, and is made by `X(model, config)`.
        makes: the names of the signals that its block makes.
        signals: these with their layouts, of `mechanics.signals` or of a variant's own
            `signal_layouts`; None: the signal is no vector.
        optional: the signals among them that a block may leave out.
        recorded_where_read: the signals that take time to evaluate and are in a run's recorded
            signals only where a block needs them.
        place: where the drawing has it.
        is_simulated: its block takes the model that is simulated, not the one that the
            controllers believe in.
        is_linearized: the stability analysis perturbs its states; not those that nothing drives,
            nor those that are sampled anew.
        swap_keeps_defaults: a swap by a block's name keeps parameters that both blocks have also
            where they are defaults.
        config_fields: fields that every config has, and what they are.
        configs: the dataclasses of the variants' parameters, in their order.
    """

    variants: tuple[type[Any], ...]
    makes: tuple[str, ...]
    place: Place
    optional: tuple[str, ...] = ()
    recorded_where_read: tuple[str, ...] = ()
    is_simulated: bool = False
    is_linearized: bool = True
    swap_keeps_defaults: bool = True
    config_fields: dict[str, str] = field(default_factory=dict)
    signals: Mapping[str, Layout | None] = field(init=False)
    configs: tuple[type, ...] = field(init=False)

    def __post_init__(self) -> None:
        known = dict(SIGNALS)
        for variant in self.variants:
            known |= declared_by(variant, "signal_layouts", {})
        object.__setattr__(self, "signals", {name: known[name] for name in self.makes})
        object.__setattr__(self, "configs", tuple(map(config_class, self.variants)))


def block_of(config: type) -> Any:
    """Object named X in the module of the dataclass XConfig; None: there is none."""
    name = config.__name__.removesuffix("Config")
    return getattr(sys.modules.get(config.__module__), name, None)


_BOUND = "speed_bound"


def kept_parameters(
    fields: Mapping[str, Any], old: type, new: type, keeps_defaults: bool
) -> dict[str, Any]:
    """Fields of the same name and type, which a swap hands on to a `new` config.

    A text is one of some words, which other configs may not have: it is handed on where both
    configs inherit the field.
    `fields` are those of the config of the class `old`; where it does not keep defaults, those that
    are at their defaults are left out.
    """
    types = typing.get_type_hints(new)
    shared = [
        key
        for key, kind in typing.get_type_hints(old).items()
        if types.get(key) == kind and (kind is not str or _field(old, key) is _field(new, key))
    ]
    # A config of the user's own may take a number only, where others also take a text.
    if _BOUND in types and not isinstance(fields.get(_BOUND), str):
        shared.append(_BOUND)
    kept = {key: fields[key] for key in shared if key in fields}
    if not keeps_defaults:
        default = dataclasses.asdict(old())
        kept = {key: value for key, value in kept.items() if value != default[key]}
    return kept


def _field(config: type, name: str) -> Any:
    return {field.name: field for field in dataclasses.fields(config)}.get(name)


def import_path(config: type) -> str:
    """The name of a block outside the package: "module.X" for the dataclass XConfig."""
    module = config.__module__.replace("__mp_main__", "__main__")  # in a process of a study
    return f"{module}.{config.__name__.removesuffix('Config')}"
