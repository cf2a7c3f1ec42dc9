"""The linear sampled loop of load, cables, carriers and controllers along a turn of the orbits."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.sampled_loop import (
    SampledLoop,
    map_of_turn,
    parts_of_turn,
)
from drake_nonstop.mechanics.tethered_loop import Cables, Carriers, Estimator, Orbit, tethered_loop
from drake_nonstop.model.system import Model

_LOOPS = 60  # phases, of which speeds are looked at


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """What the loop does with errors of the load.

    Attributes:
        gains: of `mechanics.wrench.wrench_and_rate`, by name.
        deviations: (12,), standard deviations of the measured [e_R, e_p, e_ω, e_v]; SI.
        is_measured: (12,), 0 for what the controller takes as desired, else 1.
        delay: of the measurement, in samples.
        period: between samples, s.
        estimator: of the errors, behind the measurement; None: there is none.
    """

    gains: Mapping[str, Any]
    deviations: NDArray
    is_measured: NDArray
    delay: int
    period: float
    estimator: Estimator | None = None


class TurnOfLoops(NamedTuple):
    """The linear sampled loop at phases that fill a turn of the carriers."""

    orbits: list[Orbit]
    loops: list[SampledLoop]
    samples: int  # that each of them lasts
    rate: float  # 1/s, at which a deviation grows from turn to turn, the largest one


def turn_of_loops(
    model: Model,
    plant: Model,
    carriers: Carriers,
    feedback: Feedback,
    frequency: float,
    orbit: Callable[[float], Orbit],
) -> TurnOfLoops:
    """The loop of load, cables, carriers and controllers along the orbits.

    Growth is that of the maps between the phases, too: forces that step from phase to phase move
    what is lightly damped.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        carriers: their controllers and references.
        feedback: the wrench controller's.
        frequency: ξ, rad/s.
        orbit: that at a phase in rad.
    """
    turn = 2 * math.pi / frequency
    samples, count = parts_of_turn(turn, feedback.period, _LOOPS)
    orbits = [orbit(2 * math.pi * i / count) for i in range(count)]
    loops = loops_at(model, plant, carriers, feedback, orbits)
    whole = max(1, round(turn / feedback.period))
    maps = np.stack([loop.transition for loop in loops])
    growth = np.max(np.abs(np.linalg.eigvals(map_of_turn(maps, whole))))
    return TurnOfLoops(orbits, loops, samples, math.log(growth) / (whole * feedback.period))


def loops_at(
    model: Model,
    plant: Model,
    carriers: Carriers,
    feedback: Feedback,
    orbits: Iterable[Orbit],
) -> list[SampledLoop]:
    """The loop at phases of the orbits; the other arguments are as of `turn_of_loops`."""
    cables = Cables(
        attachments=plant.attachments,
        stiffness=plant.cable_stiffness,
        damping=plant.cable_damping,
        rest_length=plant.cable_length,
        compliance=model.cable_compliance,
    )
    return [
        tethered_loop(
            plant.load,
            cables,
            carriers,
            feedback.gains,
            along,
            pseudo_inverse=model.pseudo_inverse,
            period=feedback.period,
            delay=feedback.delay,
            is_measured=feedback.is_measured,
            estimator=feedback.estimator,
        )
        for along in orbits
    ]
