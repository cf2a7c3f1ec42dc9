"""A loop's function for flights side by side, each in a lane of its own."""

import ctypes
from collections.abc import Sequence
from importlib.resources import files
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.systems.lane_code import side_by_side

_FLY_LANES = files(__package__).joinpath("fly_lanes.c").read_text()


class LaneInputs(NamedTuple):
    """What the next samples of a flight depend on."""

    largest: float  # value, in SI units
    state: NDArray  # (x,)
    parameters: NDArray  # (p,)
    times: NDArray  # (samples,), s
    outside: NDArray  # (samples, size), what stands outside of the function


class LaneFunction:
    """A function of a whole sample for several flights, in a `library` of `lanes_code`."""

    def __init__(self, library: ctypes.CDLL, function: casadi.Function):
        self._sizes = function.nnz_out(1), function.nnz_out(2)
        self._call = library.fly_lanes
        self._call.restype = None
        self._call.argtypes = [ctypes.c_longlong, *[ctypes.c_void_p] * 9]

    def fly(self, inputs: Sequence[LaneInputs]) -> tuple[list[int], NDArray, NDArray, NDArray]:
        """Flies each flight's samples; it ends before one as of `functions.Evaluation.fly`.

        Returns how many samples each has flown, the states (flights, x) after these, the signals
        (samples, size) and the signals of steps (samples, size), with rows for all the samples of
        the first flight, then of the second, flown or not.
        """
        largest, *columns = zip(*inputs, strict=True)
        states, parameters = map(np.array, columns[:2])
        times, outside = map(np.concatenate, columns[2:])
        samples = np.array([*map(len, columns[2])], np.int64)
        limits, flown = np.square(largest), np.empty_like(samples)
        signals, steps = (np.empty((len(times), size)) for size in self._sizes)
        given = samples, limits, states, parameters, times, outside, signals, steps, flown
        self._call(len(samples), *(array.ctypes.data for array in given))
        return flown.tolist(), states, signals, steps


def lanes_code(function: casadi.Function, argument_sizes: list[int]) -> str:
    """The C text of a function of a whole sample for flights side by side, and of `fly_lanes`.

    Args:
        function: of SX, with one argument and the results that fly_lanes.c tells.
        argument_sizes: of the state, the parameters, the time and the blocks' own updates, which
            are stacked in the argument before what stands outside.

    Raises:
        CompilationError: an operation is none of those known here.
    """
    state, parameters, _, answers = argument_sizes
    results = [function.nnz_out(k) for k in range(function.n_out())]
    _, signals, steps, read, is_valid, _ = results
    outside = function.nnz_in(0) - sum(argument_sizes)
    sizes = {"STATE": state, "PARAMETERS": parameters, "ANSWERS": answers, "OUTSIDE": outside}
    sizes |= {"SIGNALS": signals, "STEPS": steps, "READ": read, "IS_VALID": is_valid}
    return "\n".join(
        [
            side_by_side(function),
            *(f"enum {{ {name} = {size} }};" for name, size in sizes.items()),
            _FLY_LANES,
        ]
    )
