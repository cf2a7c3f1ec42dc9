"""Which block a run stopped at."""

import contextlib
import re
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pydrake.systems.framework import (
    Context,
    Diagram,
    InputPort,
    LeafSystem,
    OutputPort,
    PortDataType,
    System,
)

from drake_nonstop.systems.block import box_of, is_converted
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.validation import ScenarioError, one_line


def raising_block(error: BaseException) -> str:
    """Which block raised the error, where one did, and in which line."""
    blamed, unmade = "", None
    for frame, line in traceback.walk_tb(error.__traceback__):
        block = frame.f_locals.get("self")
        if isinstance(block, LeafSystem):
            if frame.f_code.co_name == "__init__":
                unmade = block  # Drake ends the process where one that is not made yet is asked
            name = type(block).__name__ if block is unmade else box_of(block)
            blamed = f"{name} ({Path(frame.f_code.co_filename).name}:{line}): "
    return blamed


@contextlib.contextmanager
def block_blamed() -> Iterator[None]:
    """Turns an error of a block of the user's own into a ScenarioError with the block and line."""
    try:
        yield
    except (ScenarioError, NotFiniteError):
        raise
    except Exception as error:  # whatever a block may raise
        blamed = raising_block(error)
        if not blamed:
            raise  # Drake's own, such as that of an algebraic loop
        open_input = re.search(r"\((\w+)\) of System .* is not connected", str(error))
        said = f"its input {open_input[1]} is not connected" if open_input else one_line(error)
        raise ScenarioError(
            f"{blamed}{said}; correct the block, or what its inputs read"
        ) from error


def source_of_fault(error: NotFiniteError, nonstop: Diagram, context: Context) -> str:
    """The name of the block that made the value that is not finite, or is too large.

    It is the first block with such an output whose inputs are all sound, and the block of the
    error where that was given sound values, or the loop as a whole diverges.

    Args:
        error: of the block.
        nonstop: the diagram that it is in.
        context: the diagram's, at the instant of the error.
    """
    for block in _blocks(nonstop) if error.was_given else ():
        own = nonstop.GetSubsystemContext(block, context)
        inputs = map(block.get_input_port, range(block.num_input_ports()))
        outputs = map(block.get_output_port, range(block.num_output_ports()))
        was_given = any(_is_unsound(port, own) for port in inputs)
        if not was_given and any(_is_unsound(port, own) for port in outputs):
            return box_of(block)
    return error.block


def _blocks(diagram: Diagram) -> Iterator[System]:
    """The blocks of a diagram, also those in plain Diagrams inside of it."""
    for part in diagram.GetSystems():
        if type(part) is Diagram and not is_converted(part):
            yield from _blocks(part)
        else:
            yield part


def _is_unsound(port: InputPort | OutputPort, context: Context) -> bool:
    """Whether a port's value is not finite or too large, or cannot be evaluated for that reason."""
    if port.get_data_type() != PortDataType.kVectorValued:
        return False
    try:
        value = port.Eval(context)
    except NotFiniteError:
        return True
    except Exception:  # such as of an open input; the error of the run is reported
        return False
    return not np.all(np.abs(value) < LARGEST)
