"""Gains from where the poles of a loop are to be, so that they carry over from scale to scale."""

from typing import Any


def pid_gains(frequency: Any, damping: Any, integral_rate: Any) -> tuple[Any, Any, Any]:
    """Gains per unit of mass, K_p (1/s²), K_v (1/s) and K_i (1/s³), of a PID on a free mass.

    They give s³ + K_v s² + K_p s + K_i = (s² + 2 ζ ω s + ω²) (s + σ), with the natural
    `frequency` ω and the `integral_rate` σ in rad/s and the `damping` ratio ζ, numbers or arrays.
    Own derivation.
    """
    oscillation = 2 * damping * frequency
    return (
        frequency**2 + oscillation * integral_rate,
        oscillation + integral_rate,
        frequency**2 * integral_rate,
    )
