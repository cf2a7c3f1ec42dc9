"""Which samples of a long signal are drawn: few, and yet its lowest and highest values."""

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 20_000  # of a curve


def extreme_samples(values: NDArray, most: int = MOST_POINTS) -> NDArray:
    """Indices, in order, of at most `most` samples of a curve that look like all of them.

    Where there are more, they are the first, the last, and the lowest and highest of each
    column in every stretch of the curve. A sample that is not a number counts as both.

    Args:
        values: (k,), or (k, columns) of a curve in more than one dimension.
        most: at least 2 + 4 columns.
    """
    count = len(values)
    if count <= most:
        return np.arange(count)
    columns = values.reshape(count, -1)
    length = -(-count // ((most - 2) // (2 * columns.shape[1]) - 1))  # of a stretch
    whole = count // length * length
    stretches = columns[:whole].reshape(-1, length, columns.shape[1])
    starts = length * np.arange(len(stretches))[:, None]
    chosen = [starts + extreme(stretches, axis=1) for extreme in (np.argmin, np.argmax)]
    if whole < count:
        chosen += [
            whole + extreme(columns[whole:], axis=0)[None] for extreme in (np.argmin, np.argmax)
        ]
    return np.unique(np.concatenate([[0, count - 1], *(each.ravel() for each in chosen)]))
