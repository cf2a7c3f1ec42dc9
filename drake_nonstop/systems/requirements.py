"""Requirements of a loop's blocks: each says its own, and one loop asks them all.

A block may have a method `requires(loop)` that takes the `LoopBlocks`. It raises a ScenarioError
for what it cannot be flown with, and yields a sentence for each thing that a user may not expect.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.systems import wiring


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
        """The block that makes a signal; None: none does."""
        return self._makers.get(signal)

    def origin_of(self, signal: str) -> tuple[System | None, str]:
        """The block that makes a signal, and its name; of one that is handed on, its origin's."""
        maker = self.maker_of(signal)
        passed = getattr(maker, "passes_on", None)
        return (maker, signal) if passed is None else self.origin_of(passed)

    @cached_property
    def _makers(self) -> dict[str, System]:
        pairs = [*self.blocks.values()][::-1]  # the first one counts
        return {signal: block for block in pairs for signal in wiring.output_names(block)}

    def reads(self, box: str, signal: str) -> bool:
        """Whether a block is there, and has an input port of that name."""
        return box in self.blocks and signal in wiring.input_names(self.blocks[box])

    def needed(self, box: str) -> set[str]:
        """The signals that a block cannot do without."""
        return self._needed[box]

    @cached_property
    def _needed(self) -> dict[str, set[str]]:
        return {
            name: {*wiring.input_names(block)} - wiring.optional_inputs(block)
            for name, block in self.blocks.items()
        }

    def at_start(self, signal: str, maker: System | None = None) -> NDArray | None:
        """Output of a block at t = 0, of `load_trajectory` unless another one is given.

        None: it needs other blocks for it.
        """
        trajectory = maker or self.get("load_trajectory")
        if trajectory is None or trajectory.num_input_ports() > 0:
            return None
        try:
            context = trajectory.CreateDefaultContext()
            return trajectory.GetOutputPort(signal).Eval(context).copy()
        except Exception:  # the start of the run tells it, with the block's name
            return None

    def check(self) -> Iterator[str]:
        """Requirements of the blocks of each other.

        Raises:
            ScenarioError: a block cannot be flown with the others.
        """
        for block in self.blocks.values():
            yield from getattr(block, "requires", _nothing)(self) or ()


def _nothing(loop: LoopBlocks) -> tuple[str, ...]:
    return ()
