"""Gains from where the poles of a loop are to be, so that they carry over from scale to scale."""

from typing import Any

import numpy as np

_LENGTH = 0.8  # m, of the cables for which the paper gives its gains, under the gravity
_GRAVITY = 9.81  # m/s²


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


def load_gains(mass: Any, moment: Any, cable_length: Any, gravity: Any) -> dict[str, Any]:
    """Gains of a load's wrench controller, by the names of `mechanics.wrench.wrench_and_rate`.

        K_p = 5 m s², K_v = 4.4 m s, K_R = 12.5 j s², K_ω = 1.5 j s, K_i = K_iR = 0,
        s² = 11/(10 + (L/0.8 m)/(g/9.81 m/s²)),

    of the load's mass m in kg, a moment of inertia j in kg m², the cables' mean length L and
    gravity g. For 1 kg and 0.01 kg m² on cables of 0.8 m, the paper's load, the paper (Table I) has
    another K_v, 2 N s/m: of 300 drawn formations 7 grew with that, by up to 0.016 per s, and none
    with this. It also has 4 times the gains of the orientation. On cables a load turns much faster
    than by itself, at √(m g r²/(L j)) with attachments at a radius r, and torques that are held for
    a sample of 0.01 s then take damping away: in 160 drawn formations 7 grew by more than 0.1 per s
    with the paper's, and 2 with these, as they do with any. A free load has
    natural frequencies of √5 s and √12.5 s rad/s and damping ratios of 0.98 and 0.21. What errors
    of the model leave, references correct, at `correction_rate`. For an error of its position a
    hanging load's carriers move by K_p L/(m g) of it, which s keeps below 4.5, however long the
    cables. Own derivation, checked by Floquet multipliers and flights.
    """
    scale = np.sqrt(_scale(cable_length, gravity))
    return {
        "position_gain": 5.0 * mass * scale**2,
        "velocity_gain": 4.4 * mass * scale,
        "position_integral_gain": 0.0,
        "orientation_gain": 12.5 * moment * scale**2,
        "angular_velocity_gain": 1.5 * moment * scale,
        "orientation_integral_gain": 0.0,
    }


def correction_rate(cable_length: Any, gravity: Any) -> float:
    """The rate, rad/s, at which references move against a load's measured error: 0.3 s².

    With the s of `load_gains`. Flights of drawn errors, checked by Floquet multipliers: twice the
    rate is stable, too, and gains little.
    """
    return float(0.3 * _scale(cable_length, gravity))


def _scale(cable_length: Any, gravity: Any) -> Any:
    """s², of how much slower a load is led on longer cables."""
    return 11 / (10 + (np.mean(cable_length) / _LENGTH) / (gravity / _GRAVITY))
