"""Requirements of a loop's blocks: each says its own, and one loop asks them all.

A block may have a method `requires(loop)` that takes the `LoopBlocks`. It raises a ScenarioError
for what it cannot be flown with, and yields a sentence for each thing that a user may not expect.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.systems.documentation import declared_by
from drake_nonstop.systems.wiring import input_names, optional_inputs, passes_on


@dataclass(frozen=True, eq=False)
class LoopBlocks:
    """The blocks of a loop before they are connected.

    Attributes:
        blocks: by the names of their boxes.
        believed: the `Model` of the controllers.
        simulated: the `Model` of the plant.
    """

    blocks: Mapping[str, System]
    believed: Any
    simulated: Any

    def get(self, box: str) -> System | None:
        """The block of a box; None: it is left out."""
        return self.blocks.get(box)

    def maker_of(self, signal: str) -> System | None:
        """The block that makes a signal, the first one; None: none does."""
        made = (b for b in self.blocks.values() if b.HasOutputPort(signal))
        return next((b for b in made if not passes_on(b, signal)), None)

    def origin_of(self, signal: str) -> tuple[System | None, str]:
        """The block that makes a signal, and its name; of one that is handed on, its origin's."""
        maker = self.maker_of(signal)
        passed = declared_by(maker, "passes_on")
        return (maker, signal) if passed is None else self.origin_of(passed)

    def needed(self, box: str) -> set[str]:
        """The signals that a block cannot do without."""
        return {*input_names(self.blocks[box])} - optional_inputs(self.blocks[box])

    def at_start(self, signal: str) -> NDArray | None:
        """A signal at t = 0; None: no block makes it, or one that needs other blocks for it."""
        maker = self.maker_of(signal)
        if maker is None or maker.num_input_ports() > 0:
            return None
        try:
            return maker.GetOutputPort(signal).Eval(maker.CreateDefaultContext()).copy()
        except Exception:  # the start of the run tells it, with the block's name
            return None

    def check(self) -> Iterator[str]:
        """Requirements of the blocks of each other.

        Raises:
            ScenarioError: a block cannot be flown with the others.
        """
        for block in self.blocks.values():
            if requires := declared_by(block, "requires"):
                yield from requires(self) or ()
