"""A box of a control figure, and the rule that pairs blocks with their configs."""

import sys
from dataclasses import dataclass, field
from typing import NamedTuple

from pydrake.systems.framework import System

from drake_nonstop.model.system import Model
from drake_nonstop.validation import require


class Place(NamedTuple):
    """Where a box stands in the drawing, which way its signals run (1: rightwards), its colour."""

    column: int
    row: int
    flow: int
    kind: str


@dataclass(frozen=True, kw_only=True)
class Box:
    """What the scenario, the diagram, the drawing and the studies know of a box.

    Attributes:
        variants: the blocks that it can be, the default first. Block X is in the same module as
            the dataclass of its parameters, XConfig, and is made by `X(model, config)`.
        signals: what its block makes, with sizes for n carriers and m coordinates of the
            internal force: "13", "3n", "2m".
        optional: the signals among them that a block may leave out; nothing in the figure
            reads them.
        place: where the drawing has it.
        is_simulated: its block takes the model that is simulated, not the one that the
            controllers believe in.
        is_fused: a fused plant takes its place.
        is_sampled: a fused plant needs a block here whose attribute `is_sampled` is true.
        is_linearized: the stability analysis perturbs its states; not those that nothing drives,
            nor those that are sampled anew.
        configs: the dataclasses of the variants' parameters, in their order.
    """

    variants: tuple[type[System], ...]
    signals: dict[str, str]
    place: Place
    optional: tuple[str, ...] = ()
    is_simulated: bool = False
    is_fused: bool = False
    is_sampled: bool = False
    is_linearized: bool = True
    configs: tuple[type, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "configs", tuple(map(config_class, self.variants)))

    def sizes(self, n: int, m: int) -> dict[str, int]:
        """The sizes of its signals for n carriers and m internal-force coordinates."""
        numbers = {"n": n, "m": m}
        return {
            signal: int(size.rstrip("nm") or 1) * numbers.get(size[-1], 1)
            for signal, size in self.signals.items()
        }

    def required_and_optional(self, model: Model) -> tuple[dict[str, int], dict[str, int]]:
        """The signals that its block has to make and those that it may make, with their sizes."""
        sizes = self.sizes(model.n, model.m)
        optional = {signal: sizes.pop(signal) for signal in self.optional}
        return sizes, optional


def config_class(block: type[System]) -> type:
    """The dataclass of a block's parameters: XConfig in the module of block X."""
    return getattr(sys.modules[block.__module__], f"{block.__name__}Config")


def block_class(box: str, config: type) -> type[System]:
    """The block of a dataclass of parameters: X in the module of XConfig.

    Args:
        box: what error messages call the box.
        config: the dataclass.

    Raises:
        ScenarioError: there is no such block.
    """
    name = config.__name__.removesuffix("Config")
    block = getattr(sys.modules.get(config.__module__), name, None)
    require(
        isinstance(block, type) and issubclass(block, System),
        box,
        import_path(config),
        f"give {config.__module__} a LeafSystem or Diagram of the name {name}",
    )
    return block  # type: ignore[return-value]


def import_path(config: type) -> str:
    """The name of a block outside the package: "module.X" for the dataclass XConfig."""
    return f"{config.__module__}.{config.__name__.removesuffix('Config')}"
