"""The start of a loop by its traced functions: much sooner than by its diagram."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.loop.compiled_loop import CompiledLoop
from drake_nonstop.loop.functions import Evaluation
from drake_nonstop.loop.plant_states import CARRIERS, LOAD, TRIM_CABLES, has_own_states
from drake_nonstop.mechanics.signal_layouts import SAMPLE_TIME
from drake_nonstop.systems.wiring import output_names, ports_of


class TracedStart:
    """A loop's states at t = 0, whatever is sampled or held then, and their rates.

    Args:
        loop: of the package's blocks, whose plant `is_plain`.
        context: of its diagram, which stays as it is.

    Attributes:
        state: (k,), of the context.
        continuous: the numbers of the continuous states.
        load, carriers: the places of the plant's.
    """

    def __init__(self, loop: CompiledLoop, context: Context):
        self._flight, self._layout = loop.fly(context), loop.layout
        layout = loop.layout
        self._rest = Evaluation(loop.rest_function, compiles=True)
        self._given: dict[float, NDArray] = {}
        self.state = self._flight.state
        numbers = layout.states(np.arange(len(self.state)))
        self.continuous = np.concatenate([own[0] for own in numbers.values()])
        plant = (ports_of(loop.diagram, name)[0].get_system() for name in (LOAD, CARRIERS))
        self.load, self.carriers = (
            slice(own[0], own[-1] + 1) for own in (numbers[leaf][0] for leaf in plant)
        )
        holds = [leaf for leaf in layout.leaves if SAMPLE_TIME in output_names(leaf)]
        self.held = layout.places[holds[0]].start if holds else None  # the measured load state's

    @staticmethod
    def is_plain(loop: CompiledLoop) -> bool:
        """Whether the plant's states are what its blocks show, and nothing else is set with them.

        No block stands beside the trace, or is a user's own.
        """
        layout = loop.layout
        return (
            not (layout.held or layout.of_users)
            and all(
                len(ports := ports_of(loop.diagram, name)) == 1
                and (leaf := ports[0].get_system()) in layout.state_sizes
                and getattr(leaf, "state_port", None) == name
                and layout.state_sizes[leaf][0] == ports[0].size()
                and has_own_states(leaf, name)
                for name in (LOAD, CARRIERS)
            )
            and not any(hasattr(leaf, TRIM_CABLES) for leaf in layout.leaves)
        )

    def take_state(self, context: Context) -> None:
        """Takes the states of a context with the same parameters."""
        self.state = self._layout.state_of(context)

    def initialized(self, state: NDArray) -> NDArray:
        """The state after the initialization's updates.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """
        return self._flight.initialized(state)

    def rest(self, state: NDArray, at: float = 0.0) -> tuple[NDArray, NDArray]:
        """The carriers' reference (6n,), and the rates of a state at a time in s.

        Raises:
            NotFiniteError: as of `initialized`.
        """
        if at not in self._given:  # all of it follows from the time
            self._given[at] = np.concatenate(self._flight.given_at(self._rest, at))
        found: Any = self._flight.evaluated(self._rest, state, self._given[at])
        return found[0], found[1]
