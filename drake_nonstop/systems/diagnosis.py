"""Which block a run stopped at."""

import traceback
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pydrake.systems.framework import (
    Context,
    Diagram,
    LeafSystem,
    OutputPortIndex,
    PortDataType,
    System,
)

from drake_nonstop.systems.block import box_of, is_converted
from drake_nonstop.systems.diagram_trace import Wires
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError


def raising_block(error: BaseException) -> str:
    """Which block raised the error, where one did, and in which line."""
    blamed = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        block = frame.f_locals.get("self")
        if isinstance(block, LeafSystem):
            blamed = f"{box_of(block)} ({Path(frame.f_code.co_filename).name}:{line}): "
    return blamed


def source_of_fault(error: NotFiniteError, nonstop: Diagram, context: Context) -> str:
    """The name of the block that made the value that is not finite, or is too large.

    Where a block was given it, the wires are followed back to the nearest block whose inputs are
    all sound. There is none where the loop as a whole diverges: it is the block of the error then.
    The context is the diagram's at the instant of the error.
    """
    shown = {block: box_of(block) for block in _blocks(nonstop)}
    starts = [block for block in shown if shown[block] == error.block]
    wires, waiting, seen = Wires(nonstop), deque(starts), {*starts}
    while waiting and error.was_given:
        block = waiting.popleft()
        unsound = []
        for index in range(block.num_input_ports()):
            source, port = wires.source(block, index) or (None, 0)
            while source is not None and source not in shown:
                source, port = source.get_output_port_locator(OutputPortIndex(port))
            if source is not None and _is_unsound(source, port, nonstop, context):
                unsound.append(source)
        if not unsound and block not in starts:
            return shown[block]
        waiting += [source for source in unsound if source not in seen]
        seen.update(unsound)
    return error.block


def _blocks(diagram: Diagram) -> Iterator[System]:
    """The blocks of a diagram, also those in plain Diagrams inside of it."""
    for part in diagram.GetSystems():
        if type(part) is Diagram and not is_converted(part):
            yield from _blocks(part)
        else:
            yield part


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
