"""Linear loops with a sampled controller: what bounded inputs and noise can do to an output.

Between samples ẋ = M x; at each sample x⁺ = S x + Σ inputs. An output is seen at several instants
of the interval after a sample, since held commands ripple within it. A loop that goes round a
periodic motion is one such loop after the other.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_FOLLOWED = 1e12  # times that a deviation grows, beyond which it is not followed
AT_ONCE = 64  # maps that are interpolated, so few that they stay in a core's cache


class SampledLoop(NamedTuple):
    """The map from sample to sample of a linear loop, and its outputs in between.

    x_{k+1} = Φ x_k + Γ c_k, and y = C_j x_k + D_j c_k at the j-th instant of the interval after
    sample k, for a state of size s, u inputs and o outputs.
    """

    transition: NDArray  # (s, s), Φ
    input: NDArray  # (s, u), Γ
    outputs: NDArray  # (j, o, s), C
    feedthrough: NDArray  # (j, o, u), D


def sampled_loop(
    dynamics: NDArray,
    reset: NDArray,
    inputs: NDArray,
    outputs: NDArray,
    *,
    period: float,
    instants: int = 2,
) -> SampledLoop:
    """The loop of M (x, x), S (x, x), inputs (x, u) that add to x⁺, and outputs (o, x) of x.

    The state at a sample is that before the reset. Outputs are seen just after the sample, and at
    `instants` instants that divide the period in s, the last one just before the next sample.
    """
    from scipy.linalg import expm  # here: the import takes 0.2 s, which few runs need

    step = expm(dynamics * period / instants)
    maps = [np.eye(len(dynamics))]
    for _ in range(instants):
        maps.append(step @ maps[-1])
    after = np.stack([outputs @ part for part in maps])
    return SampledLoop(maps[-1] @ reset, maps[-1] @ inputs, after @ reset, after @ inputs)


def parts_of_turn(turn: float, period: float, about: float) -> tuple[int, int]:
    """How many samples each of about so many equal parts of a turn (s) has, and how many they are.

    Together they are a turn, to the nearest part.
    """
    samples = max(1, round(turn / about / period))
    return samples, max(1, round(turn / (samples * period)))


def interpolated(values: NDArray, turns: NDArray) -> NDArray:
    """A function (k, s, s) of even phases of a turn, at other ones (l,), in turns.

    By trigonometric interpolation, whose error for a smooth function is near rounding.
    """
    count = len(values)
    spectrum = np.fft.rfft(np.eye(count), axis=0) / count
    orders = np.arange(len(spectrum))
    weights = np.where((orders == 0) | (2 * orders == count), 1.0, 2.0)
    waves = np.exp(2j * np.pi * np.outer(turns, orders)) * weights
    found: NDArray = (waves @ spectrum).real @ values.reshape(count, -1)
    return found.reshape(len(turns), *values.shape[1:])


def map_of_turn(maps: NDArray, samples: int) -> NDArray:
    """The map (s, s) of a turn of so many samples, of maps (k, s, s) of one at even phases of it.

    Its eigenvalues are the Floquet multipliers.
    """
    turn = np.eye(maps.shape[1])
    for start in range(0, samples, AT_ONCE):
        some = np.arange(start, min(start + AT_ONCE, samples))
        for step in interpolated(maps, some / samples):
            turn = step @ turn
    return turn


class Grown(NamedTuple):
    """How many times a deviation grows at most, at least 1, and the samples from which to which."""

    times: float
    first: int
    last: int


def largest_growth(transitions: Iterable[NDArray], scale: NDArray, *, spacing: int) -> Grown:
    """By how much a deviation of the first states grows at most, while a loop changes.

    One that grows beyond 1e12 times is followed no further.

    Args:
        transitions: the maps (s, s) from sample to sample, in their order.
        scale: (k,) weighs the first k states, which begin off while all others do not, and whose
            size is the largest singular value.
        spacing: of the samples from which on deviations are followed.
    """
    k, found = len(scale), Grown(1.0, 0, 0)
    states = np.zeros((0, 0, k))
    for sample, transition in enumerate(transitions):
        if sample % spacing == 0:
            begun = np.zeros((1, len(transition), k))
            begun[0, :k] = np.diag(1 / scale)
            states = np.concatenate([states.reshape(-1, *begun.shape[1:]), begun])
        states = transition @ states
        sizes = scale[:, None] * states[:, :k]
        if np.max(np.linalg.norm(sizes, axis=(-2, -1))) <= found.times:
            continue  # the largest singular value is no larger
        largest = np.linalg.norm(sizes, 2, axis=(-2, -1))
        start = int(np.argmax(largest))
        if largest[start] > found.times:
            found = Grown(float(largest[start]), start * spacing, sample + 1)
        if not found.times < _FOLLOWED:
            break
    return found


def responses(
    loops: Sequence[SampledLoop], samples: int, ends: Sequence[int], lags: int
) -> Iterator[NDArray]:
    """How outputs depend on single inputs: g (lags, j o, u), one row per sample before.

    The outputs are those at the end of the loops of the numbers `ends`, one after the other, each
    of which lasts for so many samples; about as many inputs are looked at as there are to be lags.
    """
    count = -(-lags // samples)
    used = {(end - i) % len(loops) for end in ends for i in range(count)}
    blocks = {k: _block(loops[k], samples) for k in used}
    powers = {k: np.linalg.matrix_power(loops[k].transition, samples) for k in used}
    for last in ends:
        end = loops[last]
        size, u = end.input.shape
        rows = end.outputs.reshape(-1, size)
        parts = [end.feedthrough.reshape(1, -1, u)]
        for i in range(count):
            k = (last - i) % len(loops)
            part = (rows @ blocks[k]).reshape(len(rows), samples, u)
            parts.append(part.swapaxes(0, 1))
            rows = rows @ powers[k]
        yield np.concatenate(parts)


def _block(loop: SampledLoop, samples: int) -> NDArray:
    """[Γ, Φ Γ, Φ² Γ, …] (s, samples u)."""
    columns = [loop.input]
    for _ in range(samples - 1):
        columns.append(loop.transition @ columns[-1])
    return np.hstack(columns)


def bounded_response(
    g: NDArray, groups: int, bounds: NDArray, rate_bounds: NDArray, period: float
) -> NDArray:
    """The largest of each output (o,) for inputs that are bounded, and so are their rates.

    The inputs are `groups` vectors of equal size, one after the other; the norm of the l-th stays
    below `bounds[l]`, and that of its rate below `rate_bounds[l]` (groups,), which may be infinite.
    With the response g_m to an input m samples of the period (s) before, (lags, o, u), and its
    tails G_m = Σ_{i ≥ m} g_i, summation by parts gives

        |Σ g_m c_{k−m}| ≤ min( c̄ Σ ‖g_m‖,  c̄ ‖G_0‖ + T c̄' Σ_{m ≥ 1} ‖G_m‖ ).

    The first is the peak-to-peak gain, the ℓ₁ norm of the response, which a bang-bang input
    attains; the second is smaller for inputs that vary slowly. Own derivation.
    """

    def norms(values: NDArray) -> NDArray:
        return np.linalg.norm(values.reshape(*values.shape[:2], groups, -1), axis=-1)

    tails = norms(np.cumsum(g[::-1], axis=0)[::-1])  # (lags, o, groups)
    gain, varying = norms(g).sum(axis=0), tails[1:].sum(axis=0)
    rates = np.where(varying > 0, rate_bounds, 0.0)
    slow = bounds * tails[0] + period * rates * varying
    return np.minimum(bounds * gain, slow).sum(axis=-1)


def overshoot(g: NDArray) -> NDArray:
    """The largest outputs (o, u) beyond their way from the first value to zero, after each input.

    Of responses g (lags, o, u) to single inputs: the largest g_m − max(g_0, 0).
    """
    return np.max(g - np.maximum(g[:1], 0.0), axis=0)


def known_response(g: NDArray, inputs: NDArray) -> NDArray:
    """The largest of each output (o,), at least 0, for known inputs (samples, u), and zero before.

    It is that of a loop at rest before the first sample, at whatever phase the loop is then.
    """
    lags, outputs = g.shape[:2]
    used = np.flatnonzero(np.any(inputs, axis=0))
    size = lags + len(inputs) - 1
    spectrum = np.zeros((size // 2 + 1, outputs), complex)
    for i in used:
        spectrum += np.fft.rfft(g[..., i], size, axis=0) * np.fft.rfft(inputs[:, i], size)[:, None]
    response = np.fft.irfft(spectrum, size, axis=0)[: len(inputs)]
    return np.max(response, axis=0, initial=0.0)


def waves_deviation(
    g: NDArray, deviations: NDArray, frequencies: NDArray, period: float
) -> NDArray:
    """The standard deviation of each output (o,) under inputs that are sums of waves.

    The inputs are independent, with deviations (u,), each of waves of equal size, frequencies
    (rad/s) and random phases. A wave of frequency ω reaches an output as |Σ g_m exp(−iωmT)|, T the
    `period` in s.
    """
    lags, outputs, u = g.shape
    turning = np.exp(-1j * period * np.outer(frequencies, np.arange(lags)))
    gains = (turning @ g.reshape(lags, -1)).reshape(-1, outputs, u)
    variance = (np.abs(gains) ** 2).mean(axis=0)
    return np.sqrt((variance * deviations**2).sum(axis=-1))


def step_response(g: NDArray, step: NDArray) -> NDArray:
    """The largest of each output (o,), at least 0, after inputs (u,) that begin and stay."""
    return np.max(np.cumsum(g @ step, axis=0), axis=0, initial=0.0)


def noise_deviation(g: NDArray, deviations: NDArray) -> NDArray:
    """The standard deviation of each output (o,) under white inputs of deviations (u,)."""
    return np.sqrt(((g * deviations) ** 2).sum(axis=(0, 2)))
