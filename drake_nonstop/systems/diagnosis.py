"""Which block a run stopped at."""

import traceback
from collections import deque
from pathlib import Path

import numpy as np
from pydrake.systems.framework import Context, Diagram, LeafSystem, PortDataType, System

from drake_nonstop.systems.block import LeafBlock, title
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError


def raising_block(error: BaseException) -> str:
    """Which block raised the error, where one did, and in which line."""
    blamed = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        block = frame.f_locals.get("self")
        if isinstance(block, LeafSystem):
            name = block.box() if isinstance(block, LeafBlock) else title(block)
            blamed = f"{name} ({Path(frame.f_code.co_filename).name}:{line}): "
    return blamed


def source_of_fault(error: NotFiniteError, nonstop: Diagram, context: Context) -> str:
    """The name of the block that made the value that is not finite, or is too large.

    Where a block was given it, the wires are followed back to the nearest block whose inputs are
    all sound. There is none where the loop as a whole diverges: it is the block of the error then.

    Args:
        error: what a block of the diagram raised.
        nonstop: the diagram.
        context: its context at the instant of the error.
    """
    shown = {system.get_name(): title(system) for system in nonstop.GetSystems()}
    start = next((name for name in shown if shown[name] == error.block), None)
    if not error.was_given or start is None:
        return error.block
    wires: dict[str, list[tuple[System, int]]] = {}
    for (reader, _), (source, port) in nonstop.connection_map().items():
        wires.setdefault(reader.get_name(), []).append((source, port))
    waiting, seen = deque([start]), {start}
    while waiting:
        block = waiting.popleft()
        unsound = [
            source.get_name()
            for source, index in wires.get(block, [])
            if _is_unsound(source, index, nonstop, context)
        ]
        if not unsound and block != start:
            return shown[block]
        waiting += [name for name in unsound if name not in seen]
        seen.update(unsound)
    return error.block


def _is_unsound(source: System, index: int, nonstop: Diagram, context: Context) -> bool:
    """Whether an output is not finite or too large, or cannot be evaluated for that reason."""
    port = source.get_output_port(index)
    if port.get_data_type() != PortDataType.kVectorValued:
        return False
    try:
        value = port.Eval(nonstop.GetSubsystemContext(source, context))
    except NotFiniteError:
        return True
    except Exception:  # the error of the run is reported, whatever else fails after it
        return False
    return not np.all(np.abs(value) < LARGEST)
